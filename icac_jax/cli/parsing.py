"""Reading a command's options from its dataclass, and saying in one line what is wrong with them.

A field is an option `--its-name VALUE`, or `--its-name A B ...` for a tuple; a truth value of a command is a flag
`--its-name` or `--no-its-name`, one that is a setting has a value. `Positional[...]` marks the field that takes what
has no option before it.
"""

import dataclasses
import difflib
import os
import types
import typing
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from icac_jax.cli import elsewhere
from icac_jax.errors import ConfigError
from icac_jax.fields import allowed

_T = TypeVar("_T")
_POSITIONAL = "positional"
Positional = Annotated[_T, _POSITIONAL]
_TRUTH = {"true": True, "false": False}
_KINDS = {int: "a whole number", float: "a number", bool: "true or false", str: "text", Path: "a path"}


@dataclasses.dataclass(frozen=True)
class _Option:
    """A field as the command line sees it.

    Attributes:
      name: of the field.
      kind: type of a value.
      several: whether it takes any number of values.
      flag: whether it is given without a value.
      positional: whether it is given without a name.
      expected: what a value must be, in words.
    """

    name: str
    kind: Any
    several: bool
    flag: bool
    positional: bool
    expected: str

    def read(self, text: str) -> Any:
        """The value that a text stands for."""
        if typing.get_origin(self.kind) is Literal:
            for choice in typing.get_args(self.kind):
                if text == str(choice):
                    return choice
        elif self.kind is bool and text.lower() in _TRUTH:
            return _TRUTH[text.lower()]
        elif self.kind is Path and text:
            return path(text)
        elif self.kind in (int, float, str):
            try:
                return self.kind(text)
            except ValueError:
                pass
        raise ConfigError(f"{self.name}: must be {self.expected}, got {text!r}")


def _option(field: dataclasses.Field, kind: Any, settings: Mapping[str, dataclasses.Field]) -> _Option:
    positional = several = False
    if typing.get_origin(kind) is Annotated:
        kind, *marks = typing.get_args(kind)
        positional = _POSITIONAL in marks
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        (kind,) = (one for one in typing.get_args(kind) if one is not type(None))
    if typing.get_origin(kind) is tuple:
        kind, several = typing.get_args(kind)[0], True
    declared = settings.get(field.name)
    if declared is not None and "bounds" in declared.metadata:
        return _Option(field.name, kind, several, False, positional, allowed(declared))
    choices = ", ".join(map(str, typing.get_args(kind)))
    expected = f"one of {choices}" if typing.get_origin(kind) is Literal else _KINDS[kind]
    return _Option(field.name, kind, several, kind is bool, positional, expected)


def parse(command: str, record: type, args: Sequence[str], fields: Mapping[str, dataclasses.Field]) -> Any:
    """Reads `args` into `record`.

    Args:
      command: what the arguments are of.
      record: a dataclass; a field that is not given has its default.
      args: the arguments.
      fields: of settings, by name: what they allow.

    Raises:
      ConfigError: an argument is wrong; the line names it and what is allowed.
    """
    kinds = typing.get_type_hints(record, include_extras=True)
    options = {one.name: _option(one, kinds[one.name], fields) for one in dataclasses.fields(record)}
    given: dict[str, Any] = {}
    rest: list[str] = []
    left = list(args)
    while left:
        arg = left.pop(0)
        if arg == "--":
            rest += left
            break
        if not _is_option(arg):
            rest.append(arg)
            continue
        written, equals, text = arg.partition("=")
        option, value = _named(written, options, command)
        if option.flag:
            if equals:
                raise ConfigError(f"{option.name}: takes no value, got {text!r}")
            given[option.name] = value
            continue
        texts = [text] if equals else []
        while left and not equals and (option.several or not texts) and not _is_option(left[0]):
            texts.append(left.pop(0))
        if not texts:
            raise ConfigError(f"{option.name}: must be {option.expected}, got nothing")
        values = [option.read(text) for text in texts]
        given[option.name] = tuple(values) if option.several else values[0]
    return record(**given | _positional(rest, options))


def _positional(rest: list[str], options: Mapping[str, _Option]) -> dict[str, Any]:
    """The value of the field that takes what has no option before it."""
    option = next((one for one in options.values() if one.positional), None)
    if not rest:
        return {}
    most = 0 if option is None else len(rest) if option.several else 1
    if option is None or len(rest) > most:
        raise ConfigError(f"unexpected argument {rest[most]!r}")
    values = [option.read(text) for text in rest]
    return {option.name: tuple(values) if option.several else values[0]}


def _is_option(arg: str) -> bool:
    """Whether an argument is the name of an option; a negative number is a value."""
    if not arg.startswith("-") or arg == "-":
        return False
    try:
        float(arg)
    except ValueError:
        return True
    return False


def _named(written: str, options: Mapping[str, _Option], command: str) -> tuple[_Option, bool]:
    """The option that is written so, and the value if it is a flag."""
    known: dict[str, tuple[_Option, bool]] = {}
    for option in options.values():
        if not option.positional:
            dashed = option.name.replace("_", "-")
            known[f"--{dashed}"] = option, True
            if option.flag:
                known[f"--no-{dashed}" if not dashed.startswith("no-") else f"--{dashed[3:]}"] = option, False
    found = known.get("--" + written[2:].replace("_", "-")) if written.startswith("--") else None
    if found is not None:
        return found
    close = difflib.get_close_matches(written.lstrip("-"), [name[2:] for name in known], n=1, cutoff=0.7)
    hint = elsewhere.hint(written.lstrip("-"), options)
    hint = hint or (f"did you mean --{close[0]}?" if close else f"icac help {command} lists them")
    raise ConfigError(f"{written}: no such option; {hint}")


def path(text: str) -> Path:
    """A path as the shell would give it: `~` is the home folder also where the shell does not expand it."""
    return Path(os.path.expanduser(text))


def named(args: Sequence[str], known: Iterable[str]) -> list[str]:
    """The names in `known` that stand in the arguments as options, before they are parsed in full."""
    words = {arg[2:].split("=", 1)[0].replace("-", "_") for arg in args if arg.startswith("--")}
    return [name for name in known if name in words]


def said(args: Sequence[str], name: str) -> str | None:
    """The value of `--name` in the arguments, before they are parsed in full.

    Raises:
      ConfigError: it is empty.
    """
    value = None
    for place, arg in enumerate(args):
        if arg == "--":
            break
        if arg == f"--{name}" and place + 1 < len(args):
            value = args[place + 1]
        elif arg.startswith(f"--{name}="):
            value = arg.split("=", 1)[1]
    if value == "":
        raise ConfigError(f"{name}: must not be empty")
    return value
