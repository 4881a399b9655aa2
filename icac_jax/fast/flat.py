"""A traced function as one list of operations: a call of a function within it is replaced by what that does."""

import dataclasses
import itertools
import math
from collections import Counter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.extend import core

from icac_jax.fast.scalars import CALLS

# A key is followed as the two words that it is made of, so that these change nothing.
_NOTHING = ("reshard", "random_wrap", "random_unwrap")
# Their result has the entries of their operands, each at most once.
MOVES = ("concatenate", "reshape", "slice", "squeeze", "stack", "transpose")
REDUCTIONS = ("reduce_and", "reduce_max", "reduce_min", "reduce_or", "reduce_sum")
# Each entry of the result depends on the same entry of the operands alone.
_ARITHMETIC = ("abs", "add", "add_any", "div", "integer_pow", "max", "min", "mul", "neg", "rem", "sign", "sub")
_ROUNDING = ("bitcast_convert_type", "ceil", "clamp", "convert_element_type", "floor", "round")
_FUNCTIONS = ("atan2", "cos", "erf_inv", "exp", "exp2", "log", "log1p", "pow", "rsqrt", "sin", "sqrt", "square", "tanh")
_COMPARISONS = ("eq", "ge", "gt", "is_finite", "le", "lt", "ne", "select_n")
_BITS = ("and", "not", "or", "shift_left", "shift_right_logical", "xor")
BY_ENTRY = frozenset(_ARITHMETIC + _ROUNDING + _FUNCTIONS + _COMPARISONS + _BITS)


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """A value that is known when the function is traced.

    Attributes:
      value: an array or a number.
    """

    value: Any


class Operation(NamedTuple):
    """One operation of a flat function.

    Attributes:
      primitive: of JAX.
      params: its parameters.
      inputs: the place of each value, or what is known.
      outputs: the places of the results.
      avals: shape and type of each input.
      out_avals: of each output.
    """

    primitive: Any
    params: dict[str, Any]
    inputs: list[int | Known]
    outputs: list[int]
    avals: list[Any]
    out_avals: list[Any]

    @property
    def name(self) -> str:
        """Of the primitive."""
        return self.primitive.name


class Flat(NamedTuple):
    """A function without calls.

    Attributes:
      inputs: the places of its arguments.
      avals: shape and type of each argument.
      operations: in their order.
      outputs: the places of its results, or what is known.
    """

    inputs: list[int]
    avals: list[Any]
    operations: list[Operation]
    outputs: list[int | Known]


def is_key(aval: Any) -> bool:
    """Whether something of a shape and type is a key of `jax.random`."""
    return jnp.issubdtype(aval.dtype, jax.dtypes.prng_key)


def flat(closed: Any) -> Flat:
    """The function of a closed jaxpr without calls."""
    operations: list[Operation] = []
    places = itertools.count()

    def visit(jaxpr: Any, consts: Any, args: Any) -> list[int | Known]:
        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*map(Known, consts), *args], strict=True))
        for equation in jaxpr.eqns:
            inputs = [_read(atom, values) for atom in equation.invars]
            name = equation.primitive.name
            if name in _NOTHING:
                outputs: Any = inputs
            elif name in CALLS:
                inner = equation.params[CALLS[name]]
                outputs = visit(inner.jaxpr, inner.consts, inputs)
            else:
                outputs = [next(places) for _ in equation.outvars]
                avals, out_avals = [a.aval for a in equation.invars], [v.aval for v in equation.outvars]
                operations.append(Operation(equation.primitive, equation.params, inputs, outputs, avals, out_avals))
            values.update(zip(equation.outvars, outputs, strict=True))
        return [_read(atom, values) for atom in jaxpr.outvars]

    inputs = [next(places) for _ in closed.jaxpr.invars]
    outputs = visit(closed.jaxpr, closed.consts, inputs)
    return Flat(inputs, [variable.aval for variable in closed.jaxpr.invars], operations, outputs)


def _read(atom: Any, values: dict[Any, Any]) -> int | Known:
    read = Known(atom.val) if isinstance(atom, core.Literal) else values[atom]
    if isinstance(read, Known) and is_key(atom.aval):
        return Known(jax.random.key_data(read.value))
    return read


def needed_again(function: Flat) -> set[int]:
    """Places of values that are computed, not only moved, and needed by several operations or for several entries."""
    uses = Counter(place for operation in function.operations for place in operation.inputs if isinstance(place, int))
    again = {place for place, number in uses.items() if number > 1}
    for operation in reversed(function.operations):
        size = math.prod(operation.out_avals[0].shape)
        moved = any(place in again for place in operation.outputs)
        for place, aval in zip(operation.inputs, operation.avals, strict=True):
            if operation.name in MOVES:
                wanted = moved
            elif operation.name in BY_ENTRY or operation.name == "broadcast_in_dim":
                wanted = math.prod(aval.shape) < size
            else:
                wanted = operation.name not in REDUCTIONS
            if wanted and isinstance(place, int):
                again.add(place)
    moves = {place for operation in function.operations if operation.name in MOVES for place in operation.outputs}
    return again - moves - set(function.inputs)


def by_rows(function: Flat) -> list[bool]:
    """Which arguments of two axes or more are only read row by row and written in places, never used as a whole."""
    origin: dict[Any, int] = {
        place: place for place, aval in zip(function.inputs, function.avals, strict=True) if aval.ndim >= 2
    }
    whole = set()
    for operation in function.operations:
        inputs = operation.inputs
        if operation.name in ("dynamic_slice", "scatter") and inputs[0] in origin:
            if operation.name == "scatter":
                origin[operation.outputs[0]] = origin[inputs[0]]
            inputs = inputs[1:]
        whole |= {origin[place] for place in inputs if place in origin}
    return [place in origin and place not in whole for place in function.inputs]
