"""A change that only some lanes need: nobody computes it in a step in which no lane does.

`jax.vmap` turns `jax.lax.cond` into "compute both and select". Lanes that were begun together wait out their warm-up
and delay their policies in the same steps, so that asking all of them first spares the work.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

_State = TypeVar("_State")


def when(wanted: jax.Array, change: Callable[..., _State], state: _State, *args: Any) -> _State:
    """`change(state, *args)` where it is wanted, `state` elsewhere.

    Args:
      wanted: [] bool.
      change: gives a state of the same structure, shapes and types. It must not close over traced values: what it needs
        is among `args`.
      state: any tree of arrays.
      *args: handed on.
    """
    # As flat lists: a record of numbers refuses the flags that JAX puts in their place to say what is batched.
    leaves, tree = jax.tree.flatten(state)
    more, tree_of_more = jax.tree.flatten(args)

    def changed(leaves: list[jax.Array], more: list[jax.Array]) -> list[jax.Array]:
        new = change(jax.tree.unflatten(tree, leaves), *jax.tree.unflatten(tree_of_more, more))
        return jax.tree.leaves(new)

    @custom_vmap
    def one(wanted: jax.Array, leaves: list[jax.Array], more: list[jax.Array]) -> list[jax.Array]:
        return jax.lax.cond(wanted, changed, lambda leaves, more: leaves, leaves, more)

    @one.def_vmap
    def lanes(size: int, batched: Any, wanted: jax.Array, leaves: Any, more: Any) -> tuple[list[jax.Array], list[bool]]:
        axes = [0 if is_batched else None for is_batched in batched[2]]
        wanted, *leaves = (
            leaf if is_batched else jnp.broadcast_to(leaf, (size, *jnp.shape(leaf)))
            for is_batched, leaf in zip([batched[0], *batched[1]], [wanted, *leaves], strict=True)
        )

        def somewhere(leaves: list[jax.Array], more: list[jax.Array]) -> list[jax.Array]:
            new = jax.vmap(changed, in_axes=(0, axes), axis_size=size)(leaves, more)
            return [
                jnp.where(wanted.reshape(size, *(1,) * (a.ndim - 1)), a, b) for a, b in zip(new, leaves, strict=True)
            ]

        new = jax.lax.cond(jnp.any(wanted), somewhere, lambda leaves, more: leaves, leaves, more)
        return new, [True] * len(leaves)

    return jax.tree.unflatten(tree, one(wanted, leaves, more))
