"""The help pages of the command line, made from the declarations of the options: one line an option."""

import dataclasses
import math
import textwrap
import typing
from typing import Any

from icac_jax.agents import registry
from icac_jax.agents.imitation import ImitationOptions
from icac_jax.cli.commands.common import Processes
from icac_jax.envs.goals import GoalOptions
from icac_jax.envs.reach import ReachParams
from icac_jax.settings.options import applies
from icac_jax.settings.run_options import CameraOptions, RunOptions, WarmOptions

_WIDTH = 120


def _value(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, tuple):
        return " ".join(map(_value, value))
    if isinstance(value, float):
        return "inf" if math.isinf(value) else f"{value:.4g}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _option(field: dataclasses.Field) -> str:
    return "--" + field.name.replace("_", "-")


def _line(field: dataclasses.Field, value: Any) -> str:
    unit = f" [{field.metadata['unit']}]" if field.metadata.get("unit") else ""
    source = f" ({field.metadata['source']})" if "source" in field.metadata else ""
    return f"  {_option(field):27}{_value(value):>11}  {field.metadata['help']}{unit}{source}"


def _block(title: str, record: type, values: dict[str, Any], papers: bool = False) -> list[str]:
    """The options of a record under a title: all, or those alone that the paper has."""
    fields = [field for field in dataclasses.fields(record) if not field.metadata.get("derived")]
    fields = [field for field in fields if not papers or field.metadata["source"] != "own"]
    fields = [field for field in fields if applies(field, values)]
    return [title, *(_line(field, values[field.name]) for field in fields)]


def _is_hidden(field: dataclasses.Field) -> bool:
    return field.metadata.get("hidden", False)


def command(usage: str, options: type) -> str:
    """The page of a command whose options are not settings.

    Args:
      usage: the command and its arguments.
      options: dataclass of its options.
    """
    lines = [f"usage: icac {usage} [OPTIONS]"]
    lines += [_line(field, field.default or None) for field in dataclasses.fields(options) if not _is_hidden(field)]
    return "\n".join(lines)


def train(outputs: type, values: dict[str, Any]) -> str:
    """The page of `icac train --help`: what a run is, the paper's task, and the learner's traced numbers.

    Args:
      outputs: dataclass of the options that are not settings.
      values: the value each option has if it is not given.
    """
    lines = ["usage: icac train [OPTIONS]      each option with the value it has for this arm and preset if not given"]
    shared = dataclasses.fields(Processes)
    lines += [f"  {', '.join(map(_option, shared))}: for several processes, see docs/scaling.md"]
    elsewhere = {other.name for other in shared}
    own = [field for field in dataclasses.fields(outputs) if field.name not in elsewhere and not _is_hidden(field)]
    lines += [_line(field, field.default or None) for field in own]
    lines += _block("the run", RunOptions, values)[1:]
    names = "--algo decides the options, one of " + ", ".join(registry.learners())
    lines += textwrap.wrap(names, _WIDTH, initial_indent="  ", subsequent_indent="    ")
    lines += _block("the task; walls, goals, starts, demonstrations: icac train --help-task", ReachParams, values, True)
    algo = values["algo"]
    title = f"the learner {algo}; its networks, capacities and choices: icac train --algo {algo} --help-choices"
    lines += _block(title, registry.find(algo).traced, values)
    return "\n".join(lines)


def task(values: dict[str, Any]) -> str:
    """The page of `icac train --help-task`: everything about the task, what learners see and what they start from.

    Args:
      values: the value each option has if it is not given.
    """
    lines = _block(f"the task {values['task']}", ReachParams, values)
    lines += _block("where goals come from", GoalOptions, values)
    lines += _block("what learners see", CameraOptions, values)
    return "\n".join([*lines, *_block("what learners start from", ImitationOptions, values)])


def choices(values: dict[str, Any]) -> str:
    """The page of `icac train --help-choices`: what is fixed when the program is compiled.

    Args:
      values: the value each option has if it is not given.
    """
    lines = [f"networks, capacities and choices of {values['algo']}"]
    for field in dataclasses.fields(registry.find(values["algo"]).static):
        if not field.metadata.get("derived") and applies(field, values):
            lines += [_line(field, values[field.name])]
            several = typing.get_args(field.type)
            if several:
                indent = 42 * " "
                lines += textwrap.wrap(
                    f"one of {', '.join(several)}", _WIDTH, initial_indent=indent, subsequent_indent=indent
                )
    lines += _block("what it starts with", WarmOptions, values)
    return "\n".join(lines)
