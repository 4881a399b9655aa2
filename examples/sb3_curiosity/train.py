"""Stable-Baselines3's SAC on an arm with ICAC's curiosity around the world, and without it.

Prints a row per seed and learner: goals reached without exploration, nodes of the map, seconds.
"""

import argparse
import time

import gymnasium
import torch
from stable_baselines3 import SAC

from icac_jax.gymnasium_curiosity import Curiosity

WORLD = "icac_jax.envs.gymnasium:icac_jax/Planar2Reach-v0"
JOINTS = 2  # of the observation: what is mapped; the rest is the goal


def success(agent: SAC, episodes: int) -> float:
    """Share of fixed starts and goals that the policy reaches without exploration."""
    world, reached = gymnasium.make(WORLD), 0
    for episode in range(episodes):
        observation, _ = world.reset(seed=1_000_000 + episode)
        terminated = truncated = False
        while not (terminated or truncated):
            action, _ = agent.predict(observation, deterministic=True)
            observation, _, terminated, truncated, _ = world.step(action)
        reached += terminated
    return reached / episodes


def main() -> None:
    """Reads the options, trains, prints."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--steps", type=int, default=6_000, help="environment steps per seed")
    options.add_argument("--seeds", type=int, default=3, help="seeds, one after another")
    options.add_argument("--curiosity", type=float, default=1.0, help="weight of the intrinsic reward")
    options.add_argument("--episodes", type=int, default=100, help="episodes of the evaluation")
    chosen = options.parse_args()
    torch.set_num_threads(1)
    print("curiosity  seed  success  nodes  seconds", flush=True)
    for weight in (0.0, chosen.curiosity):
        for seed in range(chosen.seeds):
            world = Curiosity(gymnasium.make(WORLD), state_size=JOINTS, seed=seed, curiosity=weight)
            agent = SAC("MlpPolicy", world, learning_rate=1e-3, gamma=0.95, seed=seed, device="cpu")
            start = time.perf_counter()
            agent.learn(chosen.steps)
            seconds = time.perf_counter() - start
            nodes = int(world.state.map.live.sum())
            print(
                f"{weight:9g}  {seed:4}  {success(agent, chosen.episodes):7.0%}  {nodes:5}  {seconds:7.1f}", flush=True
            )


if __name__ == "__main__":
    main()
