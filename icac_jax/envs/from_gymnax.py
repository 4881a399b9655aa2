"""Worlds of gymnax for the learners here: any with a box of actions, by name. Optional extra `gymnax`.

An observation is scaled to [-1, 1] where the world states its bounds, and left as it is where it does not; an action in
[-1, 1] is scaled to the world's bounds. The world's whole observation is what curiosity maps. An episode that the world
ends by itself is `terminated`, whether that is good or bad there; one that reaches the horizon is `truncated`. The
options of a world are `horizon` and those of learner and run: it has neither joints nor goals.
"""

import functools
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.base import Environment, TimeStep
from icac_jax.fields import ConfigError, close_match

PREFIX = "gymnax:"
# Bounds beyond this are a type's largest number, which stands for none.
_BOUNDED = 1e6
# Steps that no episode has: the horizon is counted here, so that it can be told from an end of the world's own.
_NEVER = 2**30


class WorldState(struct.PyTreeNode):
    """A world under way.

    Attributes:
      inside: the world's own state.
      key: randomness of its steps.
      steps: [] int32, since the episode began.
    """

    inside: Any
    key: jax.Array
    steps: jax.Array


def is_named(name: Any) -> bool:
    """Whether the option `arm` names a world of gymnax."""
    return isinstance(name, str) and name.startswith(PREFIX)


def spec(name: str) -> ArmSpec:
    """What stands in the place of an arm: a name and no joints.

    Args:
      name: such as gymnax:Pendulum-v1.

    Raises:
      ConfigError: gymnax is missing, has no such world, or its actions are not a box.
    """
    _made(name)
    return ArmSpec(name, "", (), (), (), (), (), goal_radius=1.0, goal_reward=0.0)


def horizon(name: str) -> int:
    """Steps after which the world ends an episode where nobody says otherwise."""
    return int(_made(name)[1].max_steps_in_episode)


def _made(name: str) -> tuple[Any, Any]:
    """A world of gymnax and its parameters, checked."""
    try:
        import gymnax
    except ImportError as error:
        raise ConfigError("arm: a world of gymnax needs the extra, pip install 'icac_jax[gymnax]'") from error
    inside = name.removeprefix(PREFIX)
    if inside not in gymnax.registered_envs:
        raise ConfigError(f"arm: gymnax has no world {inside!r}{close_match(inside, gymnax.registered_envs)}")
    try:
        world, params = cast(tuple[Any, Any], gymnax.make(inside))
    except Exception as error:  # some are in its list that it cannot make
        raise ConfigError(f"arm: gymnax cannot make {inside} ({error})") from error
    space = world.action_space(params)
    if not hasattr(space, "low"):
        raise ConfigError(f"arm: {name} has discrete actions, the learners here need a box of them")
    return world, params


def _bounds(space: Any) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half range of a box [n]; 0 and 1 where it has no bounds."""
    shape = (int(np.prod(space.shape)),)
    low, high = (
        np.broadcast_to(np.asarray(end, np.float64), space.shape).reshape(shape) for end in (space.low, space.high)
    )
    known = (np.abs(low) < _BOUNDED) & (np.abs(high) < _BOUNDED) & (low < high)
    middle, half = np.where(known, (low + high) / 2, 0.0), np.where(known, (high - low) / 2, 1.0)
    return middle.astype(np.float32), half.astype(np.float32)


@functools.cache
def make(name: str) -> Environment:
    """A world of gymnax as an environment; the same name gives the same object.

    Its params are any record with a `horizon`.

    Args:
      name: such as gymnax:Pendulum-v1.

    Raises:
      ConfigError: as `spec`.
    """
    world, numbers = _made(name)
    numbers = numbers.replace(max_steps_in_episode=_NEVER)
    seen_space, action_space = world.observation_space(numbers), world.action_space(numbers)
    middle, half = _bounds(seen_space)
    action_middle, action_half = _bounds(action_space)

    def scaled(seen: jax.Array) -> jax.Array:
        return (jnp.reshape(seen, middle.shape).astype(jnp.float32) - middle) / half

    def init(key: jax.Array, params: Any) -> tuple[WorldState, jax.Array]:
        start, steps = jax.random.split(key)
        seen, inside = world.reset_env(start, numbers)
        # Python numbers in a state are weakly typed, and what a step makes of them is not.
        inside = jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, jnp.asarray(leaf).dtype), inside)
        return WorldState(inside, steps, jnp.zeros((), jnp.int32)), scaled(seen)

    def step(state: WorldState, action: jax.Array, params: Any) -> tuple[WorldState, TimeStep]:
        key, now = jax.random.split(state.key)
        told = jnp.reshape(action_middle + action_half * jnp.clip(action, -1, 1), action_space.shape)
        seen, inside, reward, over, *_ = world.step_env(now, state.inside, told, numbers)
        # Some worlds give entries another shape after a step than at the start.
        inside = jax.tree.map(lambda new, old: jnp.reshape(new, old.shape).astype(old.dtype), inside, state.inside)
        steps, terminated = state.steps + 1, jnp.reshape(over, ()).astype(bool)
        reward = jnp.reshape(reward, ()).astype(jnp.float32)
        after = TimeStep(scaled(seen), reward, terminated, ~terminated & (steps >= params.horizon))
        return WorldState(inside, key, steps), after

    size = len(middle)
    return Environment(init, step, observation_size=size, action_size=len(action_middle), state_size=size)
