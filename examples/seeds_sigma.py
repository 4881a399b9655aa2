"""Seeds times sigma in one compiled program: every seed with every width of the exploration noise, side by side.

Usage: python examples/seeds_sigma.py [EPISODES] [SEEDS]
"""

import sys

import jax
import jax.numpy as jnp

import icac_jax
from icac_jax import cacla
from icac_jax.envs import arms, reach

SIGMAS = (0.1, 0.3, 0.6, 1.0)  # in units of the action bound, 10 degrees


def main(episodes: int = 400, seeds: int = 10) -> jax.Array:
    """Trains CACLA+Var on the planar arm and prints a table; returns success in the last quarter [sigmas, seeds]."""
    arm = arms.PLANAR2
    world = reach.make(arm, "kinematic")
    agent = cacla.agent(cacla.CaclaSpec(observation_size=arm.observation_size, action_size=arm.joints))

    # One lane for each pair: what is traced may differ between lanes and still costs one compile.
    sigma, seed = (grid.ravel() for grid in jnp.meshgrid(jnp.array(SIGMAS), jnp.arange(seeds), indexing="ij"))
    hyper = icac_jax.broadcast(cacla.CaclaHyper().traced(), seed.size).replace(sigma=sigma)
    params = icac_jax.broadcast(reach.default_params(arm).traced(), seed.size)
    lanes = icac_jax.init_lanes(agent, world, jax.random.key(0), seed, hyper, params)

    # An episode has at most 50 steps, so after this many all lanes have finished theirs and stand still.
    wanted = jnp.full(seed.size, episodes)
    lanes, log = icac_jax.run_chunk(agent, world, lanes, hyper, params, wanted, length=50 * episodes)

    late = log.done & (log.episode >= episodes - episodes // 4)
    success = ((late & log.reached).sum(0) / late.sum(0)).reshape(len(SIGMAS), seeds)
    steps = (jnp.where(late, log.totals["steps"], 0).sum(0) / late.sum(0)).reshape(len(SIGMAS), seeds)
    print(f"last quarter of {episodes} episodes, {seeds} seeds, {lanes.step.sum():,} lane-steps")
    print("sigma  success  worst seed  best seed  steps")
    for row, value in enumerate(SIGMAS):
        worst, best = success[row].min(), success[row].max()
        print(f"{value:5.1f}  {success[row].mean():7.1%}  {worst:10.1%}  {best:9.1%}  {steps[row].mean():5.1f}")
    return success


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
