"""Whether what a JSON file holds has the shape that its readers rely on; anybody may have altered it.

A shape takes a value and its name, and raises a `ValueError` of one line where the value is something else. What `read`
gives has its shape, so that nobody who uses it needs to look again.
"""

import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from icac_jax import reading
from icac_jax.console import shown
from icac_jax.errors import DamagedError

Shape = Callable[[Any, str], None]
_LARGEST = 1e100  # sums and squares of larger ones may overflow; no figure comes near it
_MOST = 2**63  # whole numbers of more bits are no counts, and many functions take none
_SHOWN = 40


def read(path: Path, shape: Shape, what: str) -> Any:
    """What a JSON file holds, None where there is no file.

    Args:
      path: the file.
      shape: what it must hold.
      what: it is, in a few words for the error.

    Raises:
      DamagedError: it cannot be read, or holds something else.
    """
    try:
        value = reading.parsed_json(reading.text(path))
        shape(value, "it")
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise DamagedError(f"{path}: not a readable {what} ({reason})") from error
    return value


def fits(shape: Shape, value: Any) -> bool:
    """Whether a value has a shape."""
    try:
        shape(value, "it")
    except ValueError:
        return False
    return True


def _need(fitting: bool, value: Any, name: str) -> None:
    if not fitting:
        raise ValueError(f"{name} is {shown(repr(value), _SHOWN)}")


def anything(value: Any, name: str) -> None:
    """Whatever JSON holds."""


def number(value: Any, name: str) -> None:
    """A number from -1e100 to 1e100."""
    fitting = isinstance(value, int | float) and not isinstance(value, bool)
    # Compared as it is: to make a float of a long whole number would fail.
    _need(fitting and abs(value) <= _LARGEST, value, name)


def amount(value: Any, name: str) -> None:
    """A number at least 0."""
    number(value, name)
    _need(value >= 0, value, name)


def whole(value: Any, name: str) -> None:
    """A whole number at least 0 and less than 2^63."""
    _need(isinstance(value, int) and not isinstance(value, bool) and 0 <= value < _MOST, value, name)


def flag(value: Any, name: str) -> None:
    """True or false."""
    _need(isinstance(value, bool), value, name)


def text(value: Any, name: str) -> None:
    """A text."""
    _need(isinstance(value, str), value, name)


def one_of(allowed: Collection[str]) -> Shape:
    """One of these texts."""

    def shape(value: Any, name: str) -> None:
        _need(isinstance(value, str) and value in allowed, value, name)

    return shape


def optional(inner: Shape) -> Shape:
    """That shape, or null."""

    def shape(value: Any, name: str) -> None:
        if value is not None:
            inner(value, name)

    return shape


def several(inner: Shape, least: int = 0, most: float = math.inf) -> Shape:
    """A list of values of that shape.

    Args:
      inner: of each.
      least: how many there are at least.
      most: how many there are at most.
    """

    def shape(value: Any, name: str) -> None:
        _need(isinstance(value, list) and least <= len(value) <= most, value, name)
        for one in value:
            inner(one, name)

    return shape


def mapping(inner: Shape) -> Shape:
    """An object whose values, under any keys, have that shape."""

    def shape(value: Any, name: str) -> None:
        _need(isinstance(value, dict), value, name)
        for key, one in value.items():
            inner(one, f"{name} {shown(key, _SHOWN)}")

    return shape


def record(fields: Mapping[str, Shape], later: Mapping[str, Shape] | None = None) -> Shape:
    """An object with these fields; others that it may have are not looked at.

    Args:
      fields: the shape of each.
      later: fields that earlier versions did not write.
    """
    known = dict(fields) | dict(later or {})

    def shape(value: Any, name: str) -> None:
        _need(isinstance(value, dict), value, name)
        for field, inner in known.items():
            if field in value:
                inner(value[field], field)
            elif field in fields:
                raise ValueError(f"{field} is missing")

    return shape
