"""A small array function rewritten as arithmetic on single numbers, with everything constant computed beforehand.

MJX describes a step for any model: hundreds of small arrays, most of whose entries are zeros, ones and other constants
of the model at hand. XLA computes them all, and on a CPU starting each of those operations costs more than its
arithmetic. `unrolled` traces such a function once, follows every array entry by itself, drops what is multiplied by
zero or not used, and gives back the same function as a list of scalar operations: vectorised over lanes it is a handful
of fused loops. What is computed is still what the traced function says, up to rounding.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend import core
from jax.interpreters import partial_eval

from icac_jax.fast.arithmetic import PRIMITIVES, Arithmetic, Operation

_CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}


@dataclasses.dataclass(frozen=True)
class _Place:
    """Stands for a number that is not known beforehand: an input or the result of an operation."""

    index: int


class _Recorder:
    """Follows array entries through a jaxpr. An entry is a NumPy number or a `_Place`."""

    def __init__(self) -> None:
        self.operations: list[Operation | None] = []
        self._places: dict[Any, _Place] = {}

    def inputs(self, shape: tuple[int, ...]) -> np.ndarray:
        """An array of new places."""
        entries = np.empty(shape, object)
        for index in np.ndindex(*shape):
            self.operations.append(None)
            entries[index] = _Place(len(self.operations) - 1)
        return entries

    def apply(self, primitive: Any, operands: tuple[Any, ...], params: dict[str, Any] | None = None) -> Any:
        """An elementwise primitive on entries, at least one of them a place: an operand, or a new operation's place."""
        known = _shortcut(primitive.name, operands)
        if known is not None:
            return known
        params = params or {}
        key = (primitive.name, str(params), tuple((type(o), o) for o in operands))
        if key not in self._places:
            self.operations.append(Operation(primitive.name, params, operands))
            self._places[key] = _Place(len(self.operations) - 1)
        return self._places[key]

    def combine(self, primitive: Any, first: Any, second: Any) -> Any:
        """A binary float operation on any two entries."""
        if isinstance(first, _Place) or isinstance(second, _Place):
            return self.apply(primitive, (first, second))
        return _NUMPY[primitive.name](first, second)

    def run(self, jaxpr: Any, consts: Any, args: Any) -> list[np.ndarray]:
        """Results of a jaxpr for arrays of entries."""
        values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*map(np.asarray, consts), *args], strict=True))
        for equation in jaxpr.eqns:
            operands = [
                np.asarray(atom.val) if isinstance(atom, core.Literal) else values[atom] for atom in equation.invars
            ]
            values.update(zip(equation.outvars, self.equation(equation, operands), strict=True))
        return [np.asarray(a.val) if isinstance(a, core.Literal) else values[a] for a in jaxpr.outvars]

    def equation(self, equation: Any, operands: list[np.ndarray]) -> list[np.ndarray]:
        """Results of one equation."""
        name, params = equation.primitive.name, equation.params
        if name in _CALLS:
            inner = params[_CALLS[name]]
            return self.run(inner.jaxpr, inner.consts, operands)
        if name in _MOVES:
            dtype = equation.outvars[0].aval.dtype
            return [_settled(moved, dtype) for moved in _MOVES[name](params, *operands)]
        if all(operand.dtype != object for operand in operands):
            return _constant(equation, operands)
        if name in PRIMITIVES:
            return [self.elementwise(equation, operands)]
        if name in ("scatter", "scatter-add"):
            return [self.scattered(equation, operands)]
        if name == "dot_general":
            return [self.dot(operands, params["dimension_numbers"])]
        if name == "reduce_sum":
            axes = params["axes"]
            kept = [axis for axis in range(operands[0].ndim) if axis not in axes]
            array = operands[0].transpose(*kept, *axes)
            array = array.reshape(*array.shape[: len(kept)], math.prod(array.shape[len(kept) :]))
            return [self.reduced(array)]
        if name == "cholesky":
            return [self.cholesky(operands[0])]
        if name == "triangular_solve":
            return [self.triangular_solve(operands[0], operands[1], params)]
        raise NotImplementedError(f"{name} on numbers that are not known beforehand")

    def elementwise(self, equation: Any, operands: list[np.ndarray]) -> np.ndarray:
        aval = equation.outvars[0].aval
        result = np.empty(aval.shape, object)
        spread = [np.broadcast_to(operand, aval.shape) for operand in operands]
        fixed = all(operand.dtype != object for operand in operands)
        assert not fixed
        for index in np.ndindex(*aval.shape):
            entries = tuple(operand[index] for operand in spread)
            if any(isinstance(entry, _Place) for entry in entries):
                result[index] = self.apply(equation.primitive, entries, equation.params)
            else:
                result[index] = _known(equation, entries)
        return _settled(result, aval.dtype)

    def scattered(self, equation: Any, operands: list[np.ndarray]) -> np.ndarray:
        """Updates written over, or added to, the entries where they land, at most one an entry."""
        array, positions, updates = operands
        numbers = np.arange(1, updates.size + 1, dtype=np.float32).reshape(updates.shape)
        with jax.ensure_compile_time_eval():
            landed = equation.primitive.bind(
                jnp.zeros(array.shape), jnp.asarray(positions), jnp.asarray(numbers), **equation.params
            )
        landed = np.asarray(landed).astype(int)
        assert len(set(landed[landed > 0])) == np.count_nonzero(landed) <= updates.size
        result = array.astype(object)
        for index in zip(*np.nonzero(landed), strict=True):
            new = updates.ravel()[landed[index] - 1]
            adds = equation.primitive.name == "scatter-add"
            result[index] = self.combine(lax.add_p, result[index], new) if adds else new
        return _settled(result, equation.outvars[0].aval.dtype)

    def reduced(self, array: np.ndarray) -> np.ndarray:
        """Sums over the last axis."""
        result = np.empty(array.shape[:-1], object)
        for index in np.ndindex(*result.shape):
            total = np.float32(0)
            for entry in array[index]:
                total = self.combine(lax.add_p, total, entry)
            result[index] = total
        return _settled(result, np.float32)

    def dot(self, operands: list[np.ndarray], dimension_numbers: Any) -> np.ndarray:
        first, second = operands
        (contract_first, contract_second), (batch_first, batch_second) = dimension_numbers
        free_first = [a for a in range(first.ndim) if a not in (*contract_first, *batch_first)]
        free_second = [a for a in range(second.ndim) if a not in (*contract_second, *batch_second)]
        batch = [first.shape[a] for a in batch_first]
        rows, columns = [first.shape[a] for a in free_first], [second.shape[a] for a in free_second]
        left = first.transpose(*batch_first, *free_first, *contract_first)
        right = second.transpose(*batch_second, *free_second, *contract_second)
        length = math.prod(first.shape[a] for a in contract_first)
        left = left.reshape(math.prod(batch), math.prod(rows), 1, length)
        right = right.reshape(math.prod(batch), 1, math.prod(columns), length)
        left, right = np.broadcast_arrays(left, right)
        products = np.empty(left.shape, object)
        for index in np.ndindex(*left.shape):
            products[index] = self.combine(lax.mul_p, left[index], right[index])
        return self.reduced(products).reshape(*batch, *rows, *columns)

    def cholesky(self, matrix: np.ndarray) -> np.ndarray:
        """The lower factor of a matrix [n, n], of which the lower triangle is read."""
        n = len(matrix)
        factor = np.full((n, n), np.float32(0), object)
        for i in range(n):
            for j in range(i + 1):
                total = matrix[i, j]
                for k in range(j):
                    total = self.combine(lax.sub_p, total, self.combine(lax.mul_p, factor[i, k], factor[j, k]))
                factor[i, j] = (
                    self.apply(lax.sqrt_p, (total,), {"accuracy": None})
                    if i == j
                    else self.combine(lax.div_p, total, factor[j, j])
                )
        return factor

    def triangular_solve(self, matrix: np.ndarray, right: np.ndarray, params: dict[str, Any]) -> np.ndarray:
        """X of op(A) X = B, A [n, n] and B [n, m]."""
        assert params["left_side"]
        assert not params["unit_diagonal"]
        matrix = matrix.T if params["transpose_a"] else matrix
        lower = params["lower"] != params["transpose_a"]
        n = len(matrix)
        order = range(n) if lower else range(n - 1, -1, -1)
        result = np.empty(right.shape, object)
        for column in range(right.shape[1]):
            for i in order:
                total = right[i, column]
                for j in range(i) if lower else range(i + 1, n):
                    total = self.combine(lax.sub_p, total, self.combine(lax.mul_p, matrix[i, j], result[j, column]))
                result[i, column] = self.combine(lax.div_p, total, matrix[i, i])
        return result


_NUMPY = {
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


def _broadcast_in_dim(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    shape = [1] * len(params["shape"])
    for axis, size in zip(params["broadcast_dimensions"], array.shape, strict=True):
        shape[axis] = size
    return [np.broadcast_to(array.reshape(shape), params["shape"])]


def _slice(params: dict[str, Any], array: np.ndarray) -> list[np.ndarray]:
    strides = params["strides"] or (1,) * array.ndim
    return [array[tuple(map(slice, params["start_indices"], params["limit_indices"], strides))]]


def _concatenate(params: dict[str, Any], *arrays: np.ndarray) -> list[np.ndarray]:
    return [np.concatenate([array.astype(object) for array in arrays], axis=params["dimension"])]


def _gather(params: dict[str, Any], array: np.ndarray, starts: np.ndarray) -> list[np.ndarray]:
    numbers, sizes = params["dimension_numbers"], params["slice_sizes"]
    if numbers.operand_batching_dims or starts.dtype == object:
        raise NotImplementedError("gather over batches, or from places that are not known beforehand")
    kept = [size for axis, size in enumerate(sizes) if axis not in numbers.collapsed_slice_dims]
    result = np.empty((*starts.shape[:-1], *kept), array.dtype)
    for index in np.ndindex(*starts.shape[:-1]):
        begin = np.zeros(array.ndim, int)
        begin[list(numbers.start_index_map)] = starts[index]
        if np.any(begin < 0) or np.any(begin + sizes > array.shape):
            raise NotImplementedError("gather from beyond an array")
        part = array[tuple(slice(at, at + size) for at, size in zip(begin, sizes, strict=True))]
        result[(*index, ...)] = part.reshape(kept)
    offset = range(starts.ndim - 1, result.ndim)
    return [np.moveaxis(result, list(offset), list(numbers.offset_dims))]


# Operations that only move entries about, for known and unknown ones alike.
_MOVES: dict[str, Callable[..., list[np.ndarray]]] = {
    "broadcast_in_dim": _broadcast_in_dim,
    "slice": _slice,
    "concatenate": _concatenate,
    "gather": _gather,
    "reshape": lambda params, array: [array.reshape(params["new_sizes"])],
    "squeeze": lambda params, array: [np.squeeze(array, params["dimensions"])],
    "transpose": lambda params, array: [array.transpose(params["permutation"])],
    "stack": lambda params, *arrays: [np.stack([a.astype(object) for a in arrays], axis=params["axis"])],
}


def _constant(equation: Any, operands: list[np.ndarray]) -> list[np.ndarray]:
    """Results of an equation whose operands are known."""
    name, params, aval = equation.primitive.name, equation.params, equation.outvars[0].aval
    if name in _NUMPY:
        return [np.asarray(_NUMPY[name](*operands), aval.dtype)]
    if name == "convert_element_type":
        return [operands[0].astype(aval.dtype)]
    if name == "select_n" and len(operands) == 3:
        return [np.where(operands[0], operands[2], operands[1])]
    with jax.ensure_compile_time_eval():
        results = equation.primitive.bind(*map(jnp.asarray, operands), **params)
    return [np.asarray(r) for r in (results if equation.primitive.multiple_results else [results])]


def _known(equation: Any, entries: tuple[Any, ...]) -> Any:
    """A number from numbers."""
    return _constant_entry(equation, entries)


def _constant_entry(equation: Any, entries: tuple[Any, ...]) -> Any:
    name, aval = equation.primitive.name, equation.outvars[0].aval
    if name == "select_n":
        return entries[1 + int(entries[0])]
    if name in _NUMPY:
        return np.asarray(_NUMPY[name](*entries), aval.dtype)[()]
    if name == "convert_element_type":
        return np.asarray(entries[0], aval.dtype)[()]
    with jax.ensure_compile_time_eval():
        return np.asarray(equation.primitive.bind(*map(jnp.asarray, entries), **equation.params))[()]


def _settled(entries: np.ndarray, dtype: Any) -> np.ndarray:
    """The array as plain numbers if all of them are known."""
    if any(isinstance(entry, _Place) for entry in entries.ravel()):
        return entries
    return entries.astype(dtype)


def _is(entry: Any, number: float) -> bool:
    return not isinstance(entry, _Place) and bool(entry == number)


def _shortcut(name: str, operands: tuple[Any, ...]) -> Any:
    """What an operation comes to without computing it, or None."""
    if name == "select_n":
        which, *cases = operands
        if not isinstance(which, _Place):
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


def unrolled(function: Callable[..., Any], *shapes: tuple[int, ...]) -> Arithmetic:
    """The function as scalar arithmetic.

    Args:
      function: of float32 arrays; returns one float32 array or several.
      shapes: of its arguments.

    Returns:
      A function of the same arrays that returns the list of its results.

    Raises:
      NotImplementedError: the function does something to unknown numbers that is not followed here.
    """
    traced = jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes))
    jaxpr, _ = partial_eval.dce_jaxpr(traced.jaxpr, [True] * len(traced.jaxpr.outvars), instantiate=True)
    recorder = _Recorder()
    results = recorder.run(jaxpr, traced.consts, [recorder.inputs(shape) for shape in shapes])
    arguments = sum(map(math.prod, shapes))
    used = _used(recorder.operations, results)
    place = {index: index for index in range(arguments)}
    place |= {index: arguments + number for number, index in enumerate(used)}

    def operand(entry: Any) -> Any:
        return place[entry.index] if isinstance(entry, _Place) else _number(entry)

    operations = (recorder.operations[index] for index in used)
    return Arithmetic(
        shapes,
        tuple(o._replace(operands=tuple(map(operand, o.operands))) for o in operations if o is not None),
        tuple((result.shape, tuple(map(operand, result.ravel()))) for result in results),
    )


_OF_KIND = {"f": np.float32, "i": np.int32, "b": np.bool_}


def _number(entry: Any) -> np.generic:
    """A known entry as a NumPy number of the type that JAX gives it: Python's own are what arrays of objects hold."""
    number = np.asarray(entry)[()]
    return _OF_KIND.get(number.dtype.kind, number.dtype.type)(number)


def _used(operations: list[Operation | None], results: list[np.ndarray]) -> list[int]:
    """The places of the operations on which the results depend, in order."""
    wanted = {entry.index for result in results for entry in result.ravel() if isinstance(entry, _Place)}
    used = []
    for index, operation in reversed(list(enumerate(operations))):
        if index in wanted and operation is not None:
            used.append(index)
            wanted.update(operand.index for operand in operation.operands if isinstance(operand, _Place))
    return used[::-1]
