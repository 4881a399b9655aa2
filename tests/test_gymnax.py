"""The gymnax environment: the interface as gymnax has it, and the task as it is."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnax.environments import spaces

from icac_jax.envs import arms, gymnax, reach
from icac_jax.fields import ConfigError
from icac_jax.settings.options import resolve


@pytest.mark.parametrize("arm", arms.ARMS)
def test_the_task_is_that_of_preset_paper(arm):
    env, params = gymnax.make(arm)
    wanted = resolve(arm=arm, preset="paper").params.traced()
    assert jax.tree.all(jax.tree.map(np.array_equal, vars(params), vars(wanted)))
    assert env.name == f"{arm.capitalize()}Reach-v0"


@pytest.mark.parametrize("arm", arms.ARMS)
def test_spaces(arm):
    env, params = gymnax.make(arm, "kinematic", reset_range=1.0)
    spec = arms.get(arm)
    for space, size in (
        (env.action_space(params), spec.joints),
        (env.observation_space(params), spec.observation_size),
    ):
        assert isinstance(space, spaces.Box)
        assert space.shape == space.sample(jax.random.key(0)).shape == (size,)
    assert env.num_actions == spec.joints
    observations = jax.vmap(lambda key: env.reset(key, params)[0])(jax.random.split(jax.random.key(0), 500))
    assert np.all(jax.vmap(env.observation_space(params).contains)(observations))


def test_episodes_are_those_of_the_world_and_begin_again_by_themselves():
    """A scan of steps against the world stepped by hand: until an episode ends, then from a new start and goal."""
    env, params = gymnax.make("planar2", "kinematic", horizon=7, goal_radius=1.0)
    world = reach.make(arms.PLANAR2, "kinematic")
    actions = jax.random.uniform(jax.random.key(1), (60, 2), minval=-1.5, maxval=1.5)
    observation, state = env.reset(jax.random.key(0), params)
    np.testing.assert_array_equal(observation, world.init(jax.random.key(0), params)[1])

    def body(carry, inputs):
        key, action = inputs
        observation, after, reward, done, info = env.step(key, carry, action, params)
        return after, (carry, observation, after, reward, done, info)

    keys = jax.random.split(jax.random.key(2), 60)
    _, (before, observations, after, rewards, dones, info) = jax.jit(lambda *x: jax.lax.scan(body, *x))(
        state, (keys, actions)
    )
    wanted_state, wanted = jax.jit(jax.vmap(world.step, (0, 0, None)))(before, jnp.clip(actions, -1, 1), params)
    np.testing.assert_allclose(rewards, wanted.reward)
    np.testing.assert_array_equal(dones, wanted.terminated | wanted.truncated)
    np.testing.assert_array_equal(info["terminated"], wanted.terminated)
    np.testing.assert_array_equal(info["truncated"], wanted.truncated)
    np.testing.assert_array_equal(info["discount"], 1.0 - dones)
    np.testing.assert_allclose(info["final_observation"], wanted.observation, atol=1e-6)
    assert min(wanted.terminated.sum(), wanted.truncated.sum()) >= 2
    np.testing.assert_array_equal(after.time, np.where(dones, 0, wanted_state.steps))
    np.testing.assert_allclose(observations[~dones], wanted.observation[~dones], atol=1e-6)
    begun = observations[dones]
    assert len(np.unique(begun, axis=0)) == len(begun)
    assert not np.any(np.isclose(begun, wanted.observation[dones]))
    again = jax.jit(jax.vmap(env.get_obs, (0, None)))(after, params)
    np.testing.assert_allclose(again, observations, atol=1e-6)


def test_is_terminal_and_discount_agree_with_the_steps():
    env, params = gymnax.make("planar2", "kinematic")
    _, state = env.reset(jax.random.key(0), params)
    there = state.replace(goal=env._tip(state.joints))
    late = state.replace(steps=jnp.array(50))
    ends = jax.jit(lambda state: (env.is_terminal(state, params), env.is_truncated(state, params)))
    assert [ends(state), ends(there), ends(late)] == [(False, False), (True, False), (True, True)]
    assert ends(there.replace(steps=jnp.array(50))) == (True, False)
    assert env.discount(there, params) == 0.0


def test_params_are_traced_and_have_a_default():
    env, params = gymnax.make("planar2", "kinematic")
    assert params.max_steps_in_episode == 50
    lanes = jax.vmap(lambda horizon: params.replace(horizon=horizon))(jnp.array([1, 2]))
    _, state = env.reset(jax.random.key(0))
    states = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), state)
    far = states.replace(goal=states.goal + 10.0)
    keys = jax.random.split(jax.random.key(1), 2)
    assert jax.vmap(env.step)(keys, far, jnp.zeros((2, 2)), lanes)[3].tolist() == [True, False]
    assert env.step(keys[0], state, jnp.zeros(2))[0].shape == (4,)
    low = env.reset(jax.random.key(0), params.replace(joint_low=(-10, 0), joint_high=(10, 20)))[1].joints
    assert np.all(np.abs(np.degrees(low) - [0, 10]) <= 10)


def test_wrong_options_are_named():
    for options, message in (
        ({"arm": "puma"}, "arm: must be one of planar2, nico4"),
        ({"physics": "warp"}, "physics: must be one of servo, kinematic"),
        ({"goal_radius": 0.0}, "goal_radius: must be"),
        ({"radius": 0.1}, "radius: no such number of the task"),
    ):
        with pytest.raises(ConfigError, match=f"^{message}"):
            gymnax.make(**options)


def test_an_arm_of_ones_own():
    folder = Path(__file__).resolve().parents[1] / "examples" / "own_arm"
    env, params = gymnax.make(str(folder / "arm.toml"), physics="kinematic")
    assert (env.arm.tip, env.num_actions, int(params.horizon)) == ("fingertip", 7, 40)
    seen, state = env.reset(jax.random.key(0), params)
    assert seen.shape == (10,)
    assert env.step(jax.random.key(1), state, jnp.zeros(7), params)[0].shape == (10,)
    assert gymnax.make(folder / "arm7.xml")[0].arm.tip == "fingertip"
