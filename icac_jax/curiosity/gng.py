"""Growing neural gas (Fritzke 1995), in arrays of fixed capacity.

N is the capacity, D the size of a stimulus. A node is a slot; a slot is a node while `live`. A node is created between
others once in a fixed number of stimuli, whatever the stimuli are, until the map is full; a node is deleted when its
last edge has grown too old.

Each slot has a predictor. It goes with its node, which moves towards the stimuli that it and its neighbours win. The
predictor of a deleted node is lost: a slot that is used again starts with a fresh one, at once (`MapInfo.started`).
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.curiosity import nearest
from icac_jax.curiosity.base import Map, MapInfo, Nodes
from icac_jax.fast.sums import least
from icac_jax.fields import check_array
from icac_jax.precision import usual

# The age of an edge that is not there.
NONE = -1


class GngState(struct.PyTreeNode):
    """A map.

    Attributes:
      weights: [N, D] position of each node, in the stimulus' own units; meaningless where not live.
      live: [N] bool, which slots are nodes.
      ages: [N, N] int32, symmetric, age of each edge; -1 where there is none.
      degree: [N] int32, number of edges of each node.
      errors: [N] accumulated squared distances of each node, 0 where not live.
      steps: [] int32, stimuli so far.
      overflow: [] int32, how often a node was due while the map was full.
    """

    weights: jax.Array
    live: jax.Array
    ages: jax.Array
    degree: jax.Array
    errors: jax.Array
    steps: jax.Array
    overflow: jax.Array


@usual
def init(key: jax.Array, capacity: int, size: int, init_range: jax.typing.ArrayLike = 1.0) -> GngState:
    """Two nodes without an edge at uniform random places in +-`init_range` (step 0).

    Args:
      key: randomness.
      capacity: N, at least 2.
      size: D.
      init_range: half-width of the box they are drawn from, in the stimulus' units.
    """
    first = init_range * jax.random.uniform(key, (2, size), minval=-1.0, maxval=1.0)
    return GngState(
        weights=jnp.zeros((capacity, size)).at[:2].set(first),
        live=jnp.arange(capacity) < 2,
        ages=jnp.full((capacity, capacity), NONE, jnp.int32),
        degree=jnp.zeros(capacity, jnp.int32),
        errors=jnp.zeros(capacity),
        steps=jnp.zeros((), jnp.int32),
        overflow=jnp.zeros((), jnp.int32),
    )


@usual
def update(
    state: GngState, stimulus: jax.Array, *, hyper: Any, enabled: jax.typing.ArrayLike = True
) -> tuple[GngState, MapInfo]:
    """Adapts the map to one stimulus (Fritzke 1995, Sec. 2, steps 2 to 9).

    Args:
      state: the map.
      stimulus: [D] x.
      hyper: `gng_rate` (e_b), `gng_neighbour_rate` (e_n), `gng_max_age` (a_max), `gng_interval` (lambda),
        `gng_split_decay` (alpha), `gng_error_decay` (d: this share of an error is kept).
      enabled: when False nothing is written (a frozen lane).

    Returns:
      The new map and what happened; the distance is that before the winner moved. With a full map the new node is not
      created and `overflow` counts it.
    """
    check_array("stimulus", stimulus, (state.weights.shape[1],))
    capacity = state.live.shape[0]
    slots = jnp.arange(capacity, dtype=jnp.int32)
    enabled = jnp.asarray(enabled)
    n, second, squared = nearest.two(nearest.squares(state.weights, state.live, stimulus))  # step 2
    is_n, is_second = slots == n, slots == second

    # Steps 3, 6 and 7: only edges of the winner get older, so only they can be too old.
    before = state.ages[n]
    linked = before >= 0
    row = jnp.where(is_second, 0, jnp.where(linked, before + 1, NONE))
    expired = row > hyper.gng_max_age
    row = jnp.where(expired, NONE, row)
    fresh_edge = is_second & ~linked
    degree = state.degree + fresh_edge - expired
    degree = degree + jnp.where(is_n, jnp.sum(fresh_edge.astype(jnp.int32) - expired), 0)
    live = state.live & ~(expired & (degree == 0))

    # Steps 4 and 5.
    errors = jnp.where(live, state.errors + jnp.where(is_n, squared, 0.0), 0.0)
    rates = jnp.where(is_n, hyper.gng_rate, jnp.where(linked, hyper.gng_neighbour_rate, 0.0))
    weights = state.weights + rates[:, None] * (stimulus - state.weights)

    # Step 8: between the node of the largest error and its neighbour of the largest error.
    free = least(jnp.where(live, capacity, slots))
    due = ((state.steps + 1) % hyper.gng_interval == 0) & enabled
    created = due & (free < capacity)
    worst, _ = nearest.one(jnp.where(live, -errors, jnp.inf))
    row_worst = jnp.where(worst == n, row, jnp.where(is_n, row[worst], state.ages[worst]))
    other, _ = nearest.one(jnp.where(row_worst >= 0, -errors, jnp.inf))
    row_other = jnp.where(other == n, row, jnp.where(is_n, row[other], state.ages[other]))
    is_worst, is_other, is_new = slots == worst, slots == other, slots == free
    between = 0.5 * (weights[worst] + weights[other])
    half = hyper.gng_split_decay * errors[worst]
    split = jnp.where(is_worst | is_new, half, jnp.where(is_other, hyper.gng_split_decay * errors, errors))
    row_worst = jnp.where(is_other, NONE, jnp.where(is_new, 0, row_worst))
    row_other = jnp.where(is_worst, NONE, jnp.where(is_new, 0, row_other))
    row_new = jnp.where(is_worst | is_other, 0, NONE)
    row = jnp.where(created & (worst == n), row_worst, jnp.where(created & (other == n), row_other, row))

    # One write an array, of values that depend on all that was read from it: otherwise XLA keeps a copy of the whole.
    nowhere = jnp.full((), capacity, jnp.int32)
    pair = [jnp.where(enabled, n, nowhere), *(jnp.where(created, slot, nowhere) for slot in (worst, other, free))]
    touched, rows = jnp.stack(pair), jnp.stack([row, row_worst, row_other, row_new])
    new_state = GngState(
        weights=jnp.where(((rates > 0) & enabled)[:, None], weights, state.weights)
        .at[jnp.where(created, free, nowhere)]
        .set(between, mode="drop"),
        live=jnp.where(enabled, live | (created & is_new), state.live),
        ages=state.ages.at[touched].set(rows, mode="drop").at[:, touched].set(rows.T, mode="drop"),
        degree=jnp.where(enabled, jnp.where(created & is_new, 2, degree), state.degree),
        errors=jnp.where(enabled, hyper.gng_error_decay * jnp.where(created, split, errors), state.errors),  # step 9
        steps=state.steps + enabled,
        overflow=state.overflow + (due & ~created),
    )
    started = jnp.where(created, free, nowhere)
    return new_state, MapInfo(n, n, jnp.sqrt(squared), created, started)


@functools.cache
def growing_neural_gas(capacity: int, size: int) -> Map:
    """Growing neural gas as a map that curiosity can use; equal arguments give the same object.

    Args:
      capacity: N, at least 2.
      size: D, entries of a stimulus.
    """
    return Map(
        capacity=capacity,
        init=lambda key, hyper: init(key, capacity, size, hyper.map_init_range),
        update=lambda state, stimulus, hyper, enabled: update(state, stimulus, hyper=hyper, enabled=enabled),
        nodes=lambda state: Nodes(state.live, state.weights, state.ages >= 0),
        counts=lambda state: {"live_nodes": jnp.sum(state.live, dtype=jnp.int32), "overflow": state.overflow},
    )
