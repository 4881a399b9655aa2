"""Which nodes of a map are nearest to a stimulus. N is the capacity, D the size of a stimulus."""

import jax
import jax.numpy as jnp

from icac_jax.fast.sums import dots, least


def squares(weights: jax.Array, live: jax.Array, stimulus: jax.Array) -> jax.Array:
    """Squared distances [N] from a stimulus [D] to the nodes at `weights` [N, D]; infinite where not `live` [N]."""
    offset = weights - stimulus
    return jnp.where(live, dots(offset, offset), jnp.inf)


def one(squared: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The slot [] int32 of the least of `squared` [N], the first among equals, and that least value []."""
    slots = jnp.arange(squared.shape[0], dtype=jnp.int32)
    distance = least(squared)
    return least(jnp.where(squared == distance, slots, squared.shape[0])), distance


def two(squared: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The slots [] int32 of the least and the next of `squared` [N], and the least value []."""
    slots = jnp.arange(squared.shape[0], dtype=jnp.int32)
    nearest, distance = one(squared)
    second, _ = one(jnp.where(slots == nearest, jnp.inf, squared))
    return nearest, second, distance
