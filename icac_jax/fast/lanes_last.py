"""A step written for one lane, done for all lanes with the lanes as the last axis of every array.

`jax.vmap` puts lanes first. A lane's arrays are short, so that most loops which XLA makes of them run over a few
entries: too few for a processor's vectors. With lanes last every loop is over lanes, and what is needed more than once
is computed once. The step is followed operation by operation, as `jax.vmap` does it; an operation that is not known
here raises `NotFollowed`, and the caller takes `jax.vmap`. A key of `jax.random` is followed as its two words.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.lax import GatherScatterMode

from icac_jax.fast import rows
from icac_jax.fast.flat import BY_ENTRY, Flat, Known, Operation, flat, is_key, needed_again
from icac_jax.fast.kernel import once
from icac_jax.fast.sums import halved

_COMBINE = {
    "reduce_and": lax.bitwise_and,
    "reduce_max": lax.max,
    "reduce_min": lax.min,
    "reduce_or": lax.bitwise_or,
    "reduce_sum": lax.add,
}


class NotFollowed(Exception):
    """A step has an operation for which there is no rule here."""


class Spread(NamedTuple):
    """A value that each lane has for itself.

    Attributes:
      array: [..., L], or [L, ...] where `first`.
      first: of what is read and written by rows, so that the entries of a row lie side by side.
    """

    array: jax.Array
    first: bool = False

    @property
    def last(self) -> jax.Array:
        """The array with lanes last."""
        return jnp.moveaxis(self.array, 0, -1) if self.first else self.array


# What a place holds while a step is followed: a value per lane, or one that all lanes share.
Value = Spread | jax.Array | np.ndarray


def whole(value: Value, aval: Any, lanes: int, shape: tuple[int, ...] | None = None) -> jax.Array:
    """A value of a lane's shape and type as an array [..., L], repeated to another shape where one is given."""
    shape = tuple(aval.shape) if shape is None else shape
    if not isinstance(value, Spread):
        return lax.broadcast_in_dim(jnp.asarray(value, aval.dtype), (*shape, lanes), range(np.ndim(value)))
    array = value.last
    if array.shape[:-1] == shape:
        return array
    return lax.broadcast_in_dim(array, (*shape, lanes), range(len(shape) + 1 - array.ndim, len(shape) + 1))


def follow(function: Flat, args: Sequence[Value], lanes: int) -> list[Value]:
    """The results of a function of one lane for all lanes.

    Args:
      function: of one lane.
      args: its arguments.
      lanes: L.

    Raises:
      NotFollowed: there is no rule for one of its operations.
    """
    values = dict(zip(function.inputs, args, strict=True))
    again = needed_again(function)

    def of(place: int | Known) -> Value:
        return place.value if isinstance(place, Known) else values[place]

    for operation in function.operations:
        results = _results(operation, [of(place) for place in operation.inputs], lanes)
        for place, result in zip(operation.outputs, results, strict=True):
            if isinstance(result, Spread) and place in again:
                result = Spread(once(result.array), result.first)
            values[place] = result
    return [of(place) for place in function.outputs]


def _results(operation: Operation, args: list[Value], lanes: int) -> list[Value]:
    name, params = operation.name, operation.params
    if not any(isinstance(arg, Spread) for arg in args):
        found = operation.primitive.bind(*args, **params)
        return list(found) if operation.primitive.multiple_results else [found]
    if any(is_key(aval) for aval in (*operation.avals, *operation.out_avals)):
        raise NotFollowed(f"{name} of keys")
    if name in BY_ENTRY:
        shape = operation.out_avals[0].shape
        if any(aval.ndim not in (0, len(shape)) for aval in operation.avals):
            raise NotFollowed(f"{name} that changes the shape")
        entries = [whole(arg, aval, lanes, shape) for arg, aval in zip(args, operation.avals, strict=True)]
        return [Spread(operation.primitive.bind(*entries, **params))]
    if name in _RULES:
        return _RULES[name](operation, args, lanes)
    raise NotFollowed(name)


# Rules: (operation, what its inputs hold, L) -> what its outputs hold. At least one input is a value per lane.
_Rule = Callable[[Operation, list[Any], int], list[Value]]


def _moved(move: Callable[[jax.Array, dict[str, Any], int], jax.Array]) -> _Rule:
    """The rule of an operation of one array, from (array [..., L], params, L) -> array [..., L]."""
    return lambda operation, args, lanes: [Spread(move(args[0].last, operation.params, lanes))]


def _sliced(array: jax.Array, params: dict[str, Any], lanes: int) -> jax.Array:
    strides = None if params["strides"] is None else (*params["strides"], 1)
    return lax.slice(array, (*params["start_indices"], 0), (*params["limit_indices"], lanes), strides)


def _broadcast(array: jax.Array, params: dict[str, Any], lanes: int) -> jax.Array:
    shape = (*params["shape"], lanes)
    return lax.broadcast_in_dim(array, shape, (*params["broadcast_dimensions"], len(shape) - 1))


def _joined(join: Callable[[list[jax.Array], dict[str, Any]], jax.Array]) -> _Rule:
    """The rule of an operation of several arrays."""

    def rule(operation: Operation, args: list[Any], lanes: int) -> list[Value]:
        arrays = [whole(arg, aval, lanes) for arg, aval in zip(args, operation.avals, strict=True)]
        return [Spread(join(arrays, operation.params))]

    return rule


def _reduced(operation: Operation, args: list[Any], lanes: int) -> list[Value]:
    array = args[0].last
    axes = operation.params["axes"]
    if array.size == 0:
        raise NotFollowed("reduction of nothing")
    front = jnp.moveaxis(array, axes, range(len(axes)))
    front = front.reshape(-1, *front.shape[len(axes) :])
    return [Spread(halved(_COMBINE[operation.name], front))]


def _while(operation: Operation, args: list[Any], lanes: int) -> list[Value]:
    """Goes on until no lane wants to; a lane that does not is left as it is."""
    params = operation.params
    first, second = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    condition, body = flat(params["cond_jaxpr"]), flat(params["body_jaxpr"])

    def going(carry: list[jax.Array]) -> jax.Array:
        found = follow(condition, [*args[:first], *map(Spread, carry)], lanes)
        return whole(found[0], params["cond_jaxpr"].out_avals[0], lanes)

    def step(carry: list[jax.Array]) -> list[jax.Array]:
        new = follow(body, [*args[first:second], *map(Spread, carry)], lanes)
        on = going(carry)
        return [
            jnp.where(on, whole(a, aval, lanes), b) for a, b, aval in zip(new, carry, operation.out_avals, strict=True)
        ]

    start = [whole(arg, aval, lanes) for arg, aval in zip(args[second:], operation.out_avals, strict=True)]
    return [*map(Spread, lax.while_loop(lambda carry: jnp.any(going(carry)), step, start))]


def _scan(operation: Operation, args: list[Any], lanes: int) -> list[Value]:
    """A loop of so many rounds that only carries."""
    params = operation.params
    consts, avals = params["num_consts"], operation.out_avals
    if len(args) != consts + params["num_carry"] or len(avals) != params["num_carry"]:
        raise NotFollowed("scan over arrays")
    body, start = flat(params["jaxpr"]), args[consts:]
    # The loop's own counter, and whatever else no lane has for itself.
    shared = [
        not isinstance(value, Spread) and aval.dtype == jnp.int32 for value, aval in zip(start, avals, strict=True)
    ]

    def spread(values: Iterable[Value]) -> list[Any]:
        return [v if same else whole(v, a, lanes) for v, same, a in zip(values, shared, avals, strict=True)]

    def step(_: jax.Array, carry: list[jax.Array]) -> list[jax.Array]:
        values = [value if same else Spread(value) for value, same in zip(carry, shared, strict=True)]
        new = follow(body, [*args[:consts], *values], lanes)
        if any(same and isinstance(value, Spread) for value, same in zip(new, shared, strict=True)):
            raise NotFollowed("scan that makes of a shared number one per lane")
        return spread(new)

    end = lax.fori_loop(0, params["length"], step, spread(start))
    return [value if same else Spread(value) for value, same in zip(end, shared, strict=True)]


def _row(operation: Operation, args: list[Any], lanes: int) -> list[Value]:
    """`dynamic_slice` of one row that each lane names for itself, or of places that all lanes share."""
    array, *starts = args
    sizes, shape = operation.params["slice_sizes"], operation.avals[0].shape
    named = [isinstance(start, Spread) for start in starts]
    if not any(named):
        if array.first:
            found = lax.dynamic_slice(array.array, [0, *starts], [lanes, *sizes])
            return [Spread(jnp.moveaxis(found, 0, -1))]
        return [Spread(lax.dynamic_slice(array.array, [*starts, 0], [*sizes, lanes]))]
    if named[0] and not any(named[1:]) and sizes == (1, *shape[1:]):
        index = starts[0].last
        if isinstance(array, Spread) and array.first:
            return [Spread(jnp.moveaxis(rows.taken(array.array, index), 0, -1)[None])]
        return [Spread(rows.taken_last(whole(array, operation.avals[0], lanes), index)[None])]
    raise NotFollowed("dynamic_slice of another form")


def _picked(operation: Operation, args: list[Any], lanes: int) -> list[Value]:
    """`gather` of one entry that each lane names for itself."""
    array, index = args
    params, numbers = operation.params, operation.params["dimension_numbers"]
    entry = numbers.collapsed_slice_dims == numbers.start_index_map == (0,) and params["slice_sizes"] == (1,)
    one = entry and operation.avals[1].shape == (1,) and params["mode"] != GatherScatterMode.FILL_OR_DROP
    if not (one and isinstance(array, Spread) and isinstance(index, Spread)):
        raise NotFollowed("gather of another form")
    return [Spread(rows.taken_last(array.last, index.last[0]))]


def _written(operation: Operation, args: list[Any], lanes: int) -> list[Value]:
    """`scatter` of slices, at places along one axis that each lane names for itself."""
    array, *_ = args
    numbers, (shape, places, updates) = operation.params["dimension_numbers"], (aval.shape for aval in operation.avals)
    along, mode = numbers.inserted_window_dims, operation.params["mode"]
    if len(along) != 1 or numbers.scatter_dims_to_operand_dims != along or mode == GatherScatterMode.CLIP:
        raise NotFollowed("scatter of another form")
    (axis,) = along
    slices = tuple(updates[place] for place in numbers.update_window_dims)
    if len(places) > 2 or slices != shape[:axis] + shape[axis + 1 :]:
        raise NotFollowed("scatter of parts of slices")
    index, new = (whole(arg, aval, lanes) for arg, aval in zip(args[1:], operation.avals[1:], strict=True))
    if index.ndim == 2:  # one slice
        index, new = index[None], new[None]
    else:
        (over,) = set(range(new.ndim - 1)) - set(numbers.update_window_dims)
        new = jnp.moveaxis(new, over, 0)
    if isinstance(array, Spread) and array.first:
        return [Spread(rows.put(array.array, index[:, 0], jnp.moveaxis(new, -1, 0), axis), first=True)]
    return [Spread(rows.put_last(whole(array, operation.avals[0], lanes), index[:, 0], new, axis))]


_RULES: dict[str, _Rule] = {
    "broadcast_in_dim": _moved(_broadcast),
    "concatenate": _joined(lambda arrays, params: lax.concatenate(arrays, params["dimension"])),
    "dynamic_slice": _row,
    "gather": _picked,
    "reshape": _moved(lambda array, params, lanes: array.reshape(*params["new_sizes"], lanes)),
    "scan": _scan,
    "scatter": _written,
    "slice": _moved(_sliced),
    "squeeze": _moved(lambda array, params, lanes: lax.squeeze(array, params["dimensions"])),
    "stack": _joined(lambda arrays, params: jnp.stack(arrays, params["axis"])),
    "transpose": _moved(lambda array, params, lanes: lax.transpose(array, (*params["permutation"], array.ndim - 1))),
    "while": _while,
} | dict.fromkeys(_COMBINE, _reduced)
