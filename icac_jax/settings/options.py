"""The settings of a run: one flat table of options, resolved from a preset and what the user said.

Python, the command line, configuration files and sweeps all go through `resolve`. Which options there are depends on
the learner, the option `algo`.
"""

import dataclasses
import functools
from collections.abc import Iterable, Mapping
from typing import Any

from icac_jax import fields
from icac_jax.agents import coverage, imitation, registry
from icac_jax.agents.cacla import CaclaHyper, CaclaSpec
from icac_jax.agents.imitation import ImitationOptions
from icac_jax.curiosity import CuriosityHyper, CuriositySpec
from icac_jax.envs import goals, reach, tasks
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.goals import GoalOptions
from icac_jax.envs.model import check_actuators
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError, Numbers, close_match
from icac_jax.settings import arm_files, demonstration_files, encoder_files, worlds
from icac_jax.settings.run_options import CameraOptions, RunOptions, WarmOptions
from icac_jax.settings.values import as_declared

Options = dict[str, dataclasses.Field]


def _declared(*records: Any) -> Options:
    """The options that records or their types declare, by name; what follows from the environment is none."""
    return _declared_by(*(record if isinstance(record, type) else type(record) for record in records))


@functools.cache
def _declared_by(*types: type) -> Options:
    every = (field for record in types for field in dataclasses.fields(record))
    return {field.name: field for field in every if not field.metadata.get("derived")}


# What a run has whatever its learner is.
COMMON: Options = _declared(RunOptions, ReachParams, GoalOptions, ImitationOptions, WarmOptions, CameraOptions)
# Options that are left out where they are empty: runs of before there were these do not have them.
UNSAID = ("tip", *_declared(WarmOptions, CameraOptions))
# Presets that say nothing about the learner; no arm's file has to be read to know its options.
_OF_EVERY_LEARNER = ("paper", "paper-literal")
# Declarations that those presets are about; a learner with options of its own of the same name keeps its defaults.
_OF_THE_PAPER = [_declared(record) for record in (CaclaSpec, CaclaHyper, CuriositySpec, CuriosityHyper)]


@functools.cache
def _learners_own(algo: str) -> Options:
    learner = registry.find(algo)
    return _declared(learner.static, learner.traced)


def options_of(algo: str) -> Options:
    """The options of a run with this learner, by name, in the order of declaration.

    Raises:
      ConfigError: there is no such learner.
    """
    registry.find(algo)  # first: what is no name is no key either
    return COMMON | _learners_own(algo)


def applies(field: dataclasses.Field, values: Mapping[str, Any]) -> bool:
    """Whether there is an option beside the others: some belong to one value of another, such as one kind of map.

    Args:
      field: the option's declaration.
      values: of options by name; what is not there has its declared default.
    """
    only = field.metadata.get("only")
    return only is None or values.get(only[0], all_options()[only[0]].default) in only[1]


def check_applies(names: Iterable[str], values: Mapping[str, Any]) -> None:
    """Refuses options that there are not beside the others; arguments as for `applies`.

    Raises:
      ConfigError: one line that says which value of another option has the option.
    """
    for name in names:
        field = all_options()[name]
        if not applies(field, values):
            other, wanted = field.metadata["only"]
            has = values.get(other, all_options()[other].default)
            raise ConfigError(f"{name}: no option of the {other} {has}, only of {', '.join(wanted)}")


def owners(name: str) -> list[str]:
    """The learners that have an option of this name; empty if it is every run's, or nobody's."""
    return [algo for algo in registry.learners() if name in _learners_own(algo)]


@functools.cache
def all_options() -> Options:
    """Every option of every learner; where two learners declare one name, the first one's declaration."""
    found = dict(COMMON)
    for algo in registry.learners():
        found |= {name: field for name, field in _learners_own(algo).items() if name not in found}
    return found


def known(names: Iterable[str], algo: str | None = None) -> None:
    """Checks that these are options.

    Args:
      names: of options.
      algo: the learner whose options they must be; any learner's if None.

    Raises:
      ConfigError: one line that says what was perhaps meant, or which learners have the option.
    """
    allowed = all_options() if algo is None else options_of(algo)
    for name in names:
        if name not in allowed:
            others = owners(name)
            if others:
                raise ConfigError(f"{name}: no option of {algo}, only of {', '.join(others)}")
            raise ConfigError(f"{name}: no such option{close_match(name, allowed)}")


def learner_of(options: dict[str, Any]) -> str:
    """The learner of a run whose user said these options: as said, or the preset's; with curiosity, the curious one.

    Raises:
      ConfigError: there is no such arm, preset or learner, or the preset is of another learner.
    """
    said = options.get("algo")
    preset = options.get("preset", COMMON["preset"].default)
    its_own = None
    if preset not in _OF_EVERY_LEARNER:
        arm, tip = options.get("arm", COMMON["arm"].default), options.get("tip", "")
        its_own = _preset(arm_files.find(arm, tip), preset).get("algo")
    algo: str = said or its_own or COMMON["algo"].default  # pyright: ignore[reportAssignmentType]
    registry.find(algo)
    if its_own is not None and algo not in (its_own, registry.curious(its_own)):
        raise ConfigError(f"algo: must be {its_own} with the preset {preset}, got {algo!r}")
    return registry.curious(algo) if "curiosity" in options else algo


def of_learner(options: dict[str, Any]) -> dict[str, Any]:
    """Options without those that only other learners than `options["algo"]` have, or other maps than its map.

    For what holds several learners' options together: files that spell out every option, as earlier versions wrote
    them for every learner, and sweeps over learners or maps.
    """
    mine = options_of(learner_of(options))
    return {
        name: value
        for name, value in options.items()
        if (applies(mine[name], options) if name in mine else not owners(name))
    }


@dataclasses.dataclass(frozen=True)
class Settings:
    """Everything that determines a run's results on a given platform.

    Attributes:
      run: arm, learner, physics, seeds, episodes.
      spec: the learner's static choices.
      hyper: the learner's traced numbers.
      params: the task's traced numbers.
      goals: where goals come from.
      imitation: what learners start from.
      arm: the arm that `run.arm` names.
      warm: the map that it starts with, if not a fresh one.
      camera: what the learner sees, if not the joints.
    """

    run: RunOptions
    spec: Any
    hyper: Numbers
    params: ReachParams
    goals: GoalOptions
    imitation: ImitationOptions
    arm: ArmSpec
    warm: WarmOptions = WarmOptions()
    camera: CameraOptions = CameraOptions()

    @property
    def algo(self) -> str:
        """Name of the learner."""
        return self.run.algo

    @property
    def is_world(self) -> bool:
        """Whether the learner is in a world without an arm, such as one of gymnax."""
        return not self.arm.joints

    @property
    def physics(self) -> str:
        """What moves the world: "servo", "kinematic", or "gymnax"."""
        return "gymnax" if self.is_world else self.run.physics

    def flat(self) -> dict[str, Any]:
        """Every option by name, in the order of declaration; `resolve(**flat)` gives the same settings.

        Options of other maps than the run's are left out, and those of `UNSAID` where they say nothing.
        """
        records = (self.run, self.spec, self.params, self.goals, self.imitation, self.hyper, self.warm, self.camera)
        declared = {name: field for record in records for name, field in _declared(record).items()}
        options = {name: getattr(record, name) for record in records for name in _declared(record)}
        options = {name: value for name, value in options.items() if applies(declared[name], options)}
        for name in UNSAID:
            if not options[name]:
                del options[name]
        return options


def defaults(
    arm: str = "planar2", preset: str = "paper", algo: str = "icac", tip: str = "", task: str = tasks.REACH
) -> dict[str, Any]:
    """The value of every option for an arm, a preset, a task and a learner, before the user changes any.

    What a task sets wins over a preset.

    Args:
      arm: the option `arm`.
      preset: the option `preset`.
      algo: the option `algo`.
      tip: the option `tip`.
      task: the option `task`.

    Raises:
      ConfigError: no such arm, preset, task or learner, or the file of an own arm is not valid.
    """
    found = arm_files.find(arm, tip)
    changes = _preset(found, preset)
    of_task = tasks.options_of(task, found.name, found.tasks)
    numbers = reach.default_params(found.arm)
    declared = options_of(algo)
    values = {name: field.default for name, field in declared.items()}
    values |= {field.name: getattr(numbers, field.name) for field in dataclasses.fields(numbers)}
    values |= {"arm": found.name, "arm_sha256": found.sha256, "preset": preset, "task": task, "algo": algo, "tip": tip}
    mine = _of_table(found.name, "defaults", changes, declared)
    values |= {name: mine[name] for name in mine if "algo" in changes or _is_preset(declared[name])}
    return values | _of_table(found.name, f"tasks.{task}", of_task, declared)


def _of_table(arm: str, table: str, changes: dict[str, Any], declared: Options) -> dict[str, Any]:
    """What a table of an arm, perhaps of its file, sets of the options that there are.

    Raises:
      ConfigError: it holds what is no option, or a value that is not allowed.
    """
    known(changes)
    mine = {name: typed(name, value) for name, value in changes.items() if name in declared and name != "algo"}
    for name, value in mine.items():
        try:
            fields.check_field(declared[name], value)
        except ConfigError as error:
            raise ConfigError(f"{arm}: {table}: {error}") from error
    return mine


def _preset(found: arm_files.Found, name: str) -> dict[str, Any]:
    """What a preset of an arm changes, by option; `algo` among them where it is of one learner."""
    if not isinstance(name, str) or name not in found.presets:  # a file may say anything
        raise ConfigError(f"preset: must be one of {', '.join(found.presets)}, got {name!r}")
    return found.presets[name]


def before_there_was(options: dict[str, Any]) -> dict[str, Any]:
    """What every option of a run meant before it was one: for runs of earlier versions, whose files do not name it.

    Args:
      options: all of a run, as `Settings.flat` gives them.
    """
    return defaults(
        options["arm"], options["preset"], options["algo"], options.get("tip", ""), options.get("task", tasks.REACH)
    )


def _is_preset(field: dataclasses.Field) -> bool:
    """Whether the presets are about this declaration, and not about another one of its name."""
    same_name = [options[field.name] for options in _OF_THE_PAPER if field.name in options]
    return not same_name or any(field is other for other in same_name)


def typed(name: str, value: Any) -> Any:
    """An option's value as `values.as_declared` takes it to what Python holds."""
    return as_declared(all_options()[name], value)


def _pick(record: type, values: dict[str, Any]) -> Any:
    return record(**{name: values[name] for name in _declared(record) if name in values})


def resolve(**options: Any) -> Settings:
    """Settings from the options that the user gave; the rest comes from the preset of the arm.

    Raises:
      ConfigError: with one line that names the option and what is allowed.
    """
    algo = learner_of(options)
    options = options | {"algo": algo}
    declared = options_of(algo)
    known(options, algo)
    given = {name: typed(name, value) for name, value in options.items()}
    for name, value in given.items():
        fields.check_field(declared[name], value)
    tip = given.get("tip", "")
    found = arm_files.find(given.get("arm", COMMON["arm"].default), tip)
    arm, before = found.arm, given.pop("arm_sha256", "")
    if before and before != found.sha256:
        raise ConfigError(f"arm: {found.name} or a file of its model is not what it was when the run began")
    preset = given.get("preset", COMMON["preset"].default)
    task = given.get("task", COMMON["task"].default)
    values = defaults(found.name, preset, algo, tip, task) | given | {"arm": found.name}
    check_applies(given, values)
    learner = registry.find(algo)
    settings = Settings(
        run=_pick(RunOptions, values),
        spec=_pick(learner.static, values),
        hyper=_pick(learner.traced, values),
        params=_pick(ReachParams, values),
        goals=_pick(GoalOptions, values),
        imitation=_pick(ImitationOptions, values),
        arm=arm,
        warm=_pick(WarmOptions, values),
        camera=_pick(CameraOptions, values),
    )
    fields.check_record(settings.run)
    fields.check_record(settings.goals)
    if settings.is_world:
        fields.check_record(settings.params)
        plain = defaults(found.name, preset, algo)
        worlds.check(found.name, {name: value for name, value in given.items() if value != plain[name]})
    else:
        coverage.check(settings.run.coverage_bins, arm.joints)
        reach.validate(arm, settings.params)
        goals.check(settings.params, settings.goals, settings.run.task)
    imitation.check(settings.imitation, bool(settings.params.walls))
    settings = dataclasses.replace(
        settings,
        imitation=demonstration_files.found(settings.imitation, arm, settings.params),
        camera=encoder_files.found(settings.camera, arm),
    )
    worlds.check_camera(settings)
    if found.sha256:  # those of the package are known to run
        check_actuators(arm, settings.run.physics)
    learner.check(settings.spec, settings.hyper)
    return settings
