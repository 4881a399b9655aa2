"""Functions rewritten as scalar arithmetic compute what they computed before, with less."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax.envs import arms
from icac_jax.envs.physics import step_function
from icac_jax.fast import scalars


def example(joints, speeds):
    """A bit of everything that a physics step does: rotations, gathers, scatters, products, a linear system."""
    turn = jnp.eye(3).at[0, 0].set(jnp.cos(joints[0])).at[0, 1].set(-jnp.sin(joints[0]))
    moved = jax.vmap(lambda row: turn @ row)(jnp.outer(jnp.arange(4.0), speeds))
    picked = moved[np.array([3, 1, 1])]
    matrix = picked @ picked.T + jnp.eye(3) * (1.0 + joints**2)
    factor, _ = jax.scipy.linalg.cho_factor(matrix)
    solved = jax.scipy.linalg.cho_solve((factor, False), joints)
    kept = jnp.where(joints > 0, solved, jnp.maximum(joints, -0.5))
    return kept, jnp.zeros(4).at[np.array([2, 0, 1])].add(kept * jnp.array([1.0, 0.0, -2.0]))


def test_results_are_those_of_the_function():
    rewritten = jax.jit(jax.vmap(scalars.unrolled(example, (3,), (3,))))
    inputs = jax.random.normal(jax.random.key(0), (2, 50, 3))
    got, wanted = rewritten(*inputs), jax.vmap(example)(*inputs)
    for mine, theirs in zip(got, wanted, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=2e-4, atol=2e-5)


def test_constants_cost_nothing():
    """y = (0 x0 + 1 x1 + x1) / 1: one addition is left."""
    function = scalars.unrolled(lambda x: (jnp.array([[0.0, 1.0]]) @ x + x[1]) / 1.0, (2,))
    names = [equation.primitive.name for equation in jax.make_jaxpr(function)(jnp.zeros(2)).eqns]
    assert [name for name in names if name in ("add", "mul", "div", "dot_general")] == ["add"]


def test_what_cannot_be_followed_is_named():
    with pytest.raises(NotImplementedError, match="sort"):
        scalars.unrolled(jnp.sort, (3,))
    with pytest.raises(NotImplementedError, match="gather"):
        scalars.unrolled(lambda x: jnp.arange(3.0)[x.astype(int)], (3,))


def test_a_physics_step_stays_small():
    """Operations a physics step comes to; a new version of MJX that needs many more should be noticed."""
    for arm, most in ((arms.PLANAR2, 240), (arms.NICO4, 1800)):
        zeros = jnp.zeros(arm.joints)
        assert len(jax.make_jaxpr(step_function(arm))(zeros, zeros, zeros).eqns) <= most
