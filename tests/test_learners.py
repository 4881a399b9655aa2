"""The learners beyond the paper as runs: a preset that names one, curiosity and hindsight as options, resuming."""

import functools
import importlib.util

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

import icac_jax
from icac_jax.agents import registry
from icac_jax.envs import arms, reach
from icac_jax.fields import ConfigError
from icac_jax.policies import saved
from icac_jax.settings.options import resolve
from tests import worlds
from tests.test_tools import ROOT, greedy_actions

SMALL = ["--hidden-units", 8, "--batch-size", 8, "--warm-up", 20, "--buffer-size", 64]
TINY = ["--physics", "kinematic", "--seeds", 2, "--checkpoint-every", 0, *SMALL]


@pytest.mark.parametrize("arm", arms.ARMS)
def test_the_preset_best_names_its_learner(arm):
    best = resolve(arm=arm, preset="best")
    assert (best.algo, best.spec.hindsight) == ("td3", "future")
    assert resolve(**best.flat()) == best
    assert resolve(arm=arm, preset="best", gamma=0.9).hyper.gamma == 0.9
    assert resolve(arm=arm, preset="best", curiosity=0.5).algo == "curious_td3"
    assert icac_jax.preset(arm, name="best") == best
    with pytest.raises(ConfigError, match="algo: must be td3 with the preset best, got 'icac'"):
        resolve(arm=arm, preset="best", algo="icac")


def test_curiosity_is_an_option_of_the_learners_that_it_can_go_around():
    assert resolve(algo="ddpg", curiosity=0.5).algo == "curious_ddpg"
    around = resolve(algo="td3", curiosity=0.5, e_max=0.3)
    assert (around.algo, around.hyper.curiosity, around.hyper.e_max) == ("curious_td3", 0.5, 0.3)
    assert (around.spec.hidden_units, around.spec.predictor_units) == (64, 12)
    assert (resolve(curiosity=2.0).algo, resolve(curiosity=2.0).hyper.curiosity) == ("icac", 2.0)
    with pytest.raises(ConfigError, match="curiosity: no option of cacla, only of icac, curious_ddpg, curious_td3"):
        resolve(algo="cacla", curiosity=1.0)


def having_hindsight():
    return [algo for algo, learner in registry.LEARNERS.items() if hasattr(learner.static(), "hindsight")]


@pytest.mark.parametrize("algo", having_hindsight())
def test_hindsight_needs_goals(algo):
    with pytest.raises(ConfigError, match="hindsight: must be none, the environment has no goals"):
        worlds.learner(algo, worlds.line(), hindsight="future")


def test_hindsight_teaches_cacla_var_to_reach():
    """Without it two fifths of the goals are reached by then; a wrong goal, reward or transition would not help."""
    run = functools.partial(
        icac_jax.train, "planar2", "cacla_var", seeds=5, episodes=1000, physics="kinematic", progress=False
    )
    assert run(hindsight="future").success.mean() > run().success.mean() + 0.3


@pytest.mark.parametrize("algo", ["cacla", "curious_td3"])
def test_a_run_with_hindsight_is_resumed_to_the_bit(icac, tmp_path, algo):
    options = ["--algo", algo, "--hindsight", "future", *(TINY if algo != "cacla" else TINY[:6])]
    icac("train", *options, "--episodes", 6, "--out", "whole", check=0)
    icac("train", *options, "--episodes", 3, "--out", "parts", check=0)
    icac("resume", "parts", "--episodes", 6, check=0)
    whole, parts = (pq.read_table(tmp_path / run / "episodes.parquet") for run in ("whole", "parts"))
    assert whole.equals(parts)
    if algo != "cacla":
        assert {"critic_loss", "intrinsic_reward", "live_nodes"} <= set(whole.column_names)
        assert np.isfinite(whole["critic_loss"].to_numpy()).all()
    last = [sorted((tmp_path / run / "checkpoints").glob("*.npz"))[-1] for run in ("whole", "parts")]
    with np.load(last[0]) as first, np.load(last[1]) as second:
        assert first.files == second.files
        for name in set(first.files) - {"meta"}:
            np.testing.assert_array_equal(first[name], second[name], err_msg=name)


def test_a_policy_of_td3_is_evaluated_exported_and_read_without_jax(icac, tmp_path):
    icac("train", "--algo", "td3", *TINY, "--episodes", 4, "--out", "run", check=0)
    assert "td3 on planar2" in icac("evaluate", "run", "--pairs", 5, check=0).stdout
    icac("export", "run", "--out", "policy.npz", check=0)
    found = importlib.util.spec_from_file_location("policy_reader", ROOT / "docs" / "policy_reader.py")
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    policy = module.Policy(tmp_path / "policy.npz")
    learner = saved.pick(tmp_path / "run", str(policy.header["seed"]))
    seen = np.random.default_rng(0).uniform(-1, 1, (5, 4)).astype(np.float32)
    np.testing.assert_allclose([policy.act(one) for one in seen], greedy_actions(learner)(jnp.asarray(seen)), atol=1e-6)


def starts_and_goals(**changes):
    env, params = reach.make(arms.PLANAR2, "kinematic"), reach.task(arms.PLANAR2, **changes).traced()
    state, _ = jax.vmap(env.init, (0, None))(jax.random.split(jax.random.key(0), 200), params)
    return np.degrees(state.joints), np.asarray(state.goal)


def test_starts_and_goals_are_placed_apart():
    starts, goals = starts_and_goals()
    fixed, same_goals = starts_and_goals(start_range=0.0)
    np.testing.assert_allclose(fixed, 90.0, atol=1e-4)
    np.testing.assert_allclose(same_goals, goals, atol=1e-5)
    same_starts, one_goal = starts_and_goals(goal_range=0.0)
    np.testing.assert_allclose(same_starts, starts, atol=1e-4)
    np.testing.assert_allclose(one_goal, one_goal[:1].repeat(200, 0), atol=1e-5)
    moved, _ = starts_and_goals(start_range=0.5, start_offset=(30.0, -45.0))
    np.testing.assert_allclose(moved, (starts - 90.0) / 2 + 90.0 + [30.0, -45.0], atol=1e-3)
    with pytest.raises(
        ConfigError, match="start_offset: must leave starts within the joint limits, at most 45, got 50"
    ):
        reach.task(arms.PLANAR2, start_range=0.5, start_offset=(50.0, 0.0))
    # Where Python asks for them, they are where the program puts them.
    draws = np.array([[[0.5, -0.5]], [[0.0, 0.25]]])
    start, goal = reach.placed(reach.task(arms.PLANAR2, start_range=0.5, start_offset=(30.0, 0.0)), draws)
    np.testing.assert_allclose(np.degrees([start, goal]), [[[165.0, 45.0]], [[90.0, 135.0]]])


def test_a_step_can_cost_something():
    env = reach.make(arms.PLANAR2, "kinematic")
    params = reach.task(arms.PLANAR2, step_cost=0.25, goal_reward=3.0).traced()
    state, _ = env.init(jax.random.key(0), params)
    _, seen = env.step(state, jnp.zeros(2), params)
    assert float(seen.reward) == (3.0 if seen.terminated else -0.25)
    assert float(env.goal.reward(jnp.array(True), params)) == 3.0
    assert float(env.goal.reward(jnp.array(False), params)) == -0.25


def test_what_nobody_asks_for_is_not_in_the_program():
    plain, asked = reach.task(arms.PLANAR2).traced(), reach.task(arms.PLANAR2, step_cost=1.0).traced()
    assert (plain.step_cost, plain.start_range, plain.start_offset) == (None, None, None)
    assert float(asked.step_cost) == 1.0
    both = icac_jax.train(
        "planar2", "cacla", seeds=2, episodes=2, physics="kinematic", step_cost=[[0.0], [1.0]], progress=False
    )
    lost = both.episodes["extrinsic_reward"][0] - both.episodes["extrinsic_reward"][1]
    steps, reached = both.episodes["steps"][1], both.episodes["reached"][1]
    same = both.episodes["steps"][0] == steps
    np.testing.assert_allclose(lost[same], (steps - reached)[same])


def test_the_greedy_policy_may_be_the_target():
    """The target is the actor's running mean: what acts without exploration, and what is exported, changes with it."""
    env = worlds.line()
    agents = {
        choice: worlds.learner("td3", env, greedy_policy=choice, warm_up=5, buffer_size=64, batch_size=8)
        for choice in ("actor", "target")
    }
    said = {}
    for choice, (agent, hyper) in agents.items():
        state = agent.init(jax.random.key(0), hyper)
        learned = state.learned.replace(
            actor=jax.tree.map(lambda leaf: leaf + 1.0, state.learned.actor),
        )
        state = state.replace(learned=learned)
        said[choice] = np.asarray(agent.greedy(state, jnp.full(env.observation_size, 0.1), hyper))
        exported = agent.layers(state).biases[0]
        np.testing.assert_array_equal(exported, 1.0 if choice == "actor" else 0.0)
    assert not np.array_equal(said["actor"], said["target"])
