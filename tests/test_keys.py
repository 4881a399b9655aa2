"""The generator written out gives the draws of `jax.random`, to the bit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax.fast import threefry


def bits(key):
    return np.asarray(jax.random.key_data(key))


@pytest.mark.parametrize("impl", ["threefry2x32", "rbg"])
def test_draws_are_those_of_jax_random(impl):
    for seed in range(5):
        key = jax.random.key(seed, impl=impl)
        for data in (0, 1, 2**31 - 1):
            np.testing.assert_array_equal(
                bits(threefry.fold_in(key, jnp.int32(data))), bits(jax.random.fold_in(key, data))
            )
        for mine, wanted in zip(threefry.pair(key), jax.random.split(key), strict=True):
            np.testing.assert_array_equal(bits(mine), bits(wanted))
        for end in (1, 2, 7, 1000, 2**31 - 1):
            assert threefry.below(key, jnp.int32(end)) == jax.random.randint(key, (), 0, end)
        for shape in ((), (5,), (2, 4)):
            wanted = jax.random.uniform(key, shape, minval=-0.5, maxval=0.5)
            np.testing.assert_array_equal(threefry.uniform(key, shape, -0.5, 0.5), wanted)
            np.testing.assert_allclose(threefry.normal(key, shape), jax.random.normal(key, shape), rtol=1e-6)


def test_draws_under_vmap():
    many = jax.random.split(jax.random.key(3), 7)
    got = jax.jit(jax.vmap(lambda key: threefry.uniform(threefry.fold_in(key, 4), (3,), -1.0, 1.0)))(many)
    wanted = jax.vmap(lambda key: jax.random.uniform(jax.random.fold_in(key, 4), (3,), minval=-1.0))(many)
    np.testing.assert_array_equal(got, wanted)
