"""The command line `icac`: one command a subject, options from the same declarations that Python users use."""

import contextlib
import dataclasses
import io
import json
import os
import re
import sys
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from icac_jax import __version__
from icac_jax.config import ConfigError, allowed

USAGE = """\
usage: icac COMMAND [OPTIONS]

  train      train one algorithm on one arm, many seeds at once

icac COMMAND --help lists a command's options; icac --version prints the version.
Exit status: 0 done, 2 wrong input (one line on standard error says what), 130 interrupted.
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


def _one_line(command: str, box: str, fields: dict[str, dataclasses.Field]) -> str:
    """The parser's boxed complaint as one line that names the option and what is allowed.

    The box holds the complaint, then a rule, then help; a misspelt option's help begins with the one that was meant.
    """
    lines = [line.strip("│| ") for line in box.splitlines() if not line.startswith(("╭", "╰"))]
    parts = re.split(r"\n[─-]+\n", "\n".join(lines))
    # Drawn in plain ASCII, the box has its title as a part of its own.
    text = " ".join(parts[0 if "╭" in box else 1].split()) if len(parts) > 1 else box.strip()
    named = re.search(r"--([A-Za-z][\w-]*)", text)
    if text.startswith("Unrecognized"):
        unknown = text.partition(": ")[2].split(", ")[0]
        close = re.search(r"Perhaps you meant:\n(--[\w-]+)", "\n".join(lines))
        text = f"{unknown}: no such option" + (f"; did you mean {close[1]}?" if close else "")
    elif named and named[1].replace("-", "_") in fields:
        field = fields[named[1].replace("-", "_")]
        got = re.search(r"'([^'-][^']*)'", text)
        text = f"{field.name}: must be {allowed(field)}, got " + (repr(got[1]) if got else "nothing")
    return f"icac {command}: {text}"


def _parse(command: str, record: type, args: Sequence[str], fields: dict[str, dataclasses.Field]) -> Any:
    """Reads `args` into `record`; a wrong one ends the program with one line and status 2."""
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(record, prog=f"icac {command}", args=args, add_help=False)
    except SystemExit as stop:
        if stop.code:
            print(_one_line(command, complaint.getvalue(), fields), file=sys.stderr)
        raise


def _said(args: Sequence[str], name: str) -> str | None:
    """The value of `--name` in the arguments, before they are parsed in full."""
    for place, arg in enumerate(args):
        if arg == f"--{name}" and place + 1 < len(args):
            return args[place + 1]
        if arg.startswith(f"--{name}="):
            return arg.split("=", 1)[1]
    return None


def _read_config(path: Path) -> dict[str, Any]:
    """The options in a TOML file."""
    try:
        return tomllib.loads(path.read_text())
    except OSError as error:
        raise ConfigError(f"config: cannot read {path}: {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"config: {path} is not valid TOML: {error}") from error


def _train(args: Sequence[str]) -> int:
    from icac_jax.experiment import devices, help_pages, settings

    told = _said(args, "config")
    from_file = _read_config(Path(told)) if told else {}
    base = {**settings.resolve(**from_file).flat()} if from_file else {}
    arm = _said(args, "arm") or from_file.get("arm", settings.OPTIONS["arm"].default)
    preset = _said(args, "preset") or from_file.get("preset", settings.OPTIONS["preset"].default)
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
    given = _parse("train", record, args, settings.OPTIONS)
    resolved = settings.resolve(**{name: getattr(given, name) for name in settings.OPTIONS})

    devices.use_every_core()
    if not given.no_cache:
        devices.use_compile_cache()
    from icac_jax.experiment import folder, summary, train

    out = given.out or folder.next_free(Path("runs"), f"{resolved.run.arm}-{resolved.spec.algo}")
    result = train.train(resolved, out)
    if given.json:
        print(json.dumps(result))
    else:
        print(summary.as_text(result))
        print(f"{'written to':16}{out}")
    return 0


COMMANDS: dict[str, Callable[[Sequence[str]], int]] = {"train": _train}


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
        return COMMANDS[args[0]](args[1:])
    except ConfigError as error:
        print(f"icac {args[0]}: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"icac {args[0]}: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def entry() -> None:
    """What the installed program `icac` calls."""
    sys.exit(main())
