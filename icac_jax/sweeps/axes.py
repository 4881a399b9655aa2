"""What a sweep varies, as tables and figures take it: an axis with its values, numbers or words."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icac_jax.console import shown

# Parts of more options than this are named by what sets them apart from the first.
_MOST_NAMED = 2
# Characters of a value in words.
_LONGEST = 200
Part = dict[str, Any]


class Axis(NamedTuple):
    """One option, or several that vary together.

    Attributes:
      title: name of the option or options.
      labels: its values in words, [V].
      values: its values as numbers, ascending, [V]; None where they are words.
      places: [C] which value each cell has.
      drawn: whether values were drawn or searched, not listed.
    """

    title: str
    labels: tuple[str, ...]
    values: tuple[float, ...] | None
    places: np.ndarray
    drawn: bool


def short(value: Any) -> str:
    """The shortest text that reads back to the value, in one line: "0.99995", "20", "true", "(0,90)"."""
    if isinstance(value, list | tuple):
        return "(" + ",".join(map(short, value)) + ")"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return repr(float(value)).removesuffix(".0")  # Python writes no more digits than tell a number from others
    return shown(value, _LONGEST)  # a path, perhaps, of any characters


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _as_one(parts: Sequence[Part]) -> bool:
    """Whether several options are one number under several names, such as a rate of three networks."""
    return len(parts[0]) > 1 and all(
        _is_number(value) and len(set(part.values())) == 1 for part in parts for value in part.values()
    )


def _value(part: Part, parts: Sequence[Part]) -> str:
    """The value of a part in words, without the name where one name says it."""
    if len(part) == 1 or _as_one(parts):
        return short(next(iter(part.values())))
    named = {name: value for name, value in part.items() if len(part) <= _MOST_NAMED or value != parts[0][name]}
    return " ".join(f"{name}={short(value)}" for name, value in named.items()) or "unchanged"


def name(part: Part, parts: Sequence[Part]) -> str:
    """A part of a cell's name: "gamma=0.9", "actor_rate=critic_rate=0.1", "critic_target=previous", "unchanged".

    Args:
      part: options that vary together, with a cell's values.
      parts: all that the cells have for them, this one included.
    """
    words = _value(part, parts)
    return "=".join([*part, words]) if len(part) == 1 or _as_one(parts) else words


def listed(parts: Sequence[Part], places: np.ndarray) -> Axis:
    """The axis of listed parts.

    Args:
      parts: of a study's axis.
      places: [C] which part each cell has.
    """
    title = " = ".join(parts[0]) if len(parts[0]) == 1 or _as_one(parts) else ", ".join(parts[0])
    labels = tuple(_value(part, parts) for part in parts)
    first = [next(iter(part.values())) for part in parts]
    if (len(parts[0]) > 1 and not _as_one(parts)) or not all(map(_is_number, first)):
        if len(parts[0]) <= _MOST_NAMED:
            labels = tuple(", ".join(map(short, part.values())) for part in parts)
        else:
            title = f"one of {len(parts[0])} options"
        return Axis(title, labels, None, places, False)
    order = np.argsort(first)
    ranks = np.argsort(order)
    return Axis(title, tuple(labels[at] for at in order), tuple(float(first[at]) for at in order), ranks[places], False)


def drawn(option: str, values: Sequence[Any]) -> Axis:
    """The axis of an option that was drawn or searched.

    Args:
      option: its name.
      values: of each cell, [C].
    """
    different = list({short(value): value for value in values}.values())
    numbers = all(map(_is_number, values))
    different.sort(key=lambda value: value if numbers else short(value))
    words = [short(value) for value in different]
    places = np.array([words.index(short(value)) for value in values])
    return Axis(option, tuple(words), tuple(map(float, different)) if numbers else None, places, True)
