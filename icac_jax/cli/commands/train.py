"""`icac train`: one algorithm on one arm, many seeds at once."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.envs import from_gymnax
from icac_jax.fields import ConfigError, check_field


@dataclasses.dataclass(frozen=True)
class Output(common.Processes):
    """Where a command's results go; not part of what a run is."""

    out: Path | None = common.flag(None, "run folder, new or empty; runs/ARM-ALGO-NNN if not given")
    config: Path | None = common.flag(None, "TOML file with options; those given here win")
    json: bool = common.flag(False, "print the summary as JSON, and nothing else, on standard output")
    no_cache: bool = common.no_cache()
    checkpoint_every: float = common.checkpoint_every()
    evaluate_every: int = common.flag(0, "episodes between evaluations without exploration; 0 never")
    report: bool = common.flag(True, "report.html at the end; --no-report for none", hidden=True)
    track: str = common.flag("", "some of tensorboard,wandb,mlflow,csv; the first three: extras")
    tensorboard: bool = common.flag(False, "the same as --track tensorboard", hidden=True)


# Lane-steps per second below which contacts are worth a warning; arms without them do thousands on one core.
_SLOW = 500


def _slow_contacts() -> Callable[[Any], None]:
    """Says once, after the first chunk of a training, how slow it is with the model's contacts if it is slow."""
    seen: list[float] = []

    def see(chunk: Any) -> None:
        if not seen and chunk.seconds > 0:
            seen.append(chunk.lane_steps / chunk.seconds)
            if seen[0] < _SLOW:
                common.warn(
                    f"physics: servo with the model's contacts takes {seen[0]:.3g} lane-steps per second; "
                    '<option><flag contact="disable"/></option> removes them, --physics kinematic needs none'
                )

    return see


def _with_arm(args: Sequence[str]) -> list[str]:
    """The arguments with `--env gymnax:NAME`, as users of gymnax say it, as what it is here: the option `arm`."""
    found, args = [], [*args]
    for place, arg in enumerate(args):
        following = args[place + 1] if place + 1 < len(args) else ""
        named = arg == "--env" and from_gymnax.is_named(following)
        joined = arg.startswith("--env=") and from_gymnax.is_named(arg.partition("=")[2])
        found.append("--arm" + arg.removeprefix("--env") if named or joined else arg)
    return found


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    from icac_jax.cli import help
    from icac_jax.runs import folder
    from icac_jax.settings import arm_files, options

    args = _with_arm(args)
    told = parsing.said(args, "config")
    from_file = folder.read_options(parsing.path(told)) if told else {}
    base = folder.settings_of(parsing.path(told)).flat() if told else {}

    def first_said(name: str) -> str:
        return parsing.said(args, name) or from_file.get(name, options.COMMON[name].default)

    arm, preset = arm_files.whole(first_said("arm")), first_said("preset")
    task = first_said("task")
    tip = first_said("tip") if "arm" not in parsing.named(args, ["arm"]) else parsing.said(args, "tip") or ""
    said = {"arm": arm, "preset": preset, "tip": tip} | ({"curiosity": 0} if parsing.named(args, ["curiosity"]) else {})
    if (named := parsing.said(args, "algo") or from_file.get("algo")) is not None:
        said["algo"] = named
    algo = options.learner_of(said)
    declared = options.options_of(algo)
    options.known(parsing.named(args, options.all_options()), algo)
    for name, value in (("preset", preset), ("task", task)):
        if name in from_file and value != from_file[name]:
            raise ConfigError(f"{name}: must be {from_file[name]!r} as in {told}, which spells out what a {name} sets")
    chosen = ("arm", "preset", "algo", "tip", "task")
    map = parsing.said(args, "map") or from_file.get("map")
    same = (arm, preset, algo, tip, task) == tuple(base.get(name, "") for name in chosen)
    if same and map in (None, base.get("map")):
        initial = dict.fromkeys(options.UNSAID, "") | base
    else:
        kept = {name: options.typed(name, from_file[name]) for name in declared if name in from_file}
        initial = options.defaults(arm, preset, algo, tip, task)
        initial |= {name: kept[name] for name in kept if name not in (*chosen, "arm_sha256")}

    if map is not None and "map" in declared:
        check_field(declared["map"], map)
        initial["map"] = map
    options.check_applies(parsing.named(args, declared), initial)
    declared = {name: field for name, field in declared.items() if options.applies(field, initial)}

    pages = {"--help-choices": help.choices, "--help-task": help.task}
    if asked := {"-h", "--help", *pages} & set(args):
        page = next((pages[name] for name in pages if name in asked), None)
        print(page(initial) if page is not None else help.train(Output, initial))
        return 0
    settings = [(name, field.type, dataclasses.field(default=initial[name])) for name, field in declared.items()]
    outputs = [(f.name, f.type, f) for f in dataclasses.fields(Output)]
    record = dataclasses.make_dataclass("Train", outputs + settings, frozen=True)
    given = parsing.parse("train", record, args, declared)
    resolved = options.resolve(**{name: getattr(given, name) for name in declared} | {"algo": algo})

    common.prepare(given.no_cache, given.checkpoint_every, [resolved.algo])
    from icac_jax import tracking
    from icac_jax.envs import model
    from icac_jax.runs import build, processes, train

    process = processes.connect(given.coordinator, given.num_processes, given.process_id)
    common.need_folder(given.out, process)
    names = tracking.names_of(given.track + (",tensorboard" if given.tensorboard else ""))
    if names and process.count > 1:
        raise ConfigError("num_processes: must be 1 with track, which sees all seeds at once")
    watch: list[Any] = [*tracking.trackers(names, common.warn)]  # says what is missing before there is a folder
    # What MJX cannot run, or no goal that far away, is said before there is a folder; a run makes its world with the
    # same calls.
    build.environment(resolved)
    build.task(resolved, seed=0)

    out = given.out or folder.next_free(Path("runs"), f"{resolved.arm.name.replace(':', '-')}-{resolved.algo}")
    chosen = {"physics"} & {*parsing.named(args, declared), *from_file}
    if resolved.physics == "kinematic" and not chosen and not model.has_actuators(resolved.arm):
        common.warn("physics: kinematic, the model has no actuators; servo needs a position actuator a joint")
    if resolved.physics == "servo" and model.has_contacts(resolved.arm):
        watch.append(_slow_contacts())
    with common.shared(process, out):
        result = train.train(resolved, out, given.checkpoint_every, given.evaluate_every, process, watch)
    if process.index == 0 and given.report:
        from icac_jax.analysis import run_page  # draws, which training does not need

        run_page.after_training(out, common.warn)
    return common.show(result, out, given.json)
