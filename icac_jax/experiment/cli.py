"""The command line `icac`: one command a subject, options from the same declarations that Python users use."""

import contextlib
import dataclasses
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from icac_jax import __version__
from icac_jax.config import ConfigError
from icac_jax.experiment import parsing

USAGE = """\
usage: icac COMMAND [OPTIONS]

  train      train one algorithm on one arm, many seeds at once
  resume     go on with a run that was stopped or killed, to the same bits
  evaluate   what a run's policies do without exploration, against the oracle
  runs       list the runs in folders: state, progress, last figures

icac COMMAND --help lists a command's options; icac --version prints the version.
Exit status: 0 done, 2 wrong input, 3 a file of the run is damaged, 4 the run folder cannot be written any more,
5 numbers stopped being finite in every lane, 6 the machine cannot do it (too little memory, a failing device),
130 or 143 stopped by Ctrl-C or SIGTERM with everything saved. What went wrong is one line on standard error.
"""


def _flag(default: Any, help: str) -> Any:
    return dataclasses.field(default=default, metadata={"help": help})


@dataclasses.dataclass(frozen=True)
class Output:
    """Where a command's results go; not part of what a run is."""

    out: Path | None = _flag(None, "run folder, new or empty; runs/ARM-ALGO-NNN if not given")
    config: Path | None = _flag(None, "TOML file with options; those given here win")
    json: bool = _flag(False, "print the summary as JSON, and nothing else, on standard output")
    no_cache: bool = _flag(False, "do not keep compiled programs in the user's cache folder")
    checkpoint_every: float = _flag(60.0, "seconds between checkpoints; 0 saves after each chunk")
    tensorboard: bool = _flag(False, "write curves for TensorBoard too (needs the extra)")


def _train(args: Sequence[str]) -> int:
    from icac_jax.experiment import folder, help_pages, settings

    told = parsing.said(args, "config")
    from_file = folder.read_options(Path(told)) if told else {}
    base = folder.settings_of(Path(told)).flat() if told else {}
    arm = parsing.said(args, "arm") or from_file.get("arm", settings.OPTIONS["arm"].default)
    preset = parsing.said(args, "preset") or from_file.get("preset", settings.OPTIONS["preset"].default)
    if arm == base.get("arm") and preset == base.get("preset"):
        initial = base
    else:
        initial = settings.defaults(arm, preset) | {k: v for k, v in from_file.items() if k not in ("arm", "preset")}

    if pages := {"-h", "--help", "--help-choices"} & set(args):
        print(help_pages.choices(initial) if "--help-choices" in pages else help_pages.train(Output, initial))
        return 0
    options = [
        (name, Annotated[field.type, tyro.conf.FlagConversionOff], dataclasses.field(default=initial[name]))
        for name, field in settings.OPTIONS.items()
    ]
    outputs = [(f.name, f.type, f) for f in dataclasses.fields(Output)]
    record = dataclasses.make_dataclass("Train", outputs + options, frozen=True)
    given = parsing.parse("train", record, args, settings.OPTIONS)
    resolved = settings.resolve(**{name: getattr(given, name) for name in settings.OPTIONS})

    _prepare(given.no_cache, given.checkpoint_every)
    from icac_jax.experiment import train

    out = given.out or folder.next_free(Path("runs"), f"{resolved.run.arm}-{resolved.spec.algo}")
    result = train.train(resolved, out, given.checkpoint_every, given.tensorboard)
    return _show(result, out, given.json)


def _options(usage: str, record: type, args: Sequence[str]) -> Any:
    """The options of a command without settings; None when its help was asked for, and printed."""
    if {"-h", "--help"} & set(args):
        from icac_jax.experiment import help_pages

        print(help_pages.command(usage, record))
        return None
    return parsing.parse(usage.split()[0], record, args, {field.name: field for field in dataclasses.fields(record)})


def _prepare(no_cache: bool, checkpoint_every: float = 60.0) -> None:
    """What must be set before JAX starts, and the check of what every training command takes."""
    from icac_jax.experiment import devices

    if not 0 <= checkpoint_every < math.inf:
        raise ConfigError(f"checkpoint_every: must be a number at least 0, got {checkpoint_every}")
    devices.use_every_core()
    devices.use_full_precision()
    if not no_cache:
        devices.use_compile_cache()


def _warn(line: str) -> None:
    print(f"icac: warning: {line}", file=sys.stderr, flush=True)


def _show(result: dict[str, Any], out: Path, as_json: bool) -> int:
    """Prints a run's summary; status 5 if every lane failed."""
    from icac_jax.experiment import summary

    if as_json:
        print(json.dumps(result))
    else:
        print(summary.as_text(result))
        print(f"{'written to':16}{out}")
    if len(result["failed_seeds"]) == result["seeds"]:
        print("icac: numbers stopped being finite in every lane", file=sys.stderr)
        return 5
    return 0


@dataclasses.dataclass(frozen=True)
class ResumeOptions:
    """What `icac resume` takes."""

    run: tyro.conf.Positional[Path | None] = _flag(None, "folder of the run")
    episodes: int | None = _flag(None, "go on to this many episodes a learner, more than before")
    checkpoint_every: float = _flag(60.0, "seconds between checkpoints; 0 saves after each chunk")
    json: bool = _flag(False, "print the summary as JSON, and nothing else, on standard output")
    no_cache: bool = _flag(False, "do not keep compiled programs in the user's cache folder")


def _resume(args: Sequence[str]) -> int:
    given = _options("resume RUN", ResumeOptions, args)
    if given is None:
        return 0
    if given.run is None:
        raise ConfigError("run: must be the folder of a run, got nothing")
    _prepare(given.no_cache, given.checkpoint_every)
    from icac_jax.experiment import train

    result = train.resume(given.run, given.episodes, given.checkpoint_every, _warn)
    return _show(result, given.run, given.json)


@dataclasses.dataclass(frozen=True)
class EvaluateOptions:
    """What `icac evaluate` takes."""

    run: tyro.conf.Positional[Path | None] = _flag(None, "folder of the run")
    pairs: int = _flag(1000, "start and goal pairs a seed")
    pair_seed: int = _flag(0, "randomness of the pairs")
    json: bool = _flag(False, "print the figures as JSON, and nothing else, on standard output")
    no_cache: bool = _flag(False, "do not keep compiled programs in the user's cache folder")


def _evaluate(args: Sequence[str]) -> int:
    given = _options("evaluate RUN", EvaluateOptions, args)
    if given is None:
        return 0
    if given.run is None:
        raise ConfigError("run: must be the folder of a run, got nothing")
    _prepare(given.no_cache)
    from icac_jax.experiment import evaluate

    result = evaluate.evaluate(given.run, given.pairs, given.pair_seed, _warn)
    print(json.dumps(result) if given.json else evaluate.as_text(result))
    return 0


@dataclasses.dataclass(frozen=True)
class RunsOptions:
    """What `icac runs` takes."""

    folders: tyro.conf.Positional[tuple[Path, ...]] = _flag((Path("runs"),), "folders to look in, at any depth")
    json: bool = _flag(False, "print the list as JSON")


def _runs(args: Sequence[str]) -> int:
    given = _options("runs [FOLDER ...]", RunsOptions, args)
    if given is None:
        return 0
    from icac_jax.experiment import runs

    found = [runs.describe(folder) for folder in runs.find(list(given.folders))]
    print(json.dumps(found) if given.json else runs.as_text(found))
    return 0


COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {
    "train": _train,
    "resume": _resume,
    "runs": _runs,
    "evaluate": _evaluate,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit status.

    Args:
      argv: arguments without the program's name; those of the process by default.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    if not args or args[0] in ("-h", "--help"):
        print(USAGE, end="")
        return 0 if args else 2
    if args[0] == "--version":
        print(f"icac_jax {__version__}")
        return 0
    if args[0] not in COMMANDS:
        print(f"icac: unknown command {args[0]!r}, must be one of {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    try:
        status = COMMANDS[args[0]](args[1:])
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # whoever read the output has enough of it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print(f"icac {args[0]}: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        status = _status_of(error)
        if status is None:
            raise
        with contextlib.suppress(OSError):  # the terminal may be gone
            print(f"icac {args[0]}: {str(error).partition(chr(10))[0]}", file=sys.stderr)
        return status


def _status_of(error: Exception) -> int | None:
    """The exit status of an expected failure, None for any other."""
    if isinstance(error, ConfigError):
        return 2
    # Imported here: a wrong option should be answered before the physics is loaded.
    import jax

    from icac_jax.experiment.checkpoints import DamagedError
    from icac_jax.experiment.train import StoppedError, WriteError

    if isinstance(error, DamagedError):
        return 3
    if isinstance(error, WriteError | OSError):
        return 4
    if isinstance(error, MemoryError | jax.errors.JaxRuntimeError):
        return 6
    return 128 + error.signal if isinstance(error, StoppedError) else None


def entry() -> None:
    """What the installed program `icac` calls."""
    sys.exit(main())
