"""How many slots of the map a chunk runs with: as few as its lanes need.

A step costs what the slots of the map cost, whether nodes live in them or not (docs/performance.md), and most maps fill
a small part of their capacity. New nodes take the first free slot, so that the first slots of a map behave as the whole
of it until a node finds none free. Lanes therefore train with the first slots alone; a chunk in which a node found none
is run again from its beginning with twice as many. What comes out is the same to the bit.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp

from icac_jax.agents.base import Agent
from icac_jax.rollout import LaneState

LEAST = 64
"""Fewer slots than this cost hardly less (docs/performance.md), and each number of them is a compile."""
# A copy of the lanes is kept while a chunk runs that may have to run again: not where most of them is something else,
# such as a replay buffer.
_LEAST_SPARED = 0.25


class Capacity:
    """The slots that lanes train with, and how they get more.

    Args:
      agent: the learner.
      lanes: the lanes at the beginning, with all of their slots.
      fresh: () -> lanes of the same jobs that know nothing yet; None where the lanes are those.
      waiting: whether jobs wait that may begin with nodes, which the slots need not hold; then lanes have all of them.
    """

    def __init__(
        self, agent: Agent, lanes: LaneState, fresh: Callable[[], LaneState] | None, waiting: bool = False
    ) -> None:
        self.agent, self.sizes, self.place = agent, [] if waiting else _sizes(agent, lanes), 0
        if self.sizes and fresh is not None:
            begun = fresh()
            while not self.is_whole and not bool(_same(whole(self.cut(lanes), begun), lanes)):
                self.place += 1

    @property
    def is_whole(self) -> bool:
        """Whether lanes have all of their slots."""
        return self.place >= len(self.sizes) - 1

    def cut(self, lanes: LaneState) -> LaneState:
        """Lanes with as many of their slots as they train with."""
        return lanes if self.is_whole else _cut(self.agent, self.sizes[self.place], lanes)

    def lacked(self, before: LaneState, after: LaneState) -> bool:
        """Whether a node found no free slot between two states of the same lanes."""
        assert self.agent.slots is not None
        one, two = (self.agent.slots.overflow(lanes.agent) for lanes in (before, after))
        return bool(jnp.any(one != two))

    def more(self, lanes: LaneState, fresh: LaneState) -> LaneState:
        """Lanes with more slots than before; the arguments are those of `whole`."""
        self.place += 1
        return self.cut(whole(lanes, fresh))


def _sizes(agent: Agent, lanes: LaneState) -> list[int]:
    """Numbers of slots to train with, ascending; the last is the capacity. Empty where there is no choice."""
    if agent.slots is None or agent.slots.capacity <= LEAST:
        return []
    spared = _bytes(lanes) - _bytes(jax.eval_shape(functools.partial(_cut, agent, LEAST), lanes))
    if spared < _LEAST_SPARED * _bytes(lanes):
        return []
    found = [LEAST]
    while found[-1] < agent.slots.capacity:
        found.append(min(2 * found[-1], agent.slots.capacity))
    return found


def _bytes(lanes: LaneState) -> int:
    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(lanes))


@functools.partial(jax.jit, static_argnums=(0, 1))
def _cut(agent: Agent, slots: int, lanes: LaneState) -> LaneState:
    """Lanes with the first slots of their maps alone."""
    held = agent.slots
    assert held is not None
    return lanes.replace(agent=jax.vmap(lambda state: held.cut(state, slots))(lanes.agent))


@jax.jit
def whole(lanes: LaneState, fresh: LaneState) -> LaneState:
    """Lanes with all of their slots again.

    Args:
      lanes: by `Capacity.cut`; nothing was ever written beyond their slots.
      fresh: lanes of the same jobs that know nothing yet.
    """

    def one(some: jax.Array, every: jax.Array) -> jax.Array:
        return some if some.shape == every.shape else every.at[tuple(map(slice, some.shape))].set(some)

    return jax.tree.map(one, lanes, fresh)


@jax.jit
def _same(one: LaneState, other: LaneState) -> jax.Array:
    """Whether the learners of lanes are equal."""
    pairs = zip(jax.tree.leaves(one.agent), jax.tree.leaves(other.agent), strict=True)
    return jnp.all(jnp.stack([jnp.array_equal(a, b, equal_nan=_is_float(a)) for a, b in pairs]))


def _is_float(leaf: jax.Array) -> bool:
    return bool(jnp.issubdtype(leaf.dtype, jnp.floating))


@jax.jit
def copied(lanes: LaneState) -> LaneState:
    """Lanes that stay when a chunk consumes the others."""
    return jax.tree.map(jnp.copy, lanes)
