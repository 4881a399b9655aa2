"""What files and NumPy hold for an option, as Python holds it."""

import dataclasses
import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np


def as_declared(option: dataclasses.Field, value: Any) -> Any:
    """Takes what a file or NumPy may hold for an option to what Python holds.

    Lists become tuples, NumPy's numbers Python's, whole floats stay floats.

    Args:
      option: its declaration.
      value: whatever was said.
    """
    kind = option.type
    if isinstance(value, np.ndarray) and (value.ndim == 0 or kind == tuple[float, ...]):
        value = value.tolist()
    if isinstance(value, np.generic):
        value = value.item()
    if kind == tuple[float, ...] and isinstance(value, list | tuple):
        items = _flat(value) if option.metadata.get("nested") else value
        return tuple(_as_float(item.item() if isinstance(item, np.generic) else item) for item in items)
    return _as_float(value) if kind is float else value


def _flat(value: Any) -> Iterable[Any]:
    """The items of nested lists in order."""
    return itertools.chain.from_iterable(_flat(item) if isinstance(item, list | tuple) else (item,) for item in value)


def _as_float(value: Any) -> Any:
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**1000:
        return float(value)
    return value
