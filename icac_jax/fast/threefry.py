"""The few draws a step needs, to the bit those of `jax.random`, as arithmetic that XLA fuses.

On a CPU `jax.random` runs the generator (Threefry-2x32, 20 rounds) as a loop of small operations to compile faster;
starting them costs more than a whole step of the learner. Written out, the rounds are one fused loop. Keys of another
generator are handed to `jax.random`.
"""

import math

import jax
import jax.numpy as jnp

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def _written_out(key: jax.Array) -> bool:
    return str(jax.random.key_impl(key)) == "threefry2x32" and jax.config.values["jax_threefry_partitionable"]


def _threefry(key: jax.Array, first: jax.Array, second: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The hash of two words (Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3").

    Args:
      key: a key, [].
      first: uint32.
      second: uint32 of the same shape.

    Returns:
      Two arrays like `second`.
    """
    data = jax.random.key_data(key)
    words = (data[0], data[1], data[0] ^ data[1] ^ jnp.uint32(0x1BD11BDA))
    first, second = first + words[0], second + words[1]
    for group in range(5):
        for rotation in _ROTATIONS[group % 2]:
            first = first + second
            second = (second << jnp.uint32(rotation)) | (second >> jnp.uint32(32 - rotation))
            second = second ^ first
        first = first + words[(group + 1) % 3]
        second = second + words[(group + 2) % 3] + jnp.uint32(group + 1)
    return first, second


def fold_in(key: jax.Array, data: jax.Array) -> jax.Array:
    """`jax.random.fold_in`: a key [] made of a key [] and an integer []."""
    if not _written_out(key):
        return jax.random.fold_in(key, data)
    data = jnp.asarray(data).astype(jnp.uint32)
    return jax.random.wrap_key_data(jnp.stack(_threefry(key, jnp.zeros_like(data), data)), impl="threefry2x32")


def pair(key: jax.Array) -> tuple[jax.Array, jax.Array]:
    """`jax.random.split`: two keys [] made of a key []."""
    if not _written_out(key):
        first, second = jax.random.split(key)
        return first, second
    return fold_in(key, jnp.array(0)), fold_in(key, jnp.array(1))


def below(key: jax.Array, end: jax.Array) -> jax.Array:
    """`jax.random.randint` from 0: a whole number [] int32 below `end` [], which is at least 1."""
    if not _written_out(key):
        return jax.random.randint(key, (), 0, end)
    zero, span = jnp.zeros((), jnp.uint32), jnp.asarray(end).astype(jnp.uint32)
    high, low = (jnp.bitwise_xor(*_threefry(half, zero, zero)) for half in pair(key))
    # Of the 64 bits high x 2^32 + low what a division by `end` leaves.
    factor = jnp.uint32(2**16) % span
    return ((high % span * (factor * factor % span) + low % span) % span).astype(jnp.int32)


def uniform(key: jax.Array, shape: tuple[int, ...], low: float = 0.0, high: float = 1.0) -> jax.Array:
    """`jax.random.uniform` in float32: numbers in [low, high) of the given shape."""
    if not _written_out(key):
        return jax.random.uniform(key, shape, jnp.float32, low, high)
    count = jnp.arange(math.prod(shape), dtype=jnp.uint32)
    first, second = _threefry(key, jnp.zeros_like(count), count)
    mantissa = (first ^ second) >> jnp.uint32(9) | jnp.uint32(0x3F800000)  # of a float in [1, 2)
    unit = jax.lax.bitcast_convert_type(mantissa, jnp.float32) - 1.0
    least, most = jnp.float32(low), jnp.float32(high)
    return jnp.maximum(least, unit * (most - least) + least).reshape(shape)


def normal(key: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """`jax.random.normal` in float32: standard normal numbers of the given shape."""
    if not _written_out(key):
        return jax.random.normal(key, shape, jnp.float32)
    above_minus_one = -1.0 + 2.0**-24  # the next float32
    return jnp.float32(2.0**0.5) * jax.lax.erf_inv(uniform(key, shape, above_minus_one, 1.0))
