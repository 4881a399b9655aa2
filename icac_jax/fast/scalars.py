"""A small array function rewritten as arithmetic on single numbers, with everything constant computed beforehand.

MJX describes a step for any model: hundreds of small arrays, most of whose entries are zeros, ones and other constants
of the model at hand. XLA computes them all, and on a CPU starting each of those operations costs more than its
arithmetic. `unrolled` traces such a function once, follows every array entry by itself, drops what is multiplied by
zero or not used, and gives back the same function as a list of scalar operations: vectorised over lanes it is a handful
of fused loops. What is computed is still what the traced function says, up to rounding.
"""

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
from icac_jax.fast.folding import NUMPY, Place, folded, folded_entry, settled, shortcut
from icac_jax.fast.moves import MOVES

# Operations that call a function, and the parameter that holds it.
CALLS = {"jit": "jaxpr", "pjit": "jaxpr", "closed_call": "call_jaxpr", "custom_jvp_call": "call_jaxpr"}


class _Recorder:
    """Follows array entries through a jaxpr. An entry is a NumPy number or a `Place`."""

    def __init__(self) -> None:
        self.operations: list[Operation | None] = []
        self._places: dict[Any, Place] = {}

    def inputs(self, shape: tuple[int, ...]) -> np.ndarray:
        """An array of new places."""
        entries = np.empty(shape, object)
        for index in np.ndindex(*shape):
            self.operations.append(None)
            entries[index] = Place(len(self.operations) - 1)
        return entries

    def apply(self, primitive: Any, operands: tuple[Any, ...], params: dict[str, Any] | None = None) -> Any:
        """An elementwise primitive on entries, at least one of them a place: an operand, or a new operation's place."""
        known = shortcut(primitive.name, operands)
        if known is not None:
            return known
        params = params or {}
        key = (primitive.name, str(params), tuple((type(o), o) for o in operands))
        if key not in self._places:
            self.operations.append(Operation(primitive.name, params, operands))
            self._places[key] = Place(len(self.operations) - 1)
        return self._places[key]

    def combine(self, primitive: Any, first: Any, second: Any) -> Any:
        """A binary float operation on any two entries."""
        if isinstance(first, Place) or isinstance(second, Place):
            return self.apply(primitive, (first, second))
        return NUMPY[primitive.name](first, second)

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
        if name in CALLS:
            inner = params[CALLS[name]]
            return self.run(inner.jaxpr, inner.consts, operands)
        if name in MOVES:
            dtype = equation.outvars[0].aval.dtype
            return [settled(moved, dtype) for moved in MOVES[name](params, *operands)]
        if all(operand.dtype != object for operand in operands):
            return folded(equation, operands)
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
            if any(isinstance(entry, Place) for entry in entries):
                result[index] = self.apply(equation.primitive, entries, equation.params)
            else:
                result[index] = folded_entry(equation, entries)
        return settled(result, aval.dtype)

    def scattered(self, equation: Any, operands: list[np.ndarray]) -> np.ndarray:
        """Updates written over, or added to, the entries where they land, at most one an entry."""
        array, positions, updates = operands
        numbers = np.arange(1, updates.size + 1, dtype=np.float32).reshape(updates.shape)
        with jax.ensure_compile_time_eval():
            landed = equation.primitive.bind(
                jnp.zeros(array.shape, jnp.float32), jnp.asarray(positions), jnp.asarray(numbers), **equation.params
            )
        landed = np.asarray(landed).astype(int)
        assert len(set(landed[landed > 0])) == np.count_nonzero(landed) <= updates.size
        result = array.astype(object)
        for index in zip(*np.nonzero(landed), strict=True):
            new = updates.ravel()[landed[index] - 1]
            adds = equation.primitive.name == "scatter-add"
            result[index] = self.combine(lax.add_p, result[index], new) if adds else new
        return settled(result, equation.outvars[0].aval.dtype)

    def reduced(self, array: np.ndarray) -> np.ndarray:
        """Sums over the last axis."""
        result = np.empty(array.shape[:-1], object)
        for index in np.ndindex(*result.shape):
            total = np.float32(0)
            for entry in array[index]:
                total = self.combine(lax.add_p, total, entry)
            result[index] = total
        return settled(result, np.float32)

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
        return place[entry.index] if isinstance(entry, Place) else _number(entry)

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
    wanted = {entry.index for result in results for entry in result.ravel() if isinstance(entry, Place)}
    used = []
    for index, operation in reversed(list(enumerate(operations))):
        if index in wanted and operation is not None:
            used.append(index)
            wanted.update(operand.index for operand in operation.operands if isinstance(operand, Place))
    return used[::-1]
