"""The self-organising map (Kohonen 1982, 1990), in the online form with a Gaussian neighbourhood.

N nodes on a fixed lattice of some dimensions; each stimulus draws the winner and, the less the farther they are from it
on the lattice, all others. Step size and radius of the neighbourhood decay exponentially (Ritter, Martinetz and
Schulten 1992) for a given number of stimuli, then stay.

All nodes are there from the beginning, and all of them move: none is created or deleted. A node's predictor starts
before the first stimulus and goes with its node, wherever that moves; while the map unfolds, it is asked about a region
that it was not trained on.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.curiosity import lattice, nearest
from icac_jax.curiosity.base import Map, MapInfo, Nodes
from icac_jax.fast.sums import dots
from icac_jax.fields import check_array
from icac_jax.precision import usual


class SomState(struct.PyTreeNode):
    """A map.

    Attributes:
      weights: [N, D] position of each node, in the stimulus' own units.
      steps: [] int32, stimuli so far.
    """

    weights: jax.Array
    steps: jax.Array


@usual
def init(key: jax.Array, capacity: int, size: int, init_range: jax.typing.ArrayLike = 1.0) -> SomState:
    """Nodes at uniform random places in +-`init_range` (Kohonen 1990, Sec. II.C).

    Args:
      key: randomness.
      capacity: N.
      size: D.
      init_range: half-width of the box they are drawn from, in the stimulus' units.
    """
    weights: Any = init_range * jax.random.uniform(key, (capacity, size), minval=-1.0, maxval=1.0)
    return SomState(weights=weights, steps=jnp.zeros((), jnp.int32))


def decayed(first: jax.Array, last: jax.Array, share: jax.Array) -> jax.Array:
    """What was `first` when a `share` of the time has passed: first (last / first)^share [] (Ritter et al. 1992)."""
    return first * (last / first) ** share


@usual
def update(
    state: SomState, stimulus: jax.Array, *, places: Any, hyper: Any, enabled: jax.typing.ArrayLike = True
) -> tuple[SomState, MapInfo]:
    """Draws the nodes towards a stimulus: w_i += a h_i (x - w_i), h_i = exp(-|r_c - r_i|^2 / (2 s^2)).

    Args:
      state: the map.
      stimulus: [D] x.
      places: [N, dimensions] r, where the nodes are on the lattice.
      hyper: `som_rate` and `som_final_rate` (a), `som_radius` and `som_final_radius` (s), `som_decay_steps`.
      enabled: when False nothing is written (a frozen lane).

    Returns:
      The new map and what happened; the distance is that before the winner moved.
    """
    check_array("stimulus", stimulus, (state.weights.shape[1],))
    places = jnp.asarray(places, state.weights.dtype)
    winner, squared = nearest.one(nearest.squares(state.weights, jnp.ones(len(places), bool), stimulus))
    share = jnp.minimum(state.steps.astype(state.weights.dtype) / hyper.som_decay_steps, 1.0)
    rate = decayed(hyper.som_rate, hyper.som_final_rate, share)
    radius = decayed(hyper.som_radius, hyper.som_final_radius, share)
    apart = places - places[winner]
    drawn = rate * jnp.exp(-dots(apart, apart) / (2 * radius**2))
    weights = state.weights + drawn[:, None] * (stimulus - state.weights)
    new_state = SomState(
        weights=jnp.where(jnp.asarray(enabled), weights, state.weights),
        steps=state.steps + jnp.asarray(enabled),
    )
    return new_state, MapInfo(winner, winner, jnp.sqrt(squared), jnp.zeros((), bool))


@functools.cache
def self_organising_map(side: int, dimensions: int, size: int) -> Map:
    """The SOM as a map that curiosity can use; equal arguments give the same object.

    Args:
      side: nodes per dimension of the lattice.
      dimensions: of the lattice.
      size: D, entries of a stimulus.

    Raises:
      ConfigError: there would be more nodes than a map may have.
    """
    capacity = lattice.size("som_side", side, dimensions)
    places = lattice.places(side, dimensions)

    def step(state: SomState, stimulus: jax.Array, hyper: Any, enabled: Any) -> tuple[SomState, MapInfo]:
        return update(state, stimulus, places=places, hyper=hyper, enabled=enabled)

    return Map(
        capacity=capacity,
        init=lambda key, hyper: init(key, capacity, size, hyper.map_init_range),
        update=step,
        nodes=lambda state: Nodes(jnp.ones(capacity, bool), state.weights, lattice.neighbours(side, dimensions)),
        counts=lambda state: {"live_nodes": jnp.full((), capacity, jnp.int32)},
    )
