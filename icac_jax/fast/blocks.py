"""Lanes in parts that a core's cache holds, one after the other: each costs less per step than all of them together.

What it bought: 640 lanes of ICAC cost two thirds per step of what they did (docs/performance.md). Blocks of one size
also make a learner's numbers independent of how many learners there are.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp


def in_blocks(chunk: Callable[..., tuple[Any, Any]], blocks: int) -> Callable[..., tuple[Any, Any]]:
    """A chunk of steps whose lanes run in so many equal parts, each for all of the steps; lanes stay in their order.

    Args:
      chunk: (lanes, numbers, ...) -> (lanes, records); leaves of lanes and numbers are [L, ...], of records [steps, L].
      blocks: of which L is a multiple.
    """

    def parted(*args: Any) -> tuple[Any, Any]:
        lanes, *numbers = jax.tree.map(lambda leaf: leaf.reshape(blocks, -1, *leaf.shape[1:]), args)

        def one(lanes: Any, number: jax.Array) -> tuple[Any, Any]:
            ran, log = chunk(*jax.tree.map(lambda leaf: leaf[number], (lanes, *numbers)))
            return jax.tree.map(lambda leaf, new: leaf.at[number].set(new), lanes, ran), log

        lanes, log = jax.lax.scan(one, lanes, jnp.arange(blocks))
        joined = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1).reshape(leaf.shape[1], -1), log)
        return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), lanes), joined

    return parted
