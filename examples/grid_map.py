"""ICAC with another map: a grid of fixed cells in place of the topological map, handed in under one name.

A map is five things, see `icac_jax.curiosity.Map`. A cell is a node from its first visit on. The run prints how both
maps do on the planar arm.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

import icac_jax as icac
from icac_jax.curiosity import Map, MapInfo, Nodes


class Grid(struct.PyTreeNode):
    """Which cells [N] have been visited."""

    live: jax.Array


@functools.cache
def grid(side: int, size: int) -> Map:
    """A grid of `side` cells per entry of a stimulus [size] in [-1, 1]."""
    capacity = side**size
    centres = jnp.array(
        [[(2 * k + 1) / side - 1 for k in np.unravel_index(n, (side,) * size)] for n in range(capacity)]
    )

    def update(state, stimulus, hyper, enabled):
        cell = jnp.clip(((stimulus + 1) / 2 * side).astype(jnp.int32), 0, side - 1)
        node = jnp.sum(cell * side ** jnp.arange(size)[::-1], dtype=jnp.int32)
        created = ~state.live[node] & enabled
        place = jnp.where(created, node, capacity)  # beyond the end: nothing is written
        distance = jnp.linalg.norm(stimulus - centres[node])
        return Grid(state.live.at[place].set(True, mode="drop")), MapInfo(node, node, distance, created)

    return Map(
        capacity=capacity,
        init=lambda key, hyper: Grid(jnp.zeros(capacity, bool)),
        update=update,
        nodes=lambda state: Nodes(state.live, centres, None),
        counts=lambda state: {"live_nodes": jnp.sum(state.live, dtype=jnp.int32)},
    )


def main(seeds: int = 20, episodes: int = 200) -> dict[str, icac.Trained]:
    """Trains ICAC with each map; returns what came out."""
    settings = icac.preset("planar2", "icac")
    spec = icac.Spec(observation_size=4, state_size=2, action_size=2)
    inside = icac.cacla.agent(spec)
    found = {}
    for name, used in (("topological map", None), ("grid", grid(4, 2))):
        agent = icac.curious(inside, spec, map=used)
        found[name] = icac.train("planar2", agent, hyper=settings.hyper, seeds=seeds, episodes=episodes)
        nodes = found[name].episodes["live_nodes"][..., -1].mean()
        print(f"{name}: {found[name]}, {nodes:.1f} nodes")
    return found


if __name__ == "__main__":
    main()
