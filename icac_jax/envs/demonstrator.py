"""Demonstrations: episodes of a demonstrator that knows the way, the oracle's planner, with or without noise.

T is the number of transitions, O the size of an observation, J the number of joints, E the number of episodes.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.envs import planner
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.base import Environment
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError
from icac_jax.precision import usual

# Episodes tried per episode wanted, and at least: noise, servos or the goal itself may keep the arm from it.
_TRIES, _LEAST_TRIES = 4, 64
# Always so many together, however few are wanted: what the oracle finds for a pair depends on its company.
_AT_ONCE = 32
# A move of n action bounds takes n steps, rounding aside.
_ROUNDING = 1e-4


class Recorded(NamedTuple):
    """Transitions of whole episodes, one after the other, on the host.

    Attributes:
      observation: [T, O] float32, s_t.
      action: [T, J] float32, a_t as executed, in units of the action bound.
      reward: [T] float32, extrinsic.
      next_observation: [T, O] float32, s_{t+1}.
      terminated: [T] bool, the goal was reached.
      achieved: [T, 3] float32, place of the tip at s_{t+1}, in m.
      episode: [T] int32, number of the episode, from 0.
    """

    observation: np.ndarray
    action: np.ndarray
    reward: np.ndarray
    next_observation: np.ndarray
    terminated: np.ndarray
    achieved: np.ndarray
    episode: np.ndarray

    @property
    def episodes(self) -> int:
        """How many episodes there are."""
        return int(self.episode[-1]) + 1 if len(self.episode) else 0

    def first(self, episodes: int) -> "Recorded":
        """The first so many episodes."""
        end = int(np.searchsorted(self.episode, episodes))
        return Recorded(*(column[:end] for column in self))


def demonstrate(
    arm: ArmSpec, env: Environment, params: ReachParams, key: jax.Array, episodes: int, noise: float = 0.0
) -> Recorded:
    """Episodes of the planner, each from a start to a goal drawn as the task draws them; all end in the goal zone.

    The planner chooses a posture with the tip in the goal zone (`planner.postures`) and goes there in a straight line
    of joint space, from wherever noise or the servos have taken it. An episode that runs out of time is left out, and
    another one drawn. Episode k is the same whatever their number is.

    Args:
      arm: which arm.
      env: its world, by `reach.make`.
      params: Python numbers of the task.
      key: what starts, goals and noise are drawn from.
      episodes: how many.
      noise: standard deviation of the Gaussian noise on each action, in units of the action bound.

    Raises:
      ConfigError: there are walls, or too few episodes reach their goal.
    """
    traced, found, taken, tried = params.traced(), [], 0, 0
    while taken < episodes:
        if tried >= max(_TRIES * episodes, _LEAST_TRIES):
            raise ConfigError(
                f"demonstrations: must be possible, the oracle reached {taken} of {tried:,} goals within "
                f"{params.horizon} steps; less demonstration_noise or a longer horizon helps"
            )
        numbers = jnp.arange(tried, tried + _AT_ONCE)
        start = jax.device_get(_starts(env, traced, key, numbers))
        posture = planner.postures(arm, params, np.asarray(start.joints, float), np.asarray(start.goal, float))
        rows = _played(env, traced, key, numbers, jnp.asarray(posture), jnp.asarray(noise), length=params.horizon)
        *columns, inside = jax.device_get(rows)
        reached = np.flatnonzero((columns[4] & inside).any(axis=1))[: episodes - taken]
        for place in reached:
            mine = [column[place][inside[place]] for column in columns]
            found.append(Recorded._make([*mine, np.full(len(mine[0]), taken, np.int32)]))
            taken += 1
        tried += _AT_ONCE
    if not found:
        sizes = env.observation_size, env.action_size
        shapes = [(0, sizes[0]), (0, sizes[1]), (0,), (0, sizes[0]), (0,), (0, 3), (0,)]
        kinds = [np.float32] * 4 + [np.bool_, np.float32, np.int32]
        return Recorded(*(np.zeros(shape, kind) for shape, kind in zip(shapes, kinds, strict=True)))
    return Recorded._make(map(np.concatenate, zip(*found, strict=True)))


@functools.partial(jax.jit, static_argnames="env")
@usual
def _starts(env: Environment, params: Any, key: jax.Array, numbers: jax.Array) -> Any:
    """The worlds in which episodes [E] begin."""
    return jax.vmap(lambda number: env.init(jax.random.fold_in(key, number), params)[0])(numbers)


@functools.partial(jax.jit, static_argnames=("env", "length"))
@usual
def _played(
    env: Environment,
    params: Any,
    key: jax.Array,
    numbers: jax.Array,
    posture: jax.Array,
    noise: jax.Array,
    *,
    length: int,
) -> tuple[jax.Array, ...]:
    """Episodes [E] towards postures [E, J]: columns [E, length, ...], and whether each row is within its episode."""

    def one(number: jax.Array, posture: jax.Array) -> tuple[jax.Array, ...]:
        episode_key = jax.random.fold_in(key, number)
        noise_key = jax.random.fold_in(episode_key, 1)
        state, observation = env.init(episode_key, params)
        goal = env.goal
        assert goal is not None  # every arm has one

        def step(carry: tuple, time: jax.Array) -> tuple[tuple, tuple]:
            state, observation, over = carry
            change = (posture - state.joints) / jnp.radians(params.action_bound)
            planned = change / jnp.maximum(1.0, jnp.ceil(jnp.max(jnp.abs(change)) - _ROUNDING))
            noisy = planned + noise * jax.random.normal(jax.random.fold_in(noise_key, time), planned.shape)
            action = jnp.clip(noisy, -1.0, 1.0)
            stepped, seen = env.step(state, action, params)
            achieved = goal.achieved(stepped)
            row = observation, action, seen.reward, seen.observation, seen.terminated, achieved, ~over
            return (stepped, seen.observation, over | seen.terminated | seen.truncated), row

        return jax.lax.scan(step, (state, observation, jnp.zeros((), bool)), jnp.arange(length))[1]

    return jax.vmap(one)(numbers, posture)
