"""The arms under whatever JAX has been told of numbers: the same float32 as without."""

import subprocess
import sys

import pytest

CODE = """
import sys
import jax
import jax.numpy as jnp
import numpy as np

jax.config.update(sys.argv[1], {"True": True}.get(sys.argv[2], sys.argv[2]))
from icac_jax.envs import arms, reach
from icac_jax.fast import sums

for name, physics in (("planar2", "servo"), ("nico4", "kinematic")):
    arm = arms.get(name)
    world, params = reach.make(arm, physics), reach.default_params(arm).traced()
    state, first = world.init(jax.random.key(0), params)
    state, seen = jax.jit(world.step)(state, jnp.full(arm.joints, 0.5), params)
    relabelled = world.goal.relabel(seen.observation, state.goal)
    for array in (first, seen.observation, state.joints, state.velocity, state.goal, relabelled):
        assert array.dtype == jnp.float32, array.dtype
        print(np.asarray(array).tolist())
    print(bool(world.goal.reached(state.goal, state.goal, params)), float(seen.reward))
print(sums.dots(jnp.ones((3, 2), jnp.float32), jnp.full(2, 2.0, jnp.float32)).tolist())
"""


def said(*setting):
    done = subprocess.run([sys.executable, "-W", "error", "-c", CODE, *setting], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def plain():
    return said("jax_numpy_dtype_promotion", "standard")


@pytest.mark.parametrize(
    "setting",
    [("jax_enable_x64", "True"), ("jax_numpy_dtype_promotion", "strict"), ("jax_numpy_rank_promotion", "raise")],
)
def test_the_arms_are_the_same(setting, plain):
    assert said(*setting) == plain
    assert plain.endswith("[4.0, 4.0, 4.0]\n")
