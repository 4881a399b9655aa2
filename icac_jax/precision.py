"""The package computes in float32 and int32 by JAX's usual rules, whatever the user has told JAX for other programs."""

import contextlib
import contextvars
import functools
from collections.abc import Callable, Iterator
from typing import Any, ParamSpec, TypeVar

import jax
import jax.numpy as jnp

_Args = ParamSpec("_Args")
_Result = TypeVar("_Result")
_NARROW = {"float64": jnp.float32, "int64": jnp.int32, "uint64": jnp.uint32}

_narrowing = contextvars.ContextVar("narrowing", default=True)


@contextlib.contextmanager
def as_given() -> Iterator[None]:
    """Within, float64 stays float64 where `jax_enable_x64` allows it: to compare with another implementation."""
    token = _narrowing.set(False)
    try:
        yield
    finally:
        _narrowing.reset(token)


def floating() -> Any:
    """The type of numbers: float32, or within `as_given` JAX's own."""
    return jnp.float32 if _narrowing.get() else jnp.result_type(float)


@contextlib.contextmanager
def _usual() -> Iterator[None]:
    with (
        jax.enable_x64(False if _narrowing.get() else jax.config.values["jax_enable_x64"]),
        jax.numpy_dtype_promotion("standard"),
        jax.numpy_rank_promotion("allow"),
    ):
        yield


def _narrow(leaf: Any) -> Any:
    kind = _NARROW.get(str(getattr(leaf, "dtype", "")))
    return leaf if kind is None else leaf.astype(kind)


def usual(function: Callable[_Args, _Result]) -> Callable[_Args, _Result]:
    """A function that computes the same under any `jax_enable_x64` and any rule of promotion; a decorator.

    The settings are those of the block in which the function is called or traced, so that nothing else sees them.

    Args:
      function: of arrays, trees of arrays and static values.
    """

    @functools.wraps(function)
    def narrow(*args: _Args.args, **options: _Args.kwargs) -> _Result:
        if jax.config.values["jax_enable_x64"] and _narrowing.get():
            args, options = jax.tree.map(_narrow, (args, options))
        with _usual():
            return function(*args, **options)

    return narrow
