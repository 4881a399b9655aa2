"""The settings of a run: one flat table of options, resolved from a preset and what the user said.

Python, the command line, configuration files and sweeps all go through `resolve`.
"""

import dataclasses
import difflib
from typing import Any

from icac_jax import fields
from icac_jax.envs import arms, reach
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import check_actuators
from icac_jax.envs.physics import SUB_STEPS, Physics
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError, Hyper, Spec, param
from icac_jax.settings import arm_files


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """What a run is, beside the learner's and the task's own numbers."""

    arm: str = param("planar2", f"which arm: {', '.join(arms.ARMS)}, or an own arm's .toml", source="Sec. IV")
    arm_sha256: str = param("", "checksum of an own arm's files, filled in by itself", source="own")
    preset: str = param("paper", "defaults: paper or paper-literal", source="open points")
    physics: Physics = param("servo", "mjx.step with servos, or kinematics only", source="own")
    sub_steps: int = param(SUB_STEPS, "physics steps a control step (servo)", source="own", low=1, high=1000)
    seeds: int = param(20, "learners, seeds 0 to seeds - 1", source="Sec. IV", low=1, high=10**7)
    episodes: int = param(1000, "episodes a learner", source="Sec. IV", low=1, high=10**9)
    root_seed: int = param(0, "randomness of the whole run", source="own", low=0, high=2**32 - 1)


# Set by the arm, not by the user.
_DERIVED = ("observation_size", "state_size", "action_size")
_RECORDS = (RunOptions, Spec, ReachParams, Hyper)

OPTIONS: dict[str, dataclasses.Field] = {
    field.name: field for record in _RECORDS for field in dataclasses.fields(record) if field.name not in _DERIVED
}


@dataclasses.dataclass(frozen=True)
class Settings:
    """Everything that determines a run's results on a given platform.

    Attributes:
      run: arm, physics, seeds, episodes.
      spec: the learner's static choices.
      hyper: the learner's traced numbers.
      params: the task's traced numbers.
      arm: the arm that `run.arm` names.
    """

    run: RunOptions
    spec: Spec
    hyper: Hyper
    params: ReachParams
    arm: ArmSpec

    def flat(self) -> dict[str, Any]:
        """Every option by name, in the order of declaration; `resolve(**flat)` gives the same settings."""
        records = (self.run, self.spec, self.params, self.hyper)
        return {
            field.name: getattr(record, field.name)
            for record in records
            for field in dataclasses.fields(record)
            if field.name in OPTIONS
        }


def defaults(arm: str = "planar2", preset: str = "paper") -> dict[str, Any]:
    """The value of every option for an arm and a preset, before the user changes any.

    Raises:
      ConfigError: no such arm or preset, or the file of an own arm is not valid.
    """
    found = arm_files.find(arm)
    if preset not in found.presets:
        raise ConfigError(f"preset: must be one of {', '.join(found.presets)}, got {preset!r}")
    task = reach.default_params(found.arm)
    values = {name: field.default for name, field in OPTIONS.items()}
    values |= {field.name: getattr(task, field.name) for field in dataclasses.fields(task)}
    values |= {"arm": found.name, "arm_sha256": found.sha256, "preset": preset}
    _check_names(found.presets[preset])
    return values | {name: typed(name, value) for name, value in found.presets[preset].items()}


def _check_names(options: dict[str, Any]) -> None:
    for name in options:
        if name not in OPTIONS:
            close = difflib.get_close_matches(name, OPTIONS, n=1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise ConfigError(f"{name}: no such option{hint}")


def typed(name: str, value: Any) -> Any:
    """Takes what a file may hold for an option to what Python holds: lists to tuples, whole floats stay floats."""
    if OPTIONS[name].type in (tuple[float, ...],) and isinstance(value, list | tuple):
        return tuple(
            float(item) if isinstance(item, int) and not isinstance(item, bool) and abs(item) < 2**1000 else item
            for item in value
        )
    if OPTIONS[name].type is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value) if abs(value) < 2**1000 else value
    return value


def _pick(record: type, values: dict[str, Any], **derived: Any) -> Any:
    names = [field.name for field in dataclasses.fields(record)]
    return record(**{name: values[name] for name in names if name in values}, **derived)


def resolve(**options: Any) -> Settings:
    """Settings from the options that the user gave; the rest comes from the preset of the arm.

    Raises:
      ConfigError: with one line that names the option and what is allowed.
    """
    _check_names(options)
    given = {name: typed(name, value) for name, value in options.items()}
    for name in given:
        fields.check_field(OPTIONS[name], given[name])
    found = arm_files.find(given.get("arm", OPTIONS["arm"].default))
    arm, before = found.arm, given.pop("arm_sha256", "")
    if before and before != found.sha256:
        raise ConfigError(f"arm: {found.name} or a file of its model is not what it was when the run began")
    values = defaults(found.name, given.get("preset", OPTIONS["preset"].default)) | given | {"arm": found.name}
    settings = Settings(
        run=_pick(RunOptions, values),
        spec=_pick(
            Spec,
            values,
            observation_size=arm.observation_size,
            state_size=arm.joints,
            action_size=arm.joints,
        ),
        hyper=_pick(Hyper, values),
        params=_pick(ReachParams, values),
        arm=arm,
    )
    fields.check_record(settings.run)
    reach.validate(arm, settings.params)
    if found.sha256:  # those of the package are known to run
        check_actuators(arm, settings.run.physics)
    fields.validate(settings.spec, settings.hyper)
    return settings
