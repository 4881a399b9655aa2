"""The Instantaneous Topological Map (Algorithm 1), in arrays of fixed capacity.

N is the capacity, D the size of a stimulus. A node is a slot; a slot is a node while `live`. Writes that must not
happen go to the index N and are dropped, so that no whole array is ever copied to make an update conditional.
"""

import functools
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.curiosity import nearest
from icac_jax.curiosity.base import Map, MapInfo, Nodes, Slots
from icac_jax.fast.sums import dots, least
from icac_jax.fields import check_array
from icac_jax.precision import usual


class ItmState(struct.PyTreeNode):
    """A map.

    Attributes:
      weights: [N, D] position of each node, in the stimulus' own units; meaningless where not live.
      live: [N] bool, which slots are nodes.
      adjacency: [N, N] bool, symmetric, no self-links, false outside live nodes.
      degree: [N] int32, number of edges of each node (row sums of `adjacency`).
      overflow: [] int32, how many stimuli called for a node while the map was full.
    """

    weights: jax.Array
    live: jax.Array
    adjacency: jax.Array
    degree: jax.Array
    overflow: jax.Array

    @property
    def capacity(self) -> int:
        """Number of slots N."""
        return self.weights.shape[0]


class ItmInfo(NamedTuple):
    """What one stimulus did.

    Attributes:
      nearest: [] int32, slot n.
      second: [] int32, slot n'.
      distance: [] |x - w_n| as found in line 1, before the winner moved.
      created: [] bool, a node was added.
      node: [] int32, the node responsible for x: the new one if created, else n.
    """

    nearest: jax.Array
    second: jax.Array
    distance: jax.Array
    created: jax.Array
    node: jax.Array


@usual
def init(key: jax.Array, capacity: int, size: int, init_range: jax.typing.ArrayLike = 1.0) -> ItmState:
    """Two connected nodes (Sec. III.A) at uniform random places in +-`init_range`.

    Args:
      key: randomness.
      capacity: N, at least 2.
      size: D.
      init_range: half-width of the box the first nodes are drawn from, in the stimulus' units.
    """
    first = init_range * jax.random.uniform(key, (2, size), minval=-1.0, maxval=1.0)
    adjacency = jnp.zeros((capacity, capacity), bool).at[0, 1].set(True).at[1, 0].set(True)
    live = jnp.arange(capacity) < 2
    return ItmState(
        weights=jnp.zeros((capacity, size)).at[:2].set(first),
        live=live,
        adjacency=adjacency,
        degree=live.astype(jnp.int32),
        overflow=jnp.zeros((), jnp.int32),
    )


def cut(state: ItmState, slots: int) -> ItmState:
    """A map with its first slots alone, which hold all of its nodes."""
    return ItmState(
        weights=state.weights[:slots],
        live=state.live[:slots],
        adjacency=state.adjacency[:slots, :slots],
        degree=state.degree[:slots],
        overflow=state.overflow,
    )


@usual
def nearest_two(state: ItmState, stimulus: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Slots n, n' and the squared distance to n (line 1).

    Args:
      state: a map with at least two live nodes.
      stimulus: [D].

    Returns:
      n and n', [] int32, and |x - w_n|^2, [].
    """
    return nearest.two(nearest.squares(state.weights, state.live, stimulus))


@usual
def update(
    state: ItmState,
    stimulus: jax.Array,
    *,
    rate: jax.typing.ArrayLike,
    e_max: jax.typing.ArrayLike,
    spacing_removal: Literal["second", "none"] = "second",
    enabled: jax.typing.ArrayLike = True,
) -> tuple[ItmState, ItmInfo]:
    """Adapts the map to one stimulus (Algorithm 1, lines 1-14 and 19-21).

    Args:
      state: the map.
      stimulus: [D] x, the paper's s_t.
      rate: learning step epsilon of the winner.
      e_max: mapping resolution, in the stimulus' units.
      spacing_removal: "second" removes n' when it is closer than e_max / 2 to n (line 20); "none" never does.
      enabled: when False nothing is written (a frozen lane).

    Returns:
      The new map and what happened. With a full map the new node is not created and `overflow` counts it.
    """
    check_array("stimulus", stimulus, (state.weights.shape[1],))
    n, second, squared = nearest_two(state, stimulus)  # line 1
    slots = jnp.arange(state.capacity, dtype=jnp.int32)
    nowhere = state.capacity
    enabled = jnp.asarray(enabled)

    w_n = state.weights[n] + rate * (stimulus - state.weights[n])  # line 2
    w_second = state.weights[second]
    is_n, is_second = slots == n, slots == second

    # Lines 3-8. The rows of n and n' are built complete and written once; the dot product is exactly 0 for m = n'.
    row, row_second = state.adjacency[n], state.adjacency[second]
    linked = row[second]
    degree = state.degree + jnp.where(linked, 0, is_n.astype(jnp.int32) + is_second)
    row, row_second = row | is_second, row_second | is_n
    hidden = row & (dots(state.weights - w_second, w_n - w_second) < 0)  # line 5
    row = row & ~hidden
    degree = degree - hidden - jnp.where(is_n, jnp.sum(hidden, dtype=jnp.int32), 0)  # line 6
    live = state.live & ~(hidden & (degree == 0))  # lines 7-8

    # Lines 12-14.
    far = dots(stimulus - w_n, stimulus - w_n) > e_max**2
    wanted = far & (dots(w_n - stimulus, w_second - stimulus) > 0)
    free = least(jnp.where(live, nowhere, slots))
    created = wanted & (free < nowhere) & enabled
    is_new = created & (slots == free)
    row = row | is_new
    degree = jnp.where(is_new, 1, degree) + (created & is_n)
    live = live | is_new

    # Lines 19-21; two nodes are always kept, or n' would not exist at the next stimulus.
    close = dots(w_n - w_second, w_n - w_second) < (0.5 * e_max) ** 2
    removed = close & (jnp.sum(live) > 2) & enabled & (spacing_removal == "second")
    degree = degree - (removed & row_second)
    degree = jnp.where(removed & is_second, 0, degree)
    live = live & ~(removed & is_second)
    row = row & ~(removed & is_second)
    row_second = row_second & ~removed

    # One write an array, of values that depend on all that was read from it: otherwise XLA keeps a copy of the whole.
    pair = jnp.where(enabled, jnp.stack([n, second]), nowhere)
    rows = jnp.stack([row, row_second])
    adjacency = state.adjacency.at[pair].set(rows, mode="drop").at[:, pair].set(rows.T, mode="drop")
    moved = jnp.stack([jnp.where(enabled, n, nowhere), jnp.where(created, free, nowhere)])
    weights = state.weights.at[moved].set(jnp.stack([w_n, stimulus]), mode="drop")

    new_state = ItmState(
        weights=weights,
        live=jnp.where(enabled, live, state.live),
        adjacency=adjacency,
        degree=jnp.where(enabled, degree, state.degree),
        overflow=state.overflow + (wanted & ~created & enabled),
    )
    info = ItmInfo(
        nearest=n,
        second=second,
        distance=jnp.sqrt(squared),
        created=created,
        node=jnp.where(created, free, n),
    )
    return new_state, info


@functools.cache
def topological_map(capacity: int, size: int, spacing_removal: Literal["second", "none"] = "second") -> Map:
    """The ITM as a map that curiosity can use; equal arguments give the same object.

    Args:
      capacity: N, at least 2.
      size: D, entries of a stimulus.
      spacing_removal: see `update`.
    """

    def step(state: ItmState, stimulus: jax.Array, hyper: Any, enabled: Any) -> tuple[ItmState, MapInfo]:
        state, info = update(
            state,
            stimulus,
            rate=hyper.map_rate,
            e_max=hyper.e_max,
            spacing_removal=spacing_removal,
            enabled=enabled,
        )
        return state, MapInfo(info.node, info.nearest, info.distance, info.created)

    return Map(
        capacity=capacity,
        init=lambda key, hyper: init(key, capacity, size, hyper.map_init_range),
        update=step,
        nodes=lambda state: Nodes(state.live, state.weights, state.adjacency),
        counts=lambda state: {"live_nodes": jnp.sum(state.live, dtype=jnp.int32), "overflow": state.overflow},
        slots=Slots(capacity, cut, lambda state: state.overflow),
    )
