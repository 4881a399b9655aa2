"""A lattice of nodes: as many per side in each of its dimensions. N = side ** dimensions nodes, numbered in C order."""

import functools

import numpy as np

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
def places(side: int, dimensions: int) -> np.ndarray:
    """[N, dimensions] which node along each dimension each node is."""
    return np.stack(np.unravel_index(np.arange(side**dimensions), (side,) * dimensions), axis=1)


def neighbours(side: int, dimensions: int) -> np.ndarray:
    """[N, N] bool, nodes next to each other along one dimension."""
    apart = np.zeros((side**dimensions,) * 2, np.int32)
    for along in places(side, dimensions).T:
        apart += np.abs(along[:, None] - along)
    return apart == 1
