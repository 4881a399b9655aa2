"""Reading a command's options with tyro, and saying in one line what is wrong with them."""

import contextlib
import dataclasses
import io
import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any

import tyro

from icac_jax.fields import allowed


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
    elif (field := fields.get(named[1].replace("-", "_")) if named else None) and "bounds" in field.metadata:
        got = re.search(r"'([^'-][^']*)'", text)
        text = f"{field.name}: must be {allowed(field)}, got " + (repr(got[1]) if got else "nothing")
    return f"icac {command}: {text}"


def parse(command: str, record: type, args: Sequence[str], fields: dict[str, dataclasses.Field]) -> Any:
    """Reads `args` into `record`; a wrong one ends the program with one line and status 2."""
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(record, prog=f"icac {command}", args=args, add_help=False)
    except SystemExit as stop:
        if stop.code:
            print(_one_line(command, complaint.getvalue(), fields), file=sys.stderr)
        raise


def named(args: Sequence[str], known: Iterable[str]) -> list[str]:
    """The names in `known` that stand in the arguments as options, before they are parsed in full."""
    words = {arg[2:].split("=", 1)[0].replace("-", "_") for arg in args if arg.startswith("--")}
    return [name for name in known if name in words]


def said(args: Sequence[str], name: str) -> str | None:
    """The value of `--name` in the arguments, before they are parsed in full."""
    for place, arg in enumerate(args):
        if arg == f"--{name}" and place + 1 < len(args):
            return args[place + 1]
        if arg.startswith(f"--{name}="):
            return arg.split("=", 1)[1]
    return None
