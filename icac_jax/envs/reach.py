"""Reaching a goal with a serial arm on MuJoCo MJX (Sec. IV): one lane, pure functions.

J is the number of joints. Angles are radians inside, degrees in `ReachParams`.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from icac_jax.envs import walls
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.base import Environment, Goal, TimeStep
from icac_jax.envs.model import tip_bounds
from icac_jax.envs.physics import PHYSICS, SUB_STEPS, Cache, Move, Physics, check_physics, once, tip_function
from icac_jax.fast import threefry
from icac_jax.fields import ConfigError, check_record, param, strong

# Joints that turn for ever have ranges of several turns; at a hundred of them float32 still tells 0.004 degrees apart.
_TURNS = 36_000.0
_PER_JOINT = ("joint_low", "joint_high", "start_offset")


class ReachParams(struct.PyTreeNode):
    """The traced numbers of the task. Host code holds Python numbers; `traced` makes arrays of them."""

    joint_low: tuple[float, ...] = param(
        (), "lower joint limits", unit="deg", source="Table I; planar2: open point", low=-_TURNS, high=_TURNS
    )
    joint_high: tuple[float, ...] = param(
        (), "upper joint limits", unit="deg", source="Table I; planar2: open point", low=-_TURNS, high=_TURNS
    )
    reset_range: float = param(
        1.0,
        "central share of the range for starts and goals",
        source="open point",
        low=0.0,
        high=1.0,
        open_low=True,
    )
    start_range: float = param(
        1.0, "share of that for starts; 0 starts every episode alike", source="own", low=0.0, high=1.0, neutral=1.0
    )
    goal_range: float = param(
        1.0, "share of that for the joints of goals", source="own", low=0.0, high=1.0, neutral=1.0
    )
    start_offset: tuple[float, ...] = param(
        (),
        "where the middle of the starts lies, from the range's",
        unit="deg",
        source="own",
        low=-_TURNS,
        high=_TURNS,
        neutral=0.0,
    )
    action_bound: float = param(
        10.0, "largest joint change a step", unit="deg", source="Sec. IV", low=0.0, high=180.0, open_low=True
    )
    goal_radius: float = param(0.3, "radius of the goal zone", unit="m", source="Sec. IV", low=0.0, open_low=True)
    goal_reward: float = param(50.0, "extrinsic reward in the goal zone", source="Sec. IV")
    walls: tuple[float, ...] = param(
        (),
        "boxes that stop the joints: all lowest, then all highest",
        unit="deg",
        source="own",
        low=-_TURNS,
        high=_TURNS,
        neutral=math.nan,
        nested=True,  # a box in a list of its own is easier to read
    )
    goal_joints: tuple[float, ...] = param(
        (),
        "joints at the goal; drawn if not given",
        unit="deg",
        source="own",
        low=-_TURNS,
        high=_TURNS,
        neutral=math.nan,
    )
    step_cost: float = param(0.0, "taken from the reward of each step short of the goal", source="own", neutral=0.0)
    horizon: int = param(50, "most steps an episode", unit="steps", source="Sec. IV", low=1, high=10**6)

    def traced(self) -> "ReachParams":
        """The same numbers as strongly typed arrays; joint limits and the start's offset of shape [J]."""
        return strong(self)


class ReachState(struct.PyTreeNode):
    """The arm and its goal.

    Attributes:
      joints: [J] joint angles, rad.
      velocity: [J] joint velocities, rad/s.
      goal: [3] goal position, m.
      steps: [] int32, steps since the episode began.
    """

    joints: jax.Array
    velocity: jax.Array
    goal: jax.Array
    steps: jax.Array


def default_params(arm: ArmSpec) -> ReachParams:
    """The arm's own limits, goal radius, reward and reset range; the rest as declared. The task of preset `paper`."""
    return ReachParams(
        joint_low=arm.joint_low,
        joint_high=arm.joint_high,
        goal_radius=arm.goal_radius,
        goal_reward=arm.goal_reward,
        reset_range=arm.reset_range,
        start_offset=(0.0,) * arm.joints,
    )


def task(arm: ArmSpec, **changes: Any) -> ReachParams:
    """The arm's default numbers with some of them changed, as Python numbers, checked.

    Args:
      arm: which arm.
      **changes: fields of `ReachParams` by name; joint limits in any sequence of numbers.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    names = [field.name for field in dataclasses.fields(ReachParams)]  # pyright: ignore[reportArgumentType]
    for name in changes:
        if name not in names:
            raise ConfigError(f"{name}: no such number of the task; there are {', '.join(names)}")
    for name in (*_PER_JOINT, "walls", "goal_joints"):
        if isinstance(changes.get(name), Sequence | np.ndarray) and not isinstance(changes[name], str):
            changes[name] = tuple(np.asarray(changes[name]).ravel().tolist())
    params = default_params(arm).replace(**changes)
    validate(arm, params)
    return params


def validate(arm: ArmSpec, params: ReachParams) -> None:
    """Checks the task's numbers.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    check_record(params)
    for name in _PER_JOINT:
        if len(getattr(params, name)) != arm.joints:
            raise ConfigError(f"{name}: must be {arm.joints} numbers for {arm.name}, got {len(getattr(params, name))}")
    for low, high in zip(params.joint_low, params.joint_high, strict=True):
        if low >= high:
            raise ConfigError(f"joint_low: must be less than joint_high, got {low:g} and {high:g}")
    for low, high, offset in zip(params.joint_low, params.joint_high, params.start_offset, strict=True):
        room = (high - low) / 2 * (1 - params.reset_range * params.start_range)
        if abs(offset) > room:
            raise ConfigError(
                f"start_offset: must leave starts within the joint limits, at most {room:g}, got {offset:g}"
            )
    if params.goal_joints:
        if len(params.goal_joints) != arm.joints:
            raise ConfigError(
                f"goal_joints: must be {arm.joints} numbers for {arm.name}, got {len(params.goal_joints)}"
            )
        for low, high, joint in zip(params.joint_low, params.joint_high, params.goal_joints, strict=True):
            if not low <= joint <= high:
                raise ConfigError(f"goal_joints: must be within the joint limits, {low:g} to {high:g}, got {joint:g}")
    walls.check(params.walls, params.joint_low, params.joint_high)
    lowest, highest = (np.degrees(placed(params, np.full((2, arm.joints), end))[0]) for end in (-0.5, 0.5))
    for low, high in walls.boxes(np.asarray(params.walls, float), arm.joints):
        if np.all(lowest <= high) and np.all(highest >= low):
            raise ConfigError("walls: must leave out where episodes start (start_range, start_offset, reset_range)")


def placed(params: ReachParams, draws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joints [..., J] in rad at the start and at the goal, as `init` places them, in float64 on the host.

    Args:
      params: Python numbers of the task.
      draws: [2, ..., J] uniform in +-1/2.
    """
    low, high = np.radians(params.joint_low), np.radians(params.joint_high)
    middle, extent = (low + high) / 2, params.reset_range * (high - low)
    start = middle + np.radians(params.start_offset) + params.start_range * extent * draws[0]
    if params.goal_joints:
        return start, np.broadcast_to(np.radians(params.goal_joints), start.shape)
    return start, middle + params.goal_range * extent * draws[1]


def observation_bounds(arm: ArmSpec) -> tuple[np.ndarray, np.ndarray]:
    """Bounds [J + G] of an observation: +-1 for joints; for goals what `tip_bounds` allows, scaled, at least +-1."""
    axes, low, high = list(arm.goal_axes), np.array(arm.goal_low), np.array(arm.goal_high)
    least, most = (2 * (tip[axes] - low) / (high - low) - 1 for tip in tip_bounds(arm))
    joints = np.ones(arm.joints)
    return np.concatenate([-joints, np.minimum(least, -1.0)]), np.concatenate([joints, np.maximum(most, 1.0)])


def _single(numbers: Any) -> Any:
    """The task's numbers, or an array, in the types that it is computed in whatever JAX's own are."""
    return jax.tree.map(
        lambda n: jnp.asarray(n, jnp.int32 if jnp.issubdtype(jnp.result_type(n), jnp.integer) else jnp.float32), numbers
    )


def observe(arm: ArmSpec, state: ReachState, params: Any) -> jax.Array:
    """The observation [J + G]: joints and goal coordinates, each scaled to [-1, 1] (Sec. IV).

    Args:
      arm: which arm.
      state: the arm and its goal.
      params: `ReachParams.traced()`.
    """
    params = _single(params)
    low, high = jnp.radians(params.joint_low), jnp.radians(params.joint_high)
    goal_low, goal_high = jnp.array(arm.goal_low, jnp.float32), jnp.array(arm.goal_high, jnp.float32)
    joints = (state.joints - low) / (high - low)
    goal = (_observed(arm, state.goal) - goal_low) / (goal_high - goal_low)
    return 2.0 * jnp.concatenate([joints, goal]) - 1.0


def _observed(arm: ArmSpec, position: jax.Array) -> jax.Array:
    """The coordinates [G] of a position [3] that the observation holds."""
    return jnp.stack([position[axis] for axis in arm.goal_axes])


def relabel(arm: ArmSpec, observation: jax.Array, goal: jax.Array) -> jax.Array:
    """The observation [J + G] with another goal [3], in m, in the place of its own."""
    low, high = jnp.array(arm.goal_low, jnp.float32), jnp.array(arm.goal_high, jnp.float32)
    scaled = 2.0 * ((_observed(arm, _single(goal)) - low) / (high - low)) - 1.0
    return jnp.concatenate([observation[: arm.joints], scaled])


def make(
    arm: ArmSpec, physics: Physics = "servo", sub_steps: int = SUB_STEPS, *, cache: Cache | None = None
) -> Environment:
    """The reaching task; the same arm, physics and sub-steps give the same object, and so one compile.

    Args:
      arm: which arm.
      physics: "servo" runs `mjx.step` with position servos, gravity as in the model; "kinematic" puts the joints where
        they were told and runs `mjx.kinematics` only. Any name in `physics.PHYSICS`.
      sub_steps: physics steps per control step (servo).
      cache: where what is traced from MJX is kept; without one it is traced in each process, which takes seconds.

    Returns:
      An environment whose functions take `ReachParams.traced()`, whose action is [J] in units of `action_bound`, whose
      observation is that of `observe`, and whose goals are positions of the tip, [3] in m.

    Raises:
      ConfigError: no such physics, or sub_steps out of range.
    """
    check_physics(physics, sub_steps)
    return _make(arm, PHYSICS[physics], sub_steps, cache=cache)


@once
def _make(arm: ArmSpec, physics: Callable[..., Move], sub_steps: int, *, cache: Cache | None) -> Environment:
    move, tip_position = physics(arm, sub_steps, cache), tip_function(arm, cache=cache)

    def stop_at_limits(moved: tuple[jax.Array, jax.Array], params: Any) -> tuple[jax.Array, jax.Array]:
        # The servo's target lies within the limits, the last tenths of a degree of its overshoot may not.
        low, high = jnp.radians(params.joint_low), jnp.radians(params.joint_high)
        joints, velocity = moved
        stopped = jnp.clip(joints, low, high)
        return stopped, jnp.where(stopped == joints, velocity, 0.0)

    def reached(achieved: jax.Array, goal: jax.Array, params: Any) -> jax.Array:
        return jnp.linalg.norm(achieved - goal) <= _single(params).goal_radius

    def reward(reached: jax.Array, params: Any) -> jax.Array:
        params = _single(params)
        return jnp.where(reached, params.goal_reward, 0.0 if params.step_cost is None else -params.step_cost)

    def init(key: jax.Array, params: Any) -> tuple[ReachState, jax.Array]:
        params = _single(params)
        low, high = jnp.radians(params.joint_low), jnp.radians(params.joint_high)
        draws = threefry.uniform(key, (2, arm.joints), -0.5, 0.5)
        middle, extent = (
            (jnp.broadcast_to(n, draws.shape)) for n in ((low + high) / 2, params.reset_range * (high - low))
        )
        start_share, goal_share = params.start_range, params.goal_range
        if start_share is not None or goal_share is not None:
            shares = jnp.stack([jnp.float32(1.0 if share is None else share) for share in (start_share, goal_share)])
            extent = extent * shares[:, None]
        start, goal_joints = middle + extent * draws
        if params.start_offset is not None:
            start = start + jnp.radians(params.start_offset)
        if params.goal_joints is not None:
            goal_joints = jnp.radians(params.goal_joints)
        state = ReachState(
            joints=start,
            velocity=jnp.zeros_like(start),
            goal=tip_position(goal_joints),
            steps=jnp.zeros((), jnp.int32),
        )
        return state, observe(arm, state, params)

    def step(state: ReachState, action: jax.Array, params: Any) -> tuple[ReachState, TimeStep]:
        params, action = _single(params), _single(action)
        low, high = jnp.radians(params.joint_low), jnp.radians(params.joint_high)
        change = jnp.radians(params.action_bound) * action
        target = jnp.clip(state.joints + change, low, high)
        joints, velocity = stop_at_limits(move(state.joints, state.velocity, target), params)
        if params.walls is not None:
            boxes = walls.boxes(jnp.radians(params.walls), arm.joints)
            joints, velocity = walls.stop(state.joints, joints, velocity, boxes)
        new_state = state.replace(joints=joints, velocity=velocity, steps=state.steps + 1)
        terminated = reached(tip_position(joints), state.goal, params)
        return new_state, TimeStep(
            observation=observe(arm, new_state, params),
            reward=reward(terminated, params),
            terminated=terminated,
            truncated=~terminated & (new_state.steps >= params.horizon),
        )

    return Environment(
        init=init,
        step=step,
        observation_size=arm.observation_size,
        action_size=arm.joints,
        state_size=arm.joints,
        params=default_params(arm),
        goal=Goal(
            size=3,
            achieved=lambda state: tip_position(state.joints),
            desired=lambda state: state.goal,
            reached=reached,
            reward=reward,
            relabel=functools.partial(relabel, arm),
        ),
    )
