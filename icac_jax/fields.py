"""A declared option: default, unit, meaning, source and allowed range, and the checks that read the declaration.

Every option is declared once, at the field of the record that it belongs to; the command line, files, sweeps, Python
and the documentation all read these declarations.
"""

import dataclasses
import difflib
import math
import numbers
import typing
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from jax.core import Tracer

from icac_jax import precision
from icac_jax.errors import ConfigError


def param(
    default: Any,
    help: str,
    *,
    unit: str = "",
    source: str,
    low: float = -math.inf,
    high: float = math.inf,
    open_low: bool = False,
    open_high: bool = False,
    derived: bool = False,
    neutral: float | None = None,
    nested: bool = False,
    only: tuple[str, tuple[str, ...]] | None = None,
) -> Any:
    """A dataclass field that carries its own documentation and bounds.

    Args:
      default: the value used when nothing else is said.
      help: one line saying what the field is.
      unit: its unit; empty for a pure number or a choice.
      source: section or equation of the paper, or where else the value comes from.
      low: least allowed value; `open_low` excludes the value itself.
      high: largest allowed value; `open_high` excludes the value itself.
      open_low: whether `low` itself is forbidden.
      open_high: whether `high` itself is forbidden.
      derived: it follows from the environment and is no option of a run.
      neutral: the value that changes nothing. Where nobody asks for another one the field is None in the program, which
        then is the same as before there was the field, down to the last digit.
      nested: whether a list of lists stands for all their items in order.
      only: name of another option and those of its values with which there is this one; None for an option that there
        always is.
    """
    metadata = {
        "help": help,
        "unit": unit,
        "source": source,
        "bounds": (low, high, open_low, open_high),
        "derived": derived,
        "neutral": neutral,
        "nested": nested,
        "only": only,
    }
    return dataclasses.field(default=default, metadata=metadata)


class Numbers(struct.PyTreeNode):
    """Base of a record of traced numbers: Python numbers on the host, arrays once `traced`.

    A Python number out of its bounds is refused when the record is made; arrays are checked by `check_traced`.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """

    def __post_init__(self) -> None:
        """Checks what is a Python number."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if "bounds" in field.metadata and isinstance(value, bool | int | float | str | np.generic):
                check_field(field, value)

    def traced(self) -> typing.Self:
        """The same numbers as strongly typed arrays of the default float, int and bool types."""
        return strong(self)


_Record = typing.TypeVar("_Record")
_KINDS = {int: jnp.int32, bool: jnp.bool_}


def strong(record: _Record) -> _Record:
    """Casts each field to a strong type: a Python number is weakly typed and would cost a second trace.

    Args:
      record: a dataclass of numbers, tuples of numbers or arrays.

    Returns:
      The same record with array fields; tuples become arrays of shape [length], what is neutral becomes None.
    """
    values = {
        field.name: None
        if _is_neutral(field, getattr(record, field.name))
        else jnp.asarray(getattr(record, field.name), _KINDS.get(field.type, precision.floating()))
        for field in dataclasses.fields(record)  # pyright: ignore[reportArgumentType]
    }
    return type(record)(**values)


def _is_neutral(field: dataclasses.Field, *values: Any) -> bool:
    """Whether values change nothing, and so need not be in the program; what is being traced may be anything."""
    neutral = field.metadata.get("neutral")
    if neutral is None or any(isinstance(value, Tracer) for value in values):
        return False
    return all(value is None or bool(np.all(np.asarray(value) == neutral)) for value in values)


def stacked(records: Sequence[_Record]) -> _Record:
    """Several records as one with host arrays [n, ...] in each field, of the types that `strong` gives.

    Args:
      records: n dataclasses of one type, of numbers or tuples of numbers.

    Returns:
      One record; what is neutral in all of them is None.
    """
    values = {}
    for field in dataclasses.fields(records[0]):  # pyright: ignore[reportArgumentType]
        each = [getattr(record, field.name) for record in records]
        kind = jax.dtypes.canonicalize_dtype(_KINDS.get(field.type, precision.floating()))
        values[field.name] = None if _is_neutral(field, *each) else np.array(each, kind)
    return type(records[0])(**values)


def close_match(name: str, known: Iterable[str]) -> str:
    """The end of an error message that names what was perhaps meant; empty if nothing is close."""
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def allowed(field: dataclasses.Field) -> str:
    """What a field accepts, in words: a list of choices or a range."""
    choices = typing.get_args(field.type) if typing.get_origin(field.type) is Literal else ()
    if choices:
        return "one of " + ", ".join(map(str, choices))
    if field.type is bool:
        return "true or false"
    if field.type is str:
        return "text"
    kind = "a list of numbers"
    if field.type in (int, float):
        kind = "a whole number" if field.type is int else "a number"
    low, high, open_low, open_high = field.metadata["bounds"]
    limits = []
    if low > -math.inf:
        limits.append(f"{'greater than' if open_low else 'at least'} {_plain(low)}")
    if high < math.inf:
        limits.append(f"{'less than' if open_high else 'at most'} {_plain(high)}")
    return " ".join([kind, " and ".join(limits)]).strip()


def _plain(number: float) -> str:
    return str(int(number)) if number == int(number) else f"{number:g}"


def check_field(field: dataclasses.Field, value: Any) -> None:
    """Raises `ConfigError` unless `value` has the field's type and lies within its bounds."""

    def refuse() -> typing.NoReturn:
        raise ConfigError(f"{field.name}: must be {allowed(field)}, got {value!r}")

    # Of the million fields of a large study nearly all are at their defaults.
    if type(value) is type(field.default) and value == field.default:
        return
    if typing.get_origin(field.type) is Literal:
        if value not in typing.get_args(field.type):
            refuse()
        return
    if field.type in (bool, str):
        if not isinstance(value, (bool, np.bool_) if field.type is bool else str):
            refuse()
        return
    several = typing.get_origin(field.type) is tuple
    if isinstance(value, tuple | list) != several:
        refuse()
    for number in value if several else (value,):
        if isinstance(number, bool) or not isinstance(number, numbers.Integral if field.type is int else numbers.Real):
            refuse()
        if not _within(field, number, number) or not _is_plain(number, field.default == math.inf):
            refuse()


def _is_plain(number: Any, infinite: bool) -> bool:
    """Whether a number is neither NaN nor too large to be a float; infinity only where it is allowed."""
    if isinstance(number, numbers.Integral):
        return abs(int(number)) < 2**1000
    return not math.isnan(number) and (infinite or not math.isinf(number))


def _within(field: dataclasses.Field, least: Any, most: Any) -> bool:
    low, high, open_low, open_high = field.metadata["bounds"]
    return bool((least > low if open_low else least >= low) and (most < high if open_high else most <= high))


def check_record(record: Any) -> None:
    """Checks each field of a dataclass by itself; raises `ConfigError` at the first wrong one."""
    for field in dataclasses.fields(record):
        if "bounds" in field.metadata:
            check_field(field, getattr(record, field.name))


def check_traced(record: Any) -> None:
    """Checks the arrays of a record of traced numbers against the bounds of their fields, before anything is traced.

    Args:
      record: with leaves [...] of any shape; leaves that are being traced are left to whoever handed them in.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    if not dataclasses.is_dataclass(record):
        return
    for field in dataclasses.fields(record):
        value = getattr(record, field.name)
        if "bounds" not in field.metadata or value is None or isinstance(value, Tracer) or field.type in (bool, str):
            continue
        values = np.asarray(value)
        for extreme in (values.min(), values.max()) if values.size else ():
            if not _within(field, extreme, extreme):  # so is NaN, which is both extremes
                raise ConfigError(f"{field.name}: must be {allowed(field)}, got {extreme:g}")


def check_array(name: str, value: Any, shape: tuple[int | None, ...], kind: type = float) -> None:
    """Checks an array at a public entry, before an operation deep inside complains about it.

    Args:
      name: what the message calls it.
      value: the array, also while it is being traced.
      shape: what it must have; None for any size.
      kind: float, int or bool.

    Raises:
      ConfigError: with one line that names the array and what is allowed.
    """
    try:
        chex.assert_shape(value, shape)
        chex.assert_type(value, kind)
    except (AssertionError, AttributeError, TypeError, ValueError) as error:
        wanted = f"({', '.join('any' if size is None else str(size) for size in shape)})"
        got = f"{np.shape(value)} of {getattr(value, 'dtype', type(value).__name__)}"
        raise ConfigError(f"{name}: must be an array of shape {wanted} and type {kind.__name__}, got {got}") from error
