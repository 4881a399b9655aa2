"""Evaluation without exploration: known policies, a trained run, the command."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax import greedy
from icac_jax.agents import cacla
from icac_jax.agents.cacla import CaclaHyper, CaclaSpec
from icac_jax.cli import main
from icac_jax.policies import evaluate
from icac_jax.runs import folder
from tests.worlds import line

AGENT = cacla.agent(CaclaSpec(observation_size=2, action_size=1), cacla.once)
HYPER = CaclaHyper(sigma=5.0).traced()


def always(value):
    """A policy whose action is `value` everywhere."""
    state = AGENT.init(jax.random.key(0), HYPER)
    return state.replace(actor=jnp.zeros_like(state.actor).at[-1].set(value))


def test_a_known_policy():
    """On the line a step is a fifth; from x the right end (0.9) is ceil((0.9 - x) / 0.2) steps away."""
    world = line()
    for seed in range(5):
        key = jax.random.key(seed)
        start = float(world.init(key, None)[1][0])
        right = greedy.greedy_episode(AGENT, world, always(1.0), key, HYPER, 2.0, 20)
        assert bool(right.reached)
        assert int(right.steps) == int(np.ceil((0.9 - start) / 0.2 + 1e-6))
        assert float(right.end[0]) > 0.9
        left = greedy.greedy_episode(AGENT, world, always(-1.0), key, HYPER, 2.0, 20)
        assert not bool(left.reached)
        assert int(left.steps) == 20


def test_actions_are_clipped_and_without_noise():
    world = line()
    one, two = (greedy.greedy_episode(AGENT, world, always(v), jax.random.key(3), HYPER, 2.0, 20) for v in (1.0, 50.0))
    assert int(one.steps) == int(two.steps)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    place = tmp_path_factory.mktemp("evaluated") / "run"
    args = "--physics kinematic --algo cacla_var --seeds 3 --episodes 300 --joint-high 90 90 --weight-scale 0.5"
    assert main.main(["train", *args.split(), "--out", str(place)]) == 0
    return place


def test_a_trained_run(trained, capsys):
    capsys.readouterr()
    assert main.main(["evaluate", str(trained), "--pairs", "200", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result == json.loads((trained / "evaluation.json").read_text())
    assert result["episodes_trained"] == [300] * 3
    assert result["success_rate"]["value"] == pytest.approx(np.mean(result["by_seed"]["success_rate"]))
    assert result["success_rate"]["value"] > 0.6  # both joints in [0, 90]: the easiest of the known ranges
    assert 2.2 < result["oracle_steps"] < 3.0
    assert all(ratio >= 1.0 for ratio in result["by_seed"]["steps_over_oracle"])
    assert result["final_distance"]["value"] < 0.6
    assert main.main(["evaluate", str(trained), "--pairs", "200"]) == 0
    text = capsys.readouterr().out
    assert "steps, a failure is 50" in text
    assert "oracle steps" in text


def test_the_pairs_are_fixed_and_shared_by_all_seeds(trained):
    settings = folder.load(trained)
    saved = evaluate.newest(trained, settings)
    policies = jax.tree.map(lambda leaf: leaf[:3], saved.lanes.agent)
    first, again = (evaluate.greedy_episodes(settings, policies, 31, 0) for _ in range(2))
    jax.tree.map(np.testing.assert_array_equal, first, again)
    for seed in (1, 2):
        np.testing.assert_array_equal(first.start.joints[seed], first.start.joints[0])
        np.testing.assert_array_equal(first.start.goal[seed], first.start.goal[0])
    other = evaluate.greedy_episodes(settings, policies, 31, 1)
    assert np.any(other.start.joints != first.start.joints)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["evaluate"], "run: must be the folder of a run"),
        (["evaluate", "absent"], "run: there is no folder absent"),
        (["evaluate", "."], "holds no run"),
        (["evaluate", "RUN", "--pairs", "0"], "pairs: must be a whole number at least 1 and at most 1000000, got 0"),
        (["evaluate", "RUN", "--pairs", "x"], "pairs: must be a whole number, got 'x'"),
    ],
)
def test_wrong_input(args, words, trained, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    try:
        status = main.main([str(trained) if arg == "RUN" else arg for arg in args])
    except SystemExit as stop:
        status = stop.code
    said = capsys.readouterr()
    assert (status, said.out, said.err.count("\n")) == (2, "", 1)
    assert words in said.err
