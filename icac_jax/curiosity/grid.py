"""A grid of fixed cells as a map: the plainest partition of the space of stimuli. Own; a baseline for the others.

N = side ** D cells, D the size of a stimulus. A cell is a node from its first visit on and stays one; its predictor
starts then. Nodes never move, so a predictor keeps its region for ever. No step looks at more than one cell: what a
step costs does not depend on N, what the map needs of memory does.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.curiosity import lattice
from icac_jax.curiosity.base import Map, MapInfo, Nodes
from icac_jax.fast.sums import dots
from icac_jax.fields import check_array
from icac_jax.precision import usual


class GridState(struct.PyTreeNode):
    """A map.

    Attributes:
      live: [N] bool, cells that were visited.
    """

    live: jax.Array


@usual
def update(
    state: GridState, stimulus: jax.Array, *, side: int, enabled: jax.typing.ArrayLike = True
) -> tuple[GridState, MapInfo]:
    """Visits the cell of a stimulus.

    Args:
      state: the map.
      stimulus: [D], in [-1, 1]; what lies outside belongs to the cell at the border next to it.
      side: cells per entry of a stimulus.
      enabled: when False nothing is written (a frozen lane).

    Returns:
      The new map and what happened; the distance is that to the centre of the cell.
    """
    capacity = state.live.shape[0]
    check_array("stimulus", stimulus, (None,))
    cell = jnp.clip(jnp.floor((stimulus + 1) * (side / 2)), 0, side - 1)
    place = cell.astype(jnp.int32)
    node = place[0]
    for entry in range(1, stimulus.shape[0]):
        node = node * side + place[entry]
    offset = stimulus - ((2 * cell + 1) / side - 1)
    created = ~state.live[node] & jnp.asarray(enabled)
    # Beyond the end nothing is written.
    live = state.live.at[jnp.where(created, node, capacity)].set(True, mode="drop")
    return GridState(live=live), MapInfo(node, node, jnp.sqrt(dots(offset, offset)), created)


@functools.cache
def grid_map(side: int, size: int) -> Map:
    """The grid as a map that curiosity can use; equal arguments give the same object.

    Args:
      side: cells per entry of a stimulus.
      size: D, entries of a stimulus.

    Raises:
      ConfigError: there would be more cells than a map may have.
    """
    capacity = lattice.size("grid_side", side, size)

    def step(state: GridState, stimulus: jax.Array, hyper: Any, enabled: Any) -> tuple[GridState, MapInfo]:
        return update(state, stimulus, side=side, enabled=enabled)

    def nodes(state: GridState) -> Nodes:
        live = state.live
        centres = (2 * jnp.array(lattice.places(side, size)) + 1) / side - 1
        return Nodes(live, centres, lattice.neighbours(side, size) & live[:, None] & live)

    return Map(
        capacity=capacity,
        init=lambda key, hyper: GridState(live=jnp.zeros(capacity, bool)),
        update=step,
        nodes=nodes,
        counts=lambda state: {"live_nodes": jnp.sum(state.live, dtype=jnp.int32)},
    )
