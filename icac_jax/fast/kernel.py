"""What XLA's CPU compiler does when an attribute of a call asks for it; elsewhere the attribute changes nothing.

Both attributes are XLA's own and undocumented. A version that no longer knows them gives the same results, slower:
`tests/test_layouts.py` looks at what they bring.
"""

from collections.abc import Callable
from typing import Any, cast

import jax
from jax.experimental.xla_metadata import set_xla_metadata

_held = jax.jit(jax.lax.optimization_barrier)


def one_kernel(function: Callable[..., Any], *args: Any) -> Any:
    """`function(*args)` compiled as a single kernel, loops included: none of its operations is started by itself.

    It may hold no scatter and no product that goes to a library.
    """
    # The attributes stick to the call to which the first of its results belongs; a context in which the function is
    # traced would put them on all calls within it too.
    (first, *rest), tree = jax.tree.flatten(jax.jit(function)(*args))
    first = set_xla_metadata(first, xla_cpu_small_call="true", inlineable="false")
    return jax.tree.unflatten(tree, [first, *rest])


def once(array: jax.Array) -> jax.Array:
    """An array that is computed before what needs it, not again in each of them.

    XLA computes a value anew in every loop into which it is fused, at worst for each of their entries. It takes
    `jax.lax.optimization_barrier` out before that; what a call gives that may not be inlined is kept apart.
    """
    return cast(jax.Array, set_xla_metadata(_held(array), inlineable="false"))
