"""Constant folding for `scalars`: what is known beforehand is computed by NumPy and takes no operation.

An entry of an array is a number, or a `Place` that stands for one that is not known yet.
"""

import dataclasses
import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@dataclasses.dataclass(frozen=True)
class Place:
    """Stands for a number that is not known beforehand: an input or the result of an operation.

    Attributes:
      index: its place among the inputs and the results before it.
    """

    index: int


# NumPy's functions by the name of the primitive.
NUMPY = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "max": np.maximum,
    "min": np.minimum,
    "neg": np.negative,
    "lt": np.less,
    "gt": np.greater,
    "ge": np.greater_equal,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "not": np.logical_not,
    "sqrt": np.sqrt,
    "abs": np.abs,
    "sign": np.sign,
    "floor": np.floor,
    "square": np.square,
}


def folded(equation: Any, operands: list[np.ndarray]) -> list[np.ndarray]:
    """Results of an equation whose operands are known."""
    name, params, aval = equation.primitive.name, equation.params, equation.outvars[0].aval
    if name in NUMPY:
        return [np.asarray(NUMPY[name](*operands), aval.dtype)]
    if name == "convert_element_type":
        return [operands[0].astype(aval.dtype)]
    if name == "select_n" and len(operands) == 3:
        return [np.where(operands[0], operands[2], operands[1])]
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*map(jnp.asarray, operands), **params)
    return [np.asarray(r) for r in (results if equation.primitive.multiple_results else [results])]


def folded_entry(equation: Any, entries: tuple[Any, ...]) -> Any:
    """A number from numbers, as one entry of an elementwise equation's result."""
    name, aval = equation.primitive.name, equation.outvars[0].aval
    if name == "select_n":
        return entries[1 + int(entries[0])]
    if name in NUMPY:
        return np.asarray(NUMPY[name](*entries), aval.dtype)[()]
    if name == "convert_element_type":
        return np.asarray(entries[0], aval.dtype)[()]
    with jax.ensure_compile_time_eval():
        return np.asarray(equation.primitive.bind(*map(jnp.asarray, entries), **equation.params))[()]


def settled(entries: np.ndarray, dtype: Any) -> np.ndarray:
    """The array as plain numbers if all of them are known."""
    if any(isinstance(entry, Place) for entry in entries.ravel()):
        return entries
    return entries.astype(dtype)


def _is(entry: Any, number: float) -> bool:
    return not isinstance(entry, Place) and bool(entry == number)


def shortcut(name: str, operands: tuple[Any, ...]) -> Any:
    """What an operation comes to without computing it, or None."""
    if name == "select_n":
        which, *cases = operands
        if not isinstance(which, Place):
            return cases[int(which)]
        return cases[0] if all(type(c) is type(cases[0]) and c == cases[0] for c in cases) else None
    if name == "mul":
        for one, other in itertools.permutations(operands):
            if _is(one, 1):
                return other
            if _is(one, 0):
                return one
    if name == "add":
        for one, other in itertools.permutations(operands):
            if _is(one, 0):
                return other
    if (name == "sub" and _is(operands[1], 0)) or (name == "div" and _is(operands[1], 1)):
        return operands[0]
    if name == "div" and _is(operands[0], 0):
        return operands[0]
    if name == "max" and (_is(operands[0], -np.inf) or _is(operands[1], -np.inf)):
        return operands[0] if _is(operands[1], -np.inf) else operands[1]
    if name == "min" and (_is(operands[0], np.inf) or _is(operands[1], np.inf)):
        return operands[0] if _is(operands[1], np.inf) else operands[1]
    return None
