"""Curiosity around Gymnasium worlds: the same rewards as in a lane, nothing changed in the world itself."""

import gymnasium
import jax
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from icac_jax.curiosity import CuriosityHyper, CuriositySpec, intrinsic
from icac_jax.fields import ConfigError
from icac_jax.gymnasium_curiosity import Curiosity

SIZES = {"map_capacity": 16}


def make(name="Planar2Reach-v0"):
    return gymnasium.make(f"icac_jax.envs.gymnasium:icac_jax/{name}", physics="kinematic")


@pytest.fixture(scope="module")
def curious():
    return Curiosity(make(), state_size=2, curiosity=0.5, e_max=0.4, **SIZES)


def test_rewards_are_those_of_the_functions(curious):
    """Steps by hand through `curiosity.intrinsic`, started from the wrapper's own state."""
    spec = CuriositySpec(observation_size=4, state_size=2, action_size=2, **SIZES)
    hyper = CuriosityHyper(e_max=0.4).traced()
    observation, _ = curious.reset(seed=3)
    state, plain = curious.state, make()
    plain.reset(seed=3)
    rng = np.random.default_rng(0)
    update = jax.jit(lambda *seen: intrinsic.update(spec, *seen, hyper))
    for _ in range(25):
        action = rng.uniform(-1, 1, 2).astype(np.float32)
        following, reward, terminated, truncated, info = curious.step(action)
        state, wanted = update(state, observation[:2], action, following[:2])
        np.testing.assert_allclose(info["intrinsic_reward"], 0.5 * wanted.reward, rtol=1e-4)
        there, extrinsic, *_ = plain.step(action)
        np.testing.assert_array_equal(there, following)
        assert reward == pytest.approx(extrinsic + info["intrinsic_reward"])
        assert info["extrinsic_reward"] == extrinsic
        observation = following
        if terminated or truncated:
            break
    assert int(curious.state.step) > 5
    assert info["live_nodes"] >= 2


def test_what_was_learnt_outlives_an_episode(curious):
    before = int(curious.state.step)
    curious.reset(seed=4)
    curious.step(np.zeros(2, np.float32))
    assert int(curious.state.step) == before + 1


def test_a_world_of_goals_maps_its_observation_alone():
    world = Curiosity(make("Planar2ReachGoal-v0"), **SIZES)
    observation, _ = world.reset(seed=0)
    assert set(observation) == {"observation", "achieved_goal", "desired_goal"}
    *_, info = world.step(world.action_space.sample())
    assert np.isfinite(info["intrinsic_reward"])


@pytest.mark.filterwarnings("ignore")  # the checker's advice about wrappers and spaces
def test_gymnasium_s_own_checker_accepts_it():
    # Its reward is never the same twice, which the checker would take for a world without a seed.
    check_env(Curiosity(gymnasium.make("Pendulum-v1"), curiosity=0.0, **SIZES), skip_render_check=True)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"emax": 1.0}, "emax: no option of curiosity; did you mean e_max"),
        ({"e_max": -1.0}, "e_max: must be a number greater than 0"),
        ({"state_size": 9}, "state_size: must be at most"),
        ({"mu": 10}, "T: must be at most mu"),
    ],
)
def test_wrong_options_are_refused_in_a_line(options, words):
    with pytest.raises(ConfigError, match=words):
        Curiosity(make(), **options)


def test_discrete_actions_are_refused():
    with pytest.raises(ConfigError, match="env: must have boxes"):
        Curiosity(gymnasium.make("CartPole-v1"))
