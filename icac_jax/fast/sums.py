"""Small products, sums and minima written out entry by entry, so that XLA fuses them instead of calling a library."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import lax

# Products with at most so many columns, and sums over at most so many entries, are written out.
_FEW_COLUMNS = 32
_FEW_ENTRIES = 16


def product(matrix: jax.Array, vector: jax.Array) -> jax.Array:
    """A matrix [M, K] times a vector [K], in full precision.

    Few columns are added up one after the other: for each product of small matrices a CPU calls a routine that takes
    longer to enter than to run.
    """
    columns = matrix.shape[1]
    if columns > _FEW_COLUMNS:
        return jnp.matmul(matrix, vector, precision="highest")
    total = matrix[:, 0] * vector[0]
    for column in range(1, columns):
        total = total + matrix[:, column] * vector[column]
    return total


def dots(first: jax.Array, second: jax.Array) -> jax.Array:
    """Scalar products [N] of vectors [N, D] and [N, D] or [D].

    Written out over the few entries of a stimulus. No matrix product: some GPUs round its factors, and signs decide.
    """
    products = first * jnp.broadcast_to(second, first.shape)
    if products.shape[-1] > _FEW_ENTRIES:
        return jnp.sum(products, axis=-1)
    total = products[..., 0]
    for entry in range(1, products.shape[-1]):
        total = total + products[..., entry]
    return total


def least(values: jax.Array) -> jax.Array:
    """The least [] of values [N]; halves are compared entry by entry first, which a CPU does several at a time."""
    while values.shape[0] % 2 == 0 and values.shape[0] > _FEW_ENTRIES:
        half = values.shape[0] // 2
        values = jnp.minimum(values[:half], values[half:])
    return jnp.min(values)


def halved(combine: Callable[[jax.Array, jax.Array], jax.Array], values: jax.Array) -> jax.Array:
    """What combining all values [N, ...] gives, [...]: halves with each other until one is left.

    One after the other each would wait for the one before. Rounding is that of this order.
    """
    while len(values) > 1:
        half = len(values) // 2
        both = combine(lax.slice_in_dim(values, 0, half), lax.slice_in_dim(values, half, 2 * half))
        rest = lax.slice_in_dim(values, 2 * half, len(values))
        values = lax.concatenate([both, rest], 0) if len(rest) else both
    return lax.squeeze(values, [0])
