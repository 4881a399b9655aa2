"""PPO of brax, the learner of MuJoCo Playground, trains on an arm: environments and agent in one compiled program."""

import argparse
import time
from typing import Any

import jax
import jax.numpy as jnp

if not hasattr(jax, "device_put_replicated"):
    # brax 0.14.2 calls what JAX 0.10 has no longer (github.com/google/brax/issues/671); here there is one device.
    jax.device_put_replicated = lambda tree, devices: jax.tree.map(lambda leaf: jnp.stack([leaf] * len(devices)), tree)

from brax.training.agents.ppo import train as ppo

from icac_jax.envs import brax as arms_for_brax


def main() -> None:
    """Reads the options, trains, prints success over steps."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--arm", default="planar2", help="planar2 or nico4")
    options.add_argument("--physics", default="kinematic", help="servo or kinematic")
    options.add_argument("--steps", type=int, default=250_000, help="environment steps of the training")
    options.add_argument("--evaluations", type=int, default=5, help="how often success is measured, on 128 episodes")
    options.add_argument("--seed", type=int, default=0)
    chosen = options.parse_args()
    world = arms_for_brax.Reach(chosen.arm, chosen.physics)
    began = time.perf_counter()

    def told(steps: int, metrics: dict[str, Any]) -> None:
        reached, length = (float(metrics[f"eval/{name}"]) for name in ("episode_reached", "avg_episode_length"))
        seconds = time.perf_counter() - began
        print(f"{steps:8} steps: reached {reached:.0%}, {length:.1f} steps an episode, {seconds:.0f} s", flush=True)

    ppo.train(
        environment=world,
        num_timesteps=chosen.steps,
        episode_length=world.episode_length,
        num_envs=128,
        unroll_length=16,
        batch_size=128,
        num_minibatches=8,
        num_updates_per_batch=4,
        num_resets_per_eval=2,  # brax begins an environment's episodes alike until it is reset
        learning_rate=1e-3,
        discounting=0.95,
        entropy_cost=1e-3,
        reward_scaling=0.1,
        num_evals=chosen.evaluations,
        num_eval_envs=128,
        seed=chosen.seed,
        progress_fn=told,
    )


if __name__ == "__main__":
    main()
