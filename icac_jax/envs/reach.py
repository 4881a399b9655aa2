"""Reaching a goal with a serial arm on MuJoCo MJX (Sec. IV): one lane, pure functions.

J is the number of joints. Angles are radians inside, degrees in `ReachParams`.
"""

import contextlib
import dataclasses
import functools
import io
import typing
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from icac_jax import keys
from icac_jax.config import ConfigError, check_record, param, strong
from icac_jax.envs import assets, rendering, scalars
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.base import Environment, TimeStep

try:
    with contextlib.redirect_stdout(io.StringIO()):  # the import prints two lines about an absent warp
        from mujoco import MjData, MjModel, mj_kinematics, mjx  # pyright: ignore  (a compiled module without stubs)
except AttributeError as error:  # what OpenGL's import ends with when MUJOCO_GL=egl and there is no libEGL
    raise ConfigError(rendering.NO_OPENGL) from error

Physics = Literal["servo", "kinematic"]
SUB_STEPS = 3


class ReachParams(struct.PyTreeNode):
    """The traced numbers of the task. Host code holds Python numbers; `traced` makes arrays of them."""

    joint_low: tuple[float, ...] = param(
        (), "lower joint limits", unit="deg", source="Table I; planar2: open point", low=-360.0, high=360.0
    )
    joint_high: tuple[float, ...] = param(
        (), "upper joint limits", unit="deg", source="Table I; planar2: open point", low=-360.0, high=360.0
    )
    reset_range: float = param(
        1.0,
        "central share of the range for starts and goals",
        source="open point",
        low=0.0,
        high=1.0,
        open_low=True,
    )
    action_bound: float = param(
        10.0, "largest joint change a step", unit="deg", source="Sec. IV", low=0.0, high=180.0, open_low=True
    )
    goal_radius: float = param(0.3, "radius of the goal zone", unit="m", source="Sec. IV", low=0.0, open_low=True)
    goal_reward: float = param(50.0, "extrinsic reward in the goal zone", source="Sec. IV")
    horizon: int = param(50, "most steps an episode", unit="steps", source="Sec. IV", low=1, high=10**6)

    def traced(self) -> "ReachParams":
        """The same numbers as strongly typed arrays; joint limits of shape [J]."""
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
    for name in ("joint_low", "joint_high"):
        if isinstance(changes.get(name), Sequence | np.ndarray) and not isinstance(changes[name], str):
            changes[name] = tuple(np.asarray(changes[name]).tolist())
    params = default_params(arm).replace(**changes)
    validate(arm, params)
    return params


def check_physics(physics: str, sub_steps: int) -> None:
    """Checks the choice of physics.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    if physics not in typing.get_args(Physics):
        raise ConfigError(f"physics: must be one of {', '.join(typing.get_args(Physics))}, got {physics!r}")
    if not isinstance(sub_steps, int) or isinstance(sub_steps, bool) or not 1 <= sub_steps <= 1000:
        raise ConfigError(f"sub_steps: must be a whole number at least 1 and at most 1000, got {sub_steps!r}")


def validate(arm: ArmSpec, params: ReachParams) -> None:
    """Checks the task's numbers.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    check_record(params)
    for name in ("joint_low", "joint_high"):
        if len(getattr(params, name)) != arm.joints:
            raise ConfigError(f"{name}: must be {arm.joints} numbers for {arm.name}, got {len(getattr(params, name))}")
    for low, high in zip(params.joint_low, params.joint_high, strict=True):
        if low >= high:
            raise ConfigError(f"joint_low: must be less than joint_high, got {low:g} and {high:g}")


def load_model(arm: ArmSpec) -> MjModel:
    """The arm's MuJoCo model, the same file for MJX and C MuJoCo."""
    return MjModel.from_xml_path(str(assets.path(arm.model)))


def joint_names(arm: ArmSpec) -> tuple[str, ...]:
    """The names of the joints in the model, in the order of every array [J]."""
    model = load_model(arm)
    return tuple(model.joint(joint).name for joint in range(arm.joints))


@functools.cache
def tip_bounds(arm: ArmSpec) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest tip position [3] in m that the arm's links allow at any joint angles: a box about a sphere."""
    model = load_model(arm)
    data = MjData(model)
    mj_kinematics(model, data)
    points = np.concatenate([data.xanchor, data.site("tip").xpos[None]])  # an anchor and the next are on one link
    reach = np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1))
    return points[0] - reach, points[0] + reach


def observation_bounds(arm: ArmSpec) -> tuple[np.ndarray, np.ndarray]:
    """Bounds [J + G] of an observation: +-1 for joints; for goals what `tip_bounds` allows, scaled, at least +-1."""
    axes, low, high = list(arm.goal_axes), np.array(arm.goal_low), np.array(arm.goal_high)
    least, most = (2 * (tip[axes] - low) / (high - low) - 1 for tip in tip_bounds(arm))
    joints = np.ones(arm.joints)
    return np.concatenate([-joints, np.minimum(least, -1.0)]), np.concatenate([joints, np.maximum(most, 1.0)])


@functools.cache
def tip_function(arm: ArmSpec) -> Callable[[jax.Array], jax.Array]:
    """The arm's forward kinematics by `mjx.kinematics`: joints [J] in rad to the tip's position [3] in m."""
    model = load_model(arm)
    site = model.site("tip").id
    mjx_model = mjx.put_model(model, device=jax.local_devices()[0], impl="jax")
    template = mjx.make_data(model, device=jax.local_devices()[0], impl="jax")

    def tip_position(joints: jax.Array) -> jax.Array:
        return mjx.kinematics(mjx_model, template.replace(qpos=joints)).site_xpos[site]

    arithmetic = scalars.unrolled(tip_position, (arm.joints,))
    return lambda joints: arithmetic(joints)[0]


@functools.cache
def step_function(arm: ArmSpec) -> Callable[[jax.Array, jax.Array, jax.Array], list[jax.Array]]:
    """One physics step by `mjx.step`: joints, velocities and servo targets [J] to the new joints and velocities [J]."""
    model = load_model(arm)
    mjx_model = mjx.put_model(model, device=jax.local_devices()[0], impl="jax")
    template = mjx.make_data(model, device=jax.local_devices()[0], impl="jax")

    def physics_step(joints: jax.Array, velocity: jax.Array, target: jax.Array) -> tuple[jax.Array, jax.Array]:
        data = mjx.step(mjx_model, template.replace(qpos=joints, qvel=velocity, ctrl=target))
        return data.qpos, data.qvel

    return scalars.unrolled(physics_step, *[(arm.joints,)] * 3)


def observe(arm: ArmSpec, state: ReachState, params: Any) -> jax.Array:
    """The observation [J + G]: joints and goal coordinates, each scaled to [-1, 1] (Sec. IV).

    Args:
      arm: which arm.
      state: the arm and its goal.
      params: `ReachParams.traced()`.
    """
    low, high = jnp.radians(params.joint_low), jnp.radians(params.joint_high)
    goal_low, goal_high = jnp.array(arm.goal_low), jnp.array(arm.goal_high)
    joints = (state.joints - low) / (high - low)
    goal = (state.goal[jnp.array(arm.goal_axes)] - goal_low) / (goal_high - goal_low)
    return 2.0 * jnp.concatenate([joints, goal]) - 1.0


@functools.cache
def make(arm: ArmSpec, physics: Physics = "servo", sub_steps: int = SUB_STEPS) -> Environment:
    """The reaching task; the same arguments give the same object, and so one compile.

    Args:
      arm: which arm.
      physics: "servo" runs `mjx.step` with position servos, gravity as in the model; "kinematic" puts the joints where
        they were told and runs `mjx.kinematics` only.
      sub_steps: physics steps a control step (servo).

    Returns:
      An environment whose params are `ReachParams.traced()`, whose action is [J] in units of `action_bound`, and whose
      observation is that of `observe`.

    Raises:
      ConfigError: no such physics, or sub_steps out of range.
    """
    check_physics(physics, sub_steps)
    tip_position = tip_function(arm)

    def move_servo(arithmetic: Callable[..., list[jax.Array]]) -> Callable[..., Any]:
        def move(joints: jax.Array, velocity: jax.Array, target: jax.Array) -> list[jax.Array]:
            # A loop: three copies of the arithmetic would take three times as long to compile.
            return jax.lax.fori_loop(0, sub_steps, lambda _, moving: arithmetic(*moving, target), [joints, velocity])

        return move

    def move_kinematic(joints: jax.Array, velocity: jax.Array, target: jax.Array) -> list[jax.Array]:
        return [target, velocity]

    def stop_at_limits(moved: list[jax.Array], params: Any) -> tuple[jax.Array, jax.Array]:
        # The servo's target lies within the limits, the last tenths of a degree of its overshoot may not.
        low, high = jnp.radians(params.joint_low), jnp.radians(params.joint_high)
        joints, velocity = moved
        stopped = jnp.clip(joints, low, high)
        return stopped, jnp.where(stopped == joints, velocity, 0.0)

    move = move_servo(step_function(arm)) if physics == "servo" else move_kinematic

    def init(key: jax.Array, params: Any) -> tuple[ReachState, jax.Array]:
        low, high = jnp.radians(params.joint_low), jnp.radians(params.joint_high)
        draws = keys.uniform(key, (2, arm.joints), -0.5, 0.5)
        start, goal_joints = (low + high) / 2 + params.reset_range * (high - low) * draws
        state = ReachState(
            joints=start,
            velocity=jnp.zeros_like(start),
            goal=tip_position(goal_joints),
            steps=jnp.zeros((), jnp.int32),
        )
        return state, observe(arm, state, params)

    def step(state: ReachState, action: jax.Array, params: Any) -> tuple[ReachState, TimeStep]:
        low, high = jnp.radians(params.joint_low), jnp.radians(params.joint_high)
        change = jnp.radians(params.action_bound) * action
        target = jnp.clip(state.joints + change, low, high)
        joints, velocity = stop_at_limits(move(state.joints, state.velocity, target), params)
        new_state = state.replace(joints=joints, velocity=velocity, steps=state.steps + 1)
        terminated = jnp.linalg.norm(tip_position(joints) - state.goal) <= params.goal_radius
        return new_state, TimeStep(
            observation=observe(arm, new_state, params),
            reward=jnp.where(terminated, params.goal_reward, 0.0),
            terminated=terminated,
            truncated=~terminated & (new_state.steps >= params.horizon),
        )

    return Environment(init=init, step=step)
