"""Reading and writing rows of which each lane names its own.

What lies lanes first is read and written by a loop over lanes: XLA's gather and scatter would be kernels of their own,
and copy the array. With lanes last every row is looked at, which for a few hundred entries costs less.
"""

import jax
import jax.numpy as jnp
from jax import lax

from icac_jax.fast.sums import halved


def taken(array: jax.Array, index: jax.Array) -> jax.Array:
    """Row `index[l]` of each lane: [L, N, ...] and [L] int32 to [L, ...]."""
    lanes, rest = array.shape[0], array.shape[2:]
    zeros = (0,) * len(rest)

    def take(lane: jax.Array, rows: jax.Array) -> jax.Array:
        row = lax.dynamic_slice(array, (lane, index[lane], *zeros), (1, 1, *rest))
        return lax.dynamic_update_slice(rows, row[0], (lane, *zeros))

    return lax.fori_loop(0, lanes, take, jnp.zeros((lanes, *rest), array.dtype))


def put(array: jax.Array, index: jax.Array, slices: jax.Array, axis: int) -> jax.Array:
    """The array with slices of each lane written one after the other; those outside of it are left out.

    Args:
      array: [L, ...].
      index: [K, L] int32, where.
      slices: [L, K, ...] of the array's axes without `axis`.
      axis: of a lane's array along which `index` counts.
    """
    size = [1, *array.shape[1:]]
    size[axis + 1] = 1
    zeros = (0,) * (slices.ndim - 2)

    def write(lane: jax.Array, array: jax.Array) -> jax.Array:
        for number in range(len(index)):
            place = index[number, lane]
            start = [lane] + [jnp.int32(0)] * (array.ndim - 1)
            start[axis + 1] = place
            new = lax.dynamic_slice(slices, (lane, number, *zeros), (1, 1, *slices.shape[2:]))[0]
            old = lax.dynamic_slice(array, start, size)
            there = (place >= 0) & (place < array.shape[axis + 1])
            array = lax.dynamic_update_slice(array, jnp.where(there, jnp.expand_dims(new, axis + 1), old), start)
        return array

    return lax.fori_loop(0, array.shape[0], write, array)


def taken_last(array: jax.Array, index: jax.Array) -> jax.Array:
    """Row `index[l]` of each lane: [N, ..., L] and [L] int32 to [..., L], to the bit; the last beyond the end."""
    chosen = jnp.arange(len(array), dtype=index.dtype)[:, None] == jnp.clip(index, 0, len(array) - 1)
    chosen = chosen.reshape(len(array), *(1,) * (array.ndim - 2), -1)
    if array.dtype == bool:
        return halved(jnp.logical_or, chosen & array)
    words = lax.bitcast_convert_type(array, jnp.int32)
    return lax.bitcast_convert_type(halved(jnp.bitwise_or, jnp.where(chosen, words, 0)), array.dtype)


def put_last(array: jax.Array, index: jax.Array, slices: jax.Array, axis: int) -> jax.Array:
    """As `put`, of an array [..., L] and slices [K, ..., L]."""
    places = jnp.arange(array.shape[axis], dtype=index.dtype).reshape(-1, *(1,) * (array.ndim - 1 - axis))
    for place, new in zip(index, slices, strict=True):
        array = jnp.where(places == place, jnp.expand_dims(new, axis), array)
    return array
