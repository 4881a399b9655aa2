"""A lattice of nodes: as many per side in each of its dimensions. N = side ** dimensions nodes, numbered in C order."""

import functools

import jax
import jax.numpy as jnp

from icac_jax.fields import ConfigError

# As many nodes as a map of free nodes can have (`CuriositySpec.map_capacity`).
MOST_NODES = 16384


def size(name: str, side: int, dimensions: int) -> int:
    """N of a lattice.

    Args:
      name: of the option that is the side.
      side: nodes per dimension.
      dimensions: how many.

    Raises:
      ConfigError: there would be more than 16,384 nodes.
    """
    if side**dimensions > MOST_NODES:
        most = int(MOST_NODES ** (1 / dimensions) + 1e-9)
        raise ConfigError(f"{name}: must be at most {most} in {dimensions} dimensions, got {side}")
    return side**dimensions


@functools.cache
def places(side: int, dimensions: int) -> tuple[tuple[int, ...], ...]:
    """Which node along each dimension each of the N nodes is."""
    strides = [side**left for left in reversed(range(dimensions))]
    return tuple(tuple(node // stride % side for stride in strides) for node in range(side**dimensions))


def neighbours(side: int, dimensions: int) -> jax.Array:
    """[N, N] bool, nodes next to each other along one dimension."""
    each = jnp.array(places(side, dimensions))
    apart = functools.reduce(jnp.add, (jnp.abs(along[:, None] - along) for along in each.T))
    return apart == 1
