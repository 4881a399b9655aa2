"""A replay buffer in the lane's own state, and where in its episode a transition lies: what hindsight asks.

One row per transition in one array, so that a step writes one row and a batch is one gather. A write that must not
happen goes to a row beyond the end, which JAX drops: a frozen lane keeps its buffer without a copy of it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.agents.base import Transition


class Experience(NamedTuple):
    """What is kept of a transition.

    Attributes:
      observation: [O] s_t.
      action: [A] a_t as executed.
      next_observation: [O] s_{t+1}, before any reset.
      achieved: [G] the goal that s_{t+1} would have reached; G = 0 where nobody asks.
      reward: [] extrinsic reward.
      bonus: [] intrinsic reward.
      terminated: [] 1 where the goal was reached, else 0.
    """

    observation: jax.Array
    action: jax.Array
    next_observation: jax.Array
    achieved: jax.Array
    reward: jax.Array
    bonus: jax.Array
    terminated: jax.Array

    @classmethod
    def of(cls, transition: Transition, with_goal: bool = True) -> "Experience":
        """What is kept of a transition, its achieved goal only where somebody asks for it."""
        goal = transition.goal
        return cls(
            observation=transition.observation,
            action=transition.action,
            next_observation=transition.next_observation,
            achieved=jnp.zeros(0) if goal is None or not with_goal else goal.achieved,
            reward=transition.reward,
            bonus=jnp.asarray(transition.bonus),
            terminated=jnp.asarray(transition.terminated),
        )

    def without_goal(self) -> "Experience":
        """The same without its achieved goal, for buffers that keep none."""
        return self._replace(achieved=self.achieved[..., :0])


class Replay(struct.PyTreeNode):
    """The last C transitions of a lane.

    Attributes:
      rows: [C, R] the parts of `Experience` side by side.
      episodes: [C] int32, number of the row's episode.
      ends: [C] int32, by number of an episode modulo C: the place of its latest row.
      episode: [] int32, number of the episode under way.
      count: [] int32, transitions seen so far.
    """

    rows: jax.Array
    episodes: jax.Array
    ends: jax.Array
    episode: jax.Array
    count: jax.Array


def init(capacity: int, observation_size: int, action_size: int, goal_size: int) -> Replay:
    """An empty buffer.

    Args:
      capacity: C.
      observation_size: O.
      action_size: A.
      goal_size: G, 0 where achieved goals are not kept.
    """
    return Replay(
        rows=jnp.zeros((capacity, 2 * observation_size + action_size + goal_size + 3)),
        episodes=jnp.zeros(capacity, jnp.int32),
        ends=jnp.zeros(capacity, jnp.int32),
        episode=jnp.zeros((), jnp.int32),
        count=jnp.zeros((), jnp.int32),
    )


def add(replay: Replay, seen: Experience, over: jax.Array, enabled: jax.typing.ArrayLike) -> Replay:
    """The buffer with one more transition, in the place of the oldest once it is full.

    Args:
      replay: the buffer.
      seen: the transition.
      over: [] bool, its episode ended with it.
      enabled: [] bool; where False the buffer comes back unchanged.
    """
    capacity = replay.rows.shape[0]
    place = replay.count % capacity
    write = jnp.where(enabled, place, capacity)
    episode = jnp.where(enabled, replay.episode % capacity, capacity)
    row = jnp.concatenate([jnp.ravel(part).astype(replay.rows.dtype) for part in seen])
    return Replay(
        rows=replay.rows.at[write].set(row, mode="drop"),
        episodes=replay.episodes.at[write].set(replay.episode, mode="drop"),
        ends=replay.ends.at[episode].set(place, mode="drop"),
        episode=replay.episode + (over & enabled),
        count=replay.count + enabled,
    )


def sample(replay: Replay, key: jax.Array, batch: int) -> jax.Array:
    """Places [batch] int32 of transitions drawn uniformly, with replacement; at least one must have been added."""
    capacity = replay.rows.shape[0]
    return jax.random.randint(key, (batch,), 0, jnp.minimum(replay.count, capacity))


def read(replay: Replay, places: jax.Array, observation_size: int, action_size: int) -> Experience:
    """The transitions at places [B], each part [B, ...]."""
    rows = replay.rows[places]
    goal_size = rows.shape[-1] - 2 * observation_size - action_size - 3
    parts, begin = [], 0
    for size in (observation_size, action_size, observation_size, goal_size, 1, 1, 1):
        parts.append(rows[..., begin : begin + size])
        begin += size
    observation, action, next_observation, achieved, *numbers = parts
    reward, bonus, terminated = (column[..., 0] for column in numbers)
    return Experience(observation, action, next_observation, achieved, reward, bonus, terminated)


def steps_left(replay: Replay, places: jax.Array) -> jax.Array:
    """How many later transitions of the same episode there are for each place [B]: int32 [B]."""
    capacity = replay.rows.shape[0]
    return (replay.ends[replay.episodes[places] % capacity] - places) % capacity


def achieved_after(
    replay: Replay, places: jax.Array, steps: jax.Array, observation_size: int, action_size: int
) -> jax.Array:
    """Goals [B, G] achieved a number of transitions [B] after each place [B]."""
    later = (places + steps) % replay.rows.shape[0]
    begin = 2 * observation_size + action_size
    return replay.rows[later, begin:-3]
