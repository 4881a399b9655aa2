"""Arms of one's own: a TOML file beside a MuJoCo model, a folder with one such file, or a model file and its tip."""

import functools
import os
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from icac_jax.console import shown
from icac_jax.envs import arm_tables, arms, goals, reach, tasks
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import check_actuators, has_actuators, joint_ranges, tip_box
from icac_jax.envs.model_files import ModelFiles
from icac_jax.fields import ConfigError

_TOML = ".toml"
MODELS = (".xml", ".mjcf", ".urdf")
_SAMPLES = 20_000
_AXES = ("x", "y", "z")
_TURN = (-180.0, 180.0)  # a joint of a model file that has no range


class Own(NamedTuple):
    """An arm of one's own.

    Attributes:
      path: of the file it was given by, whole.
      arm: its numbers.
      defaults: the options that its file sets, and the physics it can be run in if not in servo.
      tasks: by name, the options that each task of its file sets.
      sha256: of all of its files.
    """

    path: str
    arm: ArmSpec
    defaults: dict[str, Any]
    tasks: dict[str, dict[str, Any]]
    sha256: str


def is_own(name: str) -> bool:
    """Whether the name of an arm is a path, and not of the package."""
    return isinstance(name, str) and name not in arms.ARMS and (_named_so(name) or _is_folder(name))


def _named_so(name: str) -> bool:
    return name.lower().endswith((_TOML, *MODELS))


def _is_folder(name: str) -> bool:
    try:
        return bool(name) and Path(os.path.expanduser(name)).is_dir()
    except (OSError, ValueError):
        return False


def whole(name: str) -> str:
    """The option `arm` as runs keep it: the path of an own arm's file without regard to the current folder.

    Raises:
      ConfigError: it is a folder without a TOML file, or with several.
    """
    if not is_own(name):
        return name
    path = Path(os.path.expanduser(name))
    if _is_folder(name):
        inside = sorted(path.glob(f"*{_TOML}"))
        if len(inside) != 1:
            had = ", ".join(file.name for file in inside) or "none"
            raise ConfigError(f"arm: the folder {shown(path)} must hold one .toml file, it has {shown(had)}")
        path = inside[0]
    try:
        return str(path.resolve())
    except (OSError, ValueError, RuntimeError) as error:
        raise ConfigError(f"arm: cannot read {shown(path)}: {error}") from error


def files_of(path: Path) -> ModelFiles:
    """The files of the model of an own arm, given by its TOML file or the model itself.

    Raises:
      ConfigError: one of them cannot be read or is not valid.
    """
    model = path.parent / arm_tables.of_toml(path)["model"] if path.suffix.lower() == _TOML else path
    if not model.exists():
        raise ConfigError(f"model: there is no file {shown(model)}")
    return ModelFiles(model)


def find(name: str, tip: str = "") -> Own:
    """The own arm of this path.

    Args:
      name: path of a TOML file, of a folder with one, or of a model file.
      tip: of a model file, the site or body that must reach the goal; "" for a site "tip", or the only site.

    Raises:
      ConfigError: a file cannot be read or is not valid, or a tip is given where the TOML file names it.
    """
    path = Path(whole(name))
    from_toml = path.suffix.lower() == _TOML
    if from_toml and tip:
        raise ConfigError(f"tip: only for an arm given as a model file; {shown(path)} has a key tip")
    if not from_toml and not path.exists():
        raise ConfigError(f"arm: cannot read {shown(path)}: No such file or directory")
    if from_toml:
        arm_tables.of_toml(path)
    try:
        sha256 = files_of(path).checksum((path,) if from_toml else ())
        return _own(str(path), tip, sha256)
    except ConfigError as error:
        if str(error).startswith((f"{path}: ", f"arm: {path}: ")):
            raise
        raise ConfigError(f"{shown(path)}: {error}") from error


def get(arm: str | os.PathLike[str] | ArmSpec) -> tuple[ArmSpec, dict[str, Any], dict[str, dict[str, Any]]]:
    """An arm, the options that come with it and its tasks, from whatever Python code may give for one.

    Args:
      arm: the name of an arm of the package, a path as `find` takes it, or the arm itself.

    Raises:
      ConfigError: there is none, or a file of it is not valid.
    """
    if isinstance(arm, os.PathLike):
        arm = os.fspath(arm)
    if isinstance(arm, ArmSpec):
        its_tasks = tasks.TASKS[arm.name] if arms.ARMS.get(arm.name) == arm else {}
        return arm, {} if has_actuators(arm) else {"physics": "kinematic"}, its_tasks
    if is_own(arm):
        own = find(arm)
        return own.arm, own.defaults, own.tasks
    return arms.get(arm), {}, tasks.TASKS[arm]


def for_world(
    arm: str | os.PathLike[str] | ArmSpec,
    physics: str | None,
    sub_steps: int | None,
    task: str,
    goal_seed: int,
    numbers: dict[str, Any],
) -> tuple[ArmSpec, reach.ReachParams, str, int]:
    """What a world of other libraries is made of.

    Args:
      arm: as `get` takes it.
      physics: the name of one, None for the arm's.
      sub_steps: physics steps per control step, None for the arm's.
      task: the name of a task.
      goal_seed: whose goal it is where each seed has one.
      numbers: numbers of the task and where goals come from, by name; the others are the task's, then the arm's.

    Returns:
      The arm, the numbers of the task, physics and sub-steps.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    found, defaults, its_tasks = get(arm)
    said = defaults | tasks.options_of(task, found.name, its_tasks)
    of_task, of_goals = reach.ReachParams.__dataclass_fields__, goals.GoalOptions.__dataclass_fields__
    said = {name: value for name, value in said.items() if name in of_task or name in of_goals} | numbers
    params = reach.task(found, **{name: value for name, value in said.items() if name not in of_goals})
    where = goals.options(**{name: value for name, value in said.items() if name in of_goals})
    goals.check(params, where, task)
    if not isinstance(goal_seed, int) or isinstance(goal_seed, bool) or goal_seed < 0:
        raise ConfigError(f"goal_seed: must be a whole number at least 0, got {goal_seed!r}")
    params = goals.of_seed(found, params, where, 0, goal_seed)
    chosen = (
        (defaults.get("physics", "servo") if physics is None else physics),
        (defaults.get("sub_steps", reach.SUB_STEPS) if sub_steps is None else sub_steps),
    )
    reach.check_physics(*chosen)
    check_actuators(found, chosen[0])
    return found, params, *chosen


@functools.lru_cache(maxsize=64)
def _own(name: str, tip: str, sha256: str) -> Own:
    """The own arm of a file; cached by its checksum, so a changed file is read again."""
    path = Path(name)
    from_toml = path.suffix.lower() == _TOML
    table = arm_tables.of_toml(path) if from_toml else arm_tables.of_model(path, tip)
    label = table.get("name", path.stem)
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", label) or label in arms.ARMS:
        raise ConfigError(
            f"name: must be letters, digits, _ . - and not {' or '.join(arms.ARMS)}, got {shown(repr(label))}"
        )
    names = tuple(table["joints"])
    blank = (0.0,) * len(names)
    bare = ArmSpec(
        name=label,
        model=str(path.parent / table["model"]),
        goal_axes=_axes(table.get("goal_axes", list(_AXES))),
        goal_low=(),
        goal_high=(),
        joint_low=blank,
        joint_high=blank,
        goal_radius=0.0,
        goal_reward=float(table.get("goal_reward", 100.0)),
        joint_names=names,
        tip=table.get("tip", "tip"),
    )
    joint_low, joint_high = _limits(bare, table, not from_toml)
    box, far = _goal_box(bare, joint_low, joint_high, table, not from_toml)
    arm = bare.__class__(
        **vars(bare)
        | box
        | {
            "joint_low": joint_low,
            "joint_high": joint_high,
            "goal_radius": float(table.get("goal_radius", np.round(far / 8, 3))),
        }
    )
    defaults = {} if has_actuators(arm) else {"physics": "kinematic"}
    return Own(name, arm, defaults | _defaults(table), table.get("tasks", {}), sha256)


def _goal_box(
    arm: ArmSpec, joint_low: tuple[float, ...], joint_high: tuple[float, ...], table: dict[str, Any], choose: bool
) -> tuple[dict[str, Any], float]:
    """Axes and bounds of the goals, by their names in `ArmSpec`, and the reach of the arm in m.

    Args:
      arm: with its joints and tip.
      joint_low: lower limits [J] in degrees.
      joint_high: upper limits [J] in degrees.
      table: what its TOML file says.
      choose: whether axes along which the tip does not move are left out, and not refused.
    """
    low, high, far = tip_box(arm, joint_low, joint_high, _SAMPLES)
    axes = arm.goal_axes
    if choose:
        axes = tuple(axis for axis in axes if high[axis] - low[axis] >= 1e-3 * far) or axes
    # Whole millimetres, outwards: the same box on every machine.
    box = {"goal_low": np.floor(low * 1000) / 1000, "goal_high": np.ceil(high * 1000) / 1000}
    chosen = {key: table.get(key, [float(value) for value in box[key][list(axes)]]) for key in box}
    for key, values in chosen.items():
        if len(values) != len(axes):
            raise ConfigError(f"{key}: must be {len(axes)} numbers, one per goal axis, got {len(values)}")
    for axis, below, above in zip(axes, chosen["goal_low"], chosen["goal_high"], strict=True):
        if above - below < 1e-3 * far or high[axis] - low[axis] < 1e-6:
            raise ConfigError(
                f"goal_axes: along {_AXES[axis]} the tip does not move, or goal_low is not below goal_high"
            )
    return {"goal_axes": axes} | {key: tuple(map(float, values)) for key, values in chosen.items()}, far


def _axes(names: list[str]) -> tuple[int, ...]:
    if not names or len(set(names)) < len(names) or not set(names) <= set(_AXES):
        raise ConfigError(f"goal_axes: must be some of {', '.join(_AXES)}, each once, got {shown(repr(names))}")
    return tuple(_AXES.index(name) for name in names)


def _limits(arm: ArmSpec, table: dict[str, Any], turn: bool) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Lower and upper joint limits in degrees: as given, else the ranges of the model.

    Args:
      arm: with its joints.
      table: what its TOML file says.
      turn: whether a joint without a range gets a full turn, and is not refused.
    """
    if ("joint_low" in table) != ("joint_high" in table):
        raise ConfigError("joint_low: joint_low and joint_high must be given both or neither")
    ranges = joint_ranges(arm)
    limits = table.get("joint_low"), table.get("joint_high")
    if limits[0] is None:
        ranges = [_TURN if limit is None and turn else limit for limit in ranges]
        for name, limit in zip(arm.joint_names, ranges, strict=True):
            if limit is None:
                raise ConfigError(f"joint_low: joint {name!r} has no range in the model; give joint_low and joint_high")
        limits = zip(*ranges, strict=True)  # pyright: ignore[reportArgumentType]
    low, high = (tuple(map(float, limit)) for limit in limits)  # pyright: ignore[reportArgumentType]
    blank = (0.0,) * arm.joints
    reach.validate(arm, reach.ReachParams(joint_low=low, joint_high=high, start_offset=blank))
    return low, high


def _defaults(table: dict[str, Any]) -> dict[str, Any]:
    """The options that the file sets; those that make the arm itself have keys of their own."""
    chosen = table.get("defaults", {})
    for name in ("arm", "arm_sha256", "tip", "preset", "joint_low", "joint_high", "goal_radius", "goal_reward"):
        if name in chosen:
            raise ConfigError(f"defaults: {name} is not an option to be set there")
    return chosen
