"""A function of arrays as a list of operations on single numbers: plain data that can be run, and kept as JSON."""

import dataclasses
import itertools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

# What an operation may be. Only these are run, whatever a file says.
PRIMITIVES = {
    primitive.name: primitive
    for primitive in (
        *(lax.abs_p, lax.add_p, lax.and_p, lax.convert_element_type_p, lax.cos_p, lax.div_p, lax.eq_p, lax.floor_p),
        *(lax.ge_p, lax.gt_p, lax.integer_pow_p, lax.le_p, lax.lt_p, lax.max_p, lax.min_p, lax.mul_p, lax.ne_p),
        *(lax.neg_p, lax.not_p, lax.or_p, lax.rsqrt_p, lax.select_n_p, lax.sign_p, lax.sin_p, lax.sqrt_p),
        *(lax.square_p, lax.sub_p),
    )
}
_DTYPES = ("float32", "int32", "bool")
_DTYPE_PARAM = "new_dtype"


class Operation(NamedTuple):
    """One operation.

    Attributes:
      name: of the primitive, one of `PRIMITIVES`.
      params: of the primitive.
      operands: an int is the number at that place, a NumPy number is itself.
    """

    name: str
    params: dict[str, Any]
    operands: tuple[Any, ...]


@dataclasses.dataclass(frozen=True, eq=False)  # as a function it is one thing, and has a hash
class Arithmetic:
    """Operations on numbers, whose places are counted: entries of the arguments first, then a place an operation.

    Attributes:
      shapes: of the float32 arguments.
      operations: in an order in which they can be run.
      results: shape and entries of each result, entries as operands are.
    """

    shapes: tuple[tuple[int, ...], ...]
    operations: tuple[Operation, ...]
    results: tuple[tuple[tuple[int, ...], tuple[Any, ...]], ...]

    def __call__(self, *arrays: jax.Array) -> list[jax.Array]:
        """The results for these arguments."""
        numbers = [array[index] for array in arrays for index in np.ndindex(*array.shape)]

        def number(operand: Any) -> Any:
            return numbers[operand] if isinstance(operand, int) else operand

        for name, params, operands in self.operations:
            numbers.append(PRIMITIVES[name].bind(*map(number, operands), **params))
        return [
            jnp.stack([jnp.asarray(number(entry)) for entry in entries]).reshape(shape)
            for shape, entries in self.results
        ]

    def as_json(self) -> dict[str, Any]:
        """The same as lists, numbers and text.

        Raises:
          ValueError: a parameter of an operation is something else.
        """
        return {
            "shapes": [list(shape) for shape in self.shapes],
            "operations": [
                [name, {key: _param_as_json(key, value) for key, value in params.items()}, *map(_as_json, operands)]
                for name, params, operands in self.operations
            ],
            "results": [[list(shape), [_as_json(entry) for entry in entries]] for shape, entries in self.results],
        }


def from_json(data: Any) -> Arithmetic:
    """The arithmetic that `Arithmetic.as_json` described, to the bit.

    Raises:
      ValueError: it is not such a description; nothing of it has been run.
    """
    try:
        shapes = tuple(_shape(shape) for shape in data["shapes"])
        known = itertools.count(sum(map(math.prod, shapes)))
        operations = tuple(_operation(written, next(known)) for written in data["operations"])
        places = next(known)
        results = tuple(
            (_shape(shape), tuple(_operand(e, places) for e in entries)) for shape, entries in data["results"]
        )
        if any(math.prod(shape) != len(entries) for shape, entries in results):
            raise ValueError("a result of another size")
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"no description of arithmetic: {error!r}") from error
    return Arithmetic(shapes, operations, results)


def _as_json(operand: Any) -> Any:
    if isinstance(operand, int):
        return operand
    if operand.dtype.name not in _DTYPES:
        raise ValueError(f"a constant of type {operand.dtype}")
    return [operand.dtype.name, operand.item()]  # a float as the double of the same value: exact


def _param_as_json(key: str, value: Any) -> Any:
    if key == _DTYPE_PARAM:
        return np.dtype(value).name
    if value is not None and not isinstance(value, bool | int):
        raise ValueError(f"a parameter {key} = {value!r}")
    return value


def _shape(shape: Any) -> tuple[int, ...]:
    if not all(type(size) is int and size >= 0 for size in shape):
        raise ValueError("a shape of other things than sizes")
    return tuple(shape)


def _operand(written: Any, places: int) -> Any:
    if type(written) is int:
        if not 0 <= written < places:
            raise ValueError("a place that is not known yet")
        return written
    dtype, value = written
    if dtype not in _DTYPES or not isinstance(value, bool | int | float):
        raise ValueError("a constant of another type")
    return np.dtype(dtype).type(value)


def _operation(written: Any, places: int) -> Operation:
    name, params, *operands = written
    if name not in PRIMITIVES:
        raise ValueError(f"an operation {name!r}")
    if params.get(_DTYPE_PARAM, "float32") not in _DTYPES:
        raise ValueError("a conversion to another type")
    values = {key: np.dtype(value) if key == _DTYPE_PARAM else value for key, value in params.items()}
    return Operation(name, values, tuple(_operand(operand, places) for operand in operands))
