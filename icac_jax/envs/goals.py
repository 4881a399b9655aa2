"""One goal per seed: which it is, drawn on the host before training and always the same for a seed.

The draw depends on the root seed, the seed and the task alone. So learners and settings are compared on the same goals,
and a seed has its goal in whatever company it trains, is resumed, evaluated or shown.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from icac_jax.envs import oracle, reach, tasks, walls
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError, check_record, param

# Of the generator of goals, which shares the root seed with nothing else.
_STREAM = 0x60A1
# Configurations looked at together, and the most of them; the stream of draws is the same whatever the batches are.
_BATCHES = (8, 24, *[256] * 100)


@dataclasses.dataclass(frozen=True)
class GoalOptions:
    """Where goals come from."""

    goal_per: Literal["episode", "seed"] = param(
        "episode", "whose a goal is: each episode's, or a seed's for good", source="own"
    )
    goal_joint_low: tuple[float, ...] = param(
        (), "lowest joints at a seed's goal; goal_range if not given", unit="deg", source="own"
    )
    goal_joint_high: tuple[float, ...] = param((), "highest joints at a seed's goal", unit="deg", source="own")
    goal_distance_low: float = param(
        0.0,
        "least distance of a seed's goal, by the oracle",
        unit="steps",
        source="own",
        low=0.0,
    )
    goal_distance_high: float = param(
        math.inf, "largest distance of a seed's goal, by the oracle", unit="steps", source="own", low=1.0
    )


def options(**said: Any) -> GoalOptions:
    """Where goals come from, with joints in any sequence of numbers; `check` still has to see it with the task.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    for name in ("goal_joint_low", "goal_joint_high"):
        if isinstance(said.get(name), Sequence | np.ndarray) and not isinstance(said[name], str):
            said[name] = tuple(np.asarray(said[name]).tolist())
    found = GoalOptions(**said)
    check_record(found)
    return found


def check(params: ReachParams, options: GoalOptions, task: str) -> None:
    """Checks what goals are asked for.

    Args:
      params: Python numbers of the task.
      options: where goals come from.
      task: its name; another one than `reach` may have set what `goal_per` episode has no use for.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    if options.goal_per == "episode":
        for field in dataclasses.fields(options):
            if task == tasks.REACH and getattr(options, field.name) != field.default:
                raise ConfigError(f"{field.name}: only with goal_per seed")
        return
    if params.goal_joints:
        raise ConfigError("goal_joints: must be left out with goal_per seed, which draws them; episode takes them")
    joints = len(params.joint_low)
    for name in ("goal_joint_low", "goal_joint_high"):
        if len(getattr(options, name)) not in (0, joints):
            raise ConfigError(f"{name}: must be {joints} numbers, got {len(getattr(options, name))}")
    slack = 1e-9  # of a range that went through radians
    for below, least, most, above in zip(params.joint_low, *_region(params, options), params.joint_high, strict=True):
        if not below - slack <= least <= most <= above + slack:
            raise ConfigError(
                f"goal_joint_low: must be at most goal_joint_high, both in the joint limits {below:g} to {above:g}, "
                f"got {least:g} and {most:g}"
            )
    low, high = options.goal_distance_low, options.goal_distance_high
    if low > high:
        raise ConfigError(f"goal_distance_low: must be at most goal_distance_high, got {low:g} and {high:g}")


def _region(params: ReachParams, options: GoalOptions) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest joints [J] of goals, in degrees: as asked for, else as episodes draw theirs."""
    low, high = (np.degrees(reach.placed(params, np.full((2, len(params.joint_low)), end))[1]) for end in (-0.5, 0.5))
    return (
        np.array(options.goal_joint_low) if options.goal_joint_low else low,
        np.array(options.goal_joint_high) if options.goal_joint_high else high,
    )


def of_seed(arm: ArmSpec, params: ReachParams, options: GoalOptions, root_seed: int, seed: int) -> ReachParams:
    """The task of a seed: the same numbers, with its goal in them where each seed has one.

    A goal is a configuration drawn uniformly in the range of goals, the first that is in no wall and whose goal zone
    can be reached from the middle of the starts, at such a distance as is asked for.

    Args:
      arm: which arm.
      params: Python numbers of the task.
      options: where goals come from.
      root_seed: randomness of the whole run.
      seed: of the learner.

    Raises:
      ConfigError: no goal was found at such a distance.
    """
    if options.goal_per == "episode":
        return params
    joints = _drawn(arm, params, options, root_seed, seed)  # pyright: ignore[reportArgumentType]  (frozen, has a hash)
    return params.replace(goal_joints=joints)


@functools.lru_cache(maxsize=100_000)
def _drawn(arm: ArmSpec, params: ReachParams, options: GoalOptions, root_seed: int, seed: int) -> tuple[float, ...]:
    """Joints [J] at the goal of a seed, in degrees."""
    rng = np.random.default_rng((_STREAM, root_seed, seed))
    boxes = walls.in_rad(params.walls, arm.joints)
    low, high = np.radians(_region(params, options))
    for number in _BATCHES:
        joints = rng.uniform(low, high, (number, arm.joints))
        joints = joints[~walls.within(joints, boxes)]
        steps = oracle.distances(arm, params, oracle.tips(arm, joints))
        near_enough = np.isfinite(steps) & (steps <= options.goal_distance_high)
        found = np.flatnonzero(near_enough & (steps >= options.goal_distance_low))
        if len(found):
            return tuple(np.degrees(joints[found[0]]).tolist())
    raise ConfigError(
        f"goal_distance_low: no goal was found from {options.goal_distance_low:g} to {options.goal_distance_high:g} "
        "control steps from the start"
    )
