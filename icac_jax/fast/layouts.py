"""How the arrays of all lanes lie while a chunk of steps runs: lanes first, or on a CPU lanes last.

A layout takes the lanes in, steps them, and gives them back; what it holds in between is its own affair.
"""

from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from icac_jax.fast.flat import by_rows, flat, is_key
from icac_jax.fast.lanes_last import NotFollowed, Spread, follow, whole

# Of one lane: (lane, numbers) -> (lane, record), where `record.done` says whether an episode ended.
Step = Callable[[Any, Any], tuple[Any, Any]]
# Of one lane: (lane, numbers, done [] bool) -> the fields of the lane in which the next episode begins where `done`.
Begin = Callable[[Any, Any, jax.Array], dict[str, Any]]


class Layout(Protocol):
    """Lanes in some layout.

    Attributes:
      record: shapes and types of what a step records; leaves are [L].
    """

    record: Any

    def enter(self, lanes: Any) -> Any:
        """Lanes, leaves [L, ...], as they are carried from step to step."""

    def step(self, carried: Any) -> tuple[Any, Any]:
        """One step of all lanes, and its record; episodes that ended have begun anew."""
        ...

    def leave(self, carried: Any) -> Any:
        """The lanes, leaves [L, ...]."""


class LanesFirst:
    """As `jax.vmap` has it; arguments as for `LanesLast`."""

    def __init__(self, step: Step, begin: Begin, lanes: Any, numbers: Any) -> None:
        # As functions of their own they are traced once, for their shapes and for the loop: most of a second.
        self._step = jax.jit(jax.vmap(step), inline=True)
        self._begin, self._numbers = jax.jit(jax.vmap(begin), inline=True), numbers
        self.record = jax.eval_shape(lambda: self._step(lanes, numbers)[1])

    def enter(self, lanes: Any) -> Any:
        """The lanes as they are."""
        return lanes

    def step(self, carried: Any) -> tuple[Any, Any]:
        """One step of all lanes, and its record."""
        lanes, record = self._step(carried, self._numbers)
        old = {name: getattr(lanes, name) for name in jax.eval_shape(self._begun, lanes, record.done)}
        # Nothing is drawn in a step in which no episode ends, hence for all lanes together.
        new = jax.lax.cond(jnp.any(record.done), lambda: self._begun(lanes, record.done), lambda: old)
        return lanes.replace(**new), record

    def _begun(self, lanes: Any, done: jax.Array) -> dict[str, Any]:
        return self._begin(lanes, self._numbers, done)

    def leave(self, carried: Any) -> Any:
        """The lanes as they are."""
        return carried


class LanesLast:
    """Lanes as the last axis, as `lanes_last` has it; what a lane reads and writes by rows stays lanes first.

    Args:
      step: of one lane.
      begin: of one lane.
      lanes: a tree with methods of flax's `PyTreeNode`; leaves [L, ...].
      numbers: a tree; leaves [L, ...].
    """

    def __init__(self, step: Step, begin: Begin, lanes: Any, numbers: Any) -> None:
        one, few = jax.tree.map(_of_one, (lanes, numbers))
        closed, (_, record) = jax.make_jaxpr(step, return_shape=True)(one, few)
        self._step = flat(closed)
        closed, self._begins = jax.make_jaxpr(begin, return_shape=True)(one, few, jax.ShapeDtypeStruct((), bool))
        self._begin = flat(closed)

        leaves, self._tree = jax.tree.flatten(lanes)
        number = len(leaves)
        self._avals = self._step.avals[:number]
        self._by_rows = by_rows(self._step)[:number]
        self._generators = [jax.random.key_impl(leaf) if is_key(leaf) else None for leaf in leaves]
        # What is never changed is not carried.
        untouched = jax.tree.map(lambda _: False, lanes)
        begun = jax.tree.leaves(untouched.replace(**jax.tree.map(lambda _: True, self._begins)))
        changed = [
            anew or before != after
            for anew, before, after in zip(begun, self._step.inputs[:number], self._step.outputs[:number], strict=True)
        ]
        self._fixed = [
            None if change else _inside(leaf, rows)
            for leaf, rows, change in zip(leaves, self._by_rows, changed, strict=True)
        ]
        self._numbers = [Spread(_inside(leaf)) for leaf in jax.tree.leaves(numbers)]
        self._lanes = jax.tree.leaves(numbers)[0].shape[0]
        self.record = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((self._lanes,), leaf.dtype), record)

    def _all(self, carried: list[jax.Array]) -> list[jax.Array]:
        changing = iter(carried)
        return [next(changing) if leaf is None else leaf for leaf in self._fixed]

    def enter(self, lanes: Any) -> list[jax.Array]:
        """The arrays of lanes that steps change, as they lie here."""
        leaves = zip(jax.tree.leaves(lanes), self._by_rows, self._fixed, strict=True)
        return [_inside(leaf, rows) for leaf, rows, fixed in leaves if fixed is None]

    def step(self, carried: list[jax.Array]) -> tuple[list[jax.Array], Any]:
        """One step of all lanes, and its record."""
        args = [Spread(leaf, rows) for leaf, rows in zip(self._all(carried), self._by_rows, strict=True)]
        results = follow(self._step, [*args, *self._numbers], self._lanes)
        number = len(args)
        leaves = [self._held(*each) for each in zip(results[:number], self._avals, self._by_rows, strict=True)]
        avals, tree = jax.tree.flatten(self.record)
        columns = [whole(value, aval, self._lanes, ()) for value, aval in zip(results[number:], avals, strict=True)]
        record = jax.tree.unflatten(tree, columns)
        leaves = jax.tree.leaves(self._begun(leaves, record.done))
        return [leaf for leaf, fixed in zip(leaves, self._fixed, strict=True) if fixed is None], record

    def _held(self, value: Any, aval: Any, rows: bool = False) -> jax.Array:
        """A result as it is carried."""
        if is_key(aval) and not isinstance(value, Spread):
            raise NotFollowed("a key that all lanes share")
        if is_key(aval) or (rows and isinstance(value, Spread) and value.first):
            return value.array
        array = whole(value, aval, self._lanes)
        return jnp.moveaxis(array, -1, 0) if rows else array

    def _begun(self, leaves: list[jax.Array], done: jax.Array) -> Any:
        """The lanes, as a tree, in which the next episode has begun where one ended."""
        lanes = jax.tree.unflatten(self._tree, leaves)
        old = {name: getattr(lanes, name) for name in self._begins}

        def new() -> dict[str, Any]:
            args = [Spread(leaf, rows) for leaf, rows in zip(leaves, self._by_rows, strict=True)]
            results = follow(self._begin, [*args, *self._numbers, Spread(done)], self._lanes)
            begun, tree = jax.tree.flatten(self._begins)
            arrays = [self._held(value, aval) for value, aval in zip(results, begun, strict=True)]
            return jax.tree.unflatten(tree, arrays)

        return lanes.replace(**jax.lax.cond(jnp.any(done), new, lambda: old))

    def leave(self, carried: list[jax.Array]) -> Any:
        """The lanes with all of their arrays, lanes first."""
        leaves = zip(self._all(carried), self._by_rows, self._generators, strict=True)
        return jax.tree.unflatten(self._tree, [_outside(*leaf) for leaf in leaves])


def _of_one(leaf: jax.Array) -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype)


def _inside(leaf: jax.Array, rows: bool = False) -> jax.Array:
    """An array as it lies within: a key as its words, lanes last but for what is used by rows."""
    leaf = jax.random.key_data(leaf) if is_key(leaf) else leaf
    return leaf if rows else jnp.moveaxis(leaf, 0, -1)


def _outside(array: jax.Array, rows: bool, generator: Any) -> jax.Array:
    """An array with lanes first; words are the key of a generator where there is one."""
    array = array if rows else jnp.moveaxis(array, -1, 0)
    return array if generator is None else jax.random.wrap_key_data(array, impl=generator)
