"""rejax, written for gymnax environments, trains PPO on an arm: environments, agent and evaluation in one program."""

import argparse
import time

import jax
import numpy as np
from rejax import PPO

from icac_jax.envs import gymnax as arms_for_gymnax


def main() -> None:
    """Reads the options, trains, prints success over steps."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--arm", default="planar2", help="planar2 or nico4")
    options.add_argument("--physics", default="servo", help="servo or kinematic")
    options.add_argument("--steps", type=int, default=500_000, help="environment steps of the training")
    options.add_argument("--evaluations", type=int, default=10, help="how often success is measured, on 128 episodes")
    options.add_argument("--seed", type=int, default=0)
    chosen = options.parse_args()
    env, params = arms_for_gymnax.make(chosen.arm, physics=chosen.physics)
    agent = PPO.create(
        env=env,
        env_params=params,
        num_envs=64,
        num_steps=64,
        num_epochs=8,
        num_minibatches=8,
        learning_rate=1e-3,
        gamma=0.95,
        ent_coef=0.0,
        max_grad_norm=0.5,
        normalize_rewards=True,
        total_timesteps=chosen.steps,
        eval_freq=chosen.steps // chosen.evaluations,
        agent_kwargs={"activation": "tanh", "hidden_layer_sizes": (64, 64)},
    )
    began = time.perf_counter()
    _, (lengths, returns) = jax.jit(agent.train)(jax.random.key(chosen.seed))
    lengths, success = np.asarray(lengths), np.asarray(returns) > 0  # the only reward is that of the goal
    for number, (steps, reached) in enumerate(zip(lengths.mean(1), success.mean(1), strict=True)):
        at = number * agent.eval_freq
        print(f"about {at} steps: reached {reached:.0%} of the goals, {steps:.1f} steps an episode")
    print(f"{time.perf_counter() - began:.0f} s with compilation")


if __name__ == "__main__":
    main()
