"""The brax environment, by brax's protocol: reset and step as its wrappers and agents call them. brax is not needed."""

import abc
import sys
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax.envs import arms, brax, reach
from icac_jax.fields import ConfigError


@pytest.fixture(scope="module")
def env():
    return brax.Reach("planar2", "kinematic", goal_radius=1.0)


@pytest.fixture(scope="module")
def episodes(env):
    """States of five environments over 60 steps, [steps, 5]: before each step, and after it."""

    def body(state, action):
        after = jax.vmap(env.step)(state, action)
        return after, (state, after)

    def run(keys, actions):
        start = jax.vmap(env.reset)(keys)
        # What brax's wrappers do: entries of their own in `info` and `metrics` that a step must hand on.
        start.info["steps"] = jnp.arange(5.0)
        start.metrics["reward"] = start.reward
        return jax.lax.scan(body, start, actions)[1]

    actions = jax.random.uniform(jax.random.key(1), (60, 5, 2), minval=-1.5, maxval=1.5)
    return actions, *jax.jit(run)(jax.random.split(jax.random.PRNGKey(0), 5), actions)


def test_brax_is_not_loaded_and_its_names_are_there(env):
    assert "brax" not in sys.modules
    assert (env.observation_size, env.action_size, env.episode_length, env.backend) == (4, 2, 50, "mjx")
    assert env.unwrapped is env
    state = jax.eval_shape(env.reset, jax.random.PRNGKey(0))
    assert set(vars(state)) == {"pipeline_state", "obs", "reward", "done", "metrics", "info"}
    assert (state.obs.shape, state.reward.shape, state.done.shape) == ((4,), (), ())
    assert state.done.dtype == state.reward.dtype == jnp.float32


def test_where_brax_is_installed_it_is_one_of_its_environments(monkeypatch):
    """SAC of brax refuses anything else; PPO does not ask."""
    base = types.ModuleType("brax.envs.base")
    base.Env = abc.ABCMeta("Env", (), {"reset": abc.abstractmethod(lambda self: None)})
    for name, module in (
        ("brax", types.ModuleType("brax")),
        ("brax.envs", types.ModuleType("brax.envs")),
        (base.__name__, base),
    ):
        monkeypatch.setitem(sys.modules, name, module)
    assert isinstance(brax.Reach("planar2", "kinematic"), base.Env)


def test_a_step_keeps_the_structure_of_the_state(env):
    """Else no scan over steps can be compiled."""
    state = jax.eval_shape(env.reset, jax.random.key(0))
    after = jax.eval_shape(env.step, state, jax.ShapeDtypeStruct((2,), jnp.float32))
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), after) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), state
    )


def test_steps_are_those_of_the_world(env, episodes):
    actions, before, after = episodes
    world = reach.make(arms.PLANAR2, "kinematic")
    step = jax.jit(jax.vmap(jax.vmap(world.step, (0, 0, None)), (0, 0, None)))
    arm, seen = step(before.pipeline_state, jnp.clip(actions, -1, 1), env.params.traced())
    jax.tree.map(lambda one, other: np.testing.assert_allclose(one, other, atol=1e-6), after.pipeline_state, arm)
    np.testing.assert_allclose(after.obs, seen.observation, atol=1e-6)
    np.testing.assert_array_equal(after.reward, seen.reward)
    np.testing.assert_array_equal(after.done, seen.terminated)  # never time: that is counted by brax
    np.testing.assert_array_equal(after.metrics["reached"], seen.terminated)
    assert seen.truncated.any()
    assert 0 < seen.terminated.mean() < 1


def test_what_wrappers_add_is_handed_on(episodes):
    _, _, after = episodes
    np.testing.assert_array_equal(after.info["steps"], np.tile(np.arange(5.0), (60, 1)))
    assert set(after.metrics) == {"reached", "reward"}


def test_both_kinds_of_keys_give_starts_of_their_own(env):
    reset = jax.jit(jax.vmap(env.reset))
    both = [reset(jax.random.split(kind(0), 5)).obs for kind in (jax.random.key, jax.random.PRNGKey)]
    np.testing.assert_array_equal(*both)
    assert len(np.unique(both[0], axis=0)) == 5


def test_wrong_options_are_named():
    for options, message in (
        ({"arm": "puma"}, "arm: must be one of planar2, nico4"),
        ({"physics": "warp"}, "physics: must be one of servo, kinematic"),
        ({"radius": 0.1}, "radius: no such number of the task"),
    ):
        with pytest.raises(ConfigError, match=f"^{message}"):
            brax.Reach(**options)
    assert brax.Reach("planar2", "kinematic", horizon=70).episode_length == 70
