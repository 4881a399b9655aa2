"""Whatever a step does with its arrays is done for all lanes as `jax.vmap` does it, or not followed at all."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from icac_jax.fast.flat import by_rows, flat
from icac_jax.fast.lanes_last import NotFollowed, Spread, follow

LANES, ROWS, SIZE = 5, 6, 3
# Of an array [ROWS, SIZE], a place [] int32 from 0 to ROWS - 1, and a slice [SIZE].
FOLLOWED = {
    "a row": lambda array, place, new: array[place],
    "a row beyond the end": lambda array, place, new: array[place + 100],
    "a row counted from the end": lambda array, place, new: array[place - ROWS],
    "a row that all share": lambda array, place, new: array[2] + new,
    "a row of what is computed": lambda array, place, new: (2 * array)[place],
    "a row of a table": lambda array, place, new: jnp.arange(ROWS * 2.0).reshape(ROWS, 2)[place] + new[0],
    "an entry of a vector": lambda array, place, new: array[:, 0][place],
    "a row written": lambda array, place, new: array.at[place].set(new),
    "a row written and read": lambda array, place, new: array.at[place].set(new)[place] + array[place],
    "beyond the end nothing is written": lambda array, place, new: array.at[place + 3].set(new, mode="drop"),
    "nor before the beginning": lambda array, place, new: array.at[place - 2 * ROWS].set(new, mode="drop"),
    "two rows written": lambda array, place, new: array.at[jnp.stack([place, place + 1])].set(jnp.stack([new, -new])),
    "two columns written": lambda array, place, new: array.at[:, jnp.stack([place, place + 1])].set(
        jnp.stack([array[:, 0], array[:, 1]], 1), mode="drop"
    ),
    "a column written": lambda array, place, new: array.at[:, place].set(jnp.arange(float(ROWS)), mode="drop"),
    "an entry of a vector written": lambda array, place, new: new.at[place].set(place, mode="drop"),
    "sums": lambda array, place, new: (array.sum(), array.sum(0), array.sum(1), array.max(1), array.min()),
    "whole numbers": lambda array, place, new: (
        jnp.bitwise_or.reduce(jnp.stack([place, 8 * place])),
        (place * jnp.arange(3)).sum(),
        (array > place).any(0),
        (array > place).all(),
    ),
    "entry by entry": lambda array, place, new: jnp.where(array > 0, jnp.tanh(array), new * place) ** 2 % 0.7,
    "moves": lambda array, place, new: jnp.concatenate([array.T.reshape(-1)[3:9], new[::2], new])[None],
    "a loop until each has enough": lambda array, place, new: lax.while_loop(
        lambda c: c[0] < place, lambda c: (c[0] + 1, c[1] * new), (0, array)
    ),
    "a loop of so many rounds": lambda array, place, new: lax.fori_loop(
        0, 4, lambda i, c: (c[0] + i * new, c[1] + i), (array, 0)
    ),
    "nothing of the lane": lambda array, place, new: jnp.arange(3.0),
}
# `jax.vmap` does these. Some could be followed; none may be followed wrongly.
OTHERS = {
    "written at the nearest place": lambda array, place, new: array.at[place + 3].set(new, mode="clip"),
    "filled beyond the end": lambda array, place, new: array[:, 0].at[place + 3].get(mode="fill", fill_value=7.0),
    "added": lambda array, place, new: array.at[place].add(new),
    "a part of a row written": lambda array, place, new: array.at[place, :2].set(new[:2]),
    "one entry written": lambda array, place, new: array.at[place, 1].set(new[0]),
    "a column": lambda array, place, new: array[:, jnp.minimum(place, SIZE - 1)],
    "an entry": lambda array, place, new: array[place, jnp.minimum(place, SIZE - 1)],
    "rows": lambda array, place, new: array[jnp.stack([place, place])],
    "two rows side by side": lambda array, place, new: lax.dynamic_slice(array, (place, 0), (2, SIZE)),
    "a sum of nothing": lambda array, place, new: array[:0].sum(0),
    "sorted": lambda array, place, new: jnp.sort(array, axis=0),
    "a product": lambda array, place, new: array @ new,
    "running sums": lambda array, place, new: jnp.cumsum(array, axis=0),
    "bits of another width": lambda array, place, new: lax.bitcast_convert_type(new, jnp.uint8),
    "draws": lambda array, place, new: jax.random.uniform(jax.random.fold_in(jax.random.key(0), place)),
    "one of two keys": lambda array, place, new: jax.random.key_data(
        jnp.where(place > 2, jax.random.key(0), jax.random.key(1))
    ),
    "one branch": lambda array, place, new: lax.cond(place > 2, lambda: array[0], lambda: new),
    "a loop over rows": lambda array, place, new: lax.scan(lambda c, x: (c + x, c), new, array),
}


def both(function):
    """What lanes last and `jax.vmap` give, as lists of arrays [LANES, ...]."""
    rng = np.random.default_rng(0)
    args = (
        rng.normal(size=(LANES, ROWS, SIZE)).astype(np.float32),
        rng.permutation(ROWS)[:LANES].astype(np.int32),
        rng.normal(size=(LANES, SIZE)).astype(np.float32),
    )
    one = flat(jax.make_jaxpr(function)(*(jax.ShapeDtypeStruct(arg.shape[1:], arg.dtype) for arg in args)))
    avals = jax.tree.leaves(jax.eval_shape(function, *(arg[0] for arg in args)))

    def last(*args):
        spread = [
            Spread(arg if rows else jnp.moveaxis(arg, 0, -1), rows)
            for arg, rows in zip(args, by_rows(one), strict=True)
        ]
        return [
            jnp.moveaxis(value.last, -1, 0) if isinstance(value, Spread) else jnp.stack([value] * LANES)
            for value in follow(one, spread, LANES)
        ]

    found = jax.jit(last)(*args)
    assert [leaf.dtype for leaf in found] == [aval.dtype for aval in avals]
    return found, jax.tree.leaves(jax.jit(jax.vmap(function))(*args))


@pytest.mark.parametrize("name", FOLLOWED)
def test_it_is_what_vmap_gives(name):
    for one, other in zip(*both(FOLLOWED[name]), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6)


@pytest.mark.parametrize("name", OTHERS)
def test_it_is_right_or_not_followed(name):
    with pytest.raises(NotFollowed):
        both(OTHERS[name])


def test_rows_lie_side_by_side_where_only_rows_are_used():
    for name, wanted in {"a row": True, "a row written and read": True, "sums": False, "entry by entry": False}.items():
        closed = jax.make_jaxpr(FOLLOWED[name])(jnp.ones((ROWS, SIZE)), jnp.int32(0), jnp.ones(SIZE))
        assert by_rows(flat(closed)) == [wanted, False, False], name
