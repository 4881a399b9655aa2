"""Worlds of gymnax for the learners here: the same steps, scaled; recorded, resumed; refused where an arm is needed."""

import sys

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

import icac_jax
from icac_jax.cli import main
from icac_jax.envs import from_gymnax
from icac_jax.fields import ConfigError
from icac_jax.runs import folder
from icac_jax.settings.options import resolve

PENDULUM = "gymnax:Pendulum-v1"
BOXES = [
    PENDULUM,
    "gymnax:MountainCarContinuous-v0",
    "gymnax:PointRobot-misc",
    "gymnax:Reacher-misc",
    "gymnax:Swimmer-misc",
]


def test_steps_are_those_of_gymnax_scaled():
    world, params = gymnax.make("Pendulum-v1")
    env = from_gymnax.make(PENDULUM)
    numbers = resolve(arm=PENDULUM, horizon=3).params.traced()
    state, seen = env.init(jax.random.key(0), numbers)
    inside = state.inside
    np.testing.assert_allclose(seen, world.get_obs(inside) / np.array([1, 1, 8]), rtol=1e-6)
    for number, action in enumerate((0.5, -1.0, 3.0)):
        state, after = env.step(state, jnp.array([action]), numbers)
        # The world's torque is at most 2, and an action of the learner's at most 1.
        told = jnp.array([2 * np.clip(action, -1, 1)], jnp.float32)
        raw, inside, reward, _, _ = world.step_env(jax.random.key(9), inside, told, params)
        np.testing.assert_allclose(after.observation, raw / np.array([1, 1, 8]), rtol=1e-5)
        np.testing.assert_allclose(after.reward, reward, rtol=1e-5)
        assert not after.terminated
        assert after.truncated == (number == 2)


@pytest.mark.parametrize("name", BOXES)
def test_every_world_with_a_box_steps_and_keeps_its_types(name):
    env = from_gymnax.make(name)
    assert env is from_gymnax.make(name)
    numbers = resolve(arm=name).params.traced()
    start = env.init(jax.random.key(0), numbers)

    def body(carry, _):
        state, after = env.step(carry[0], jnp.full(env.action_size, 0.3), numbers)
        return (state, after.observation), after

    (_, last), steps = jax.lax.scan(body, start, None, length=3)
    assert last.shape == (env.observation_size,)
    assert np.isfinite(steps.reward).all()


def test_the_horizon_is_the_world_s_own_where_nobody_says_otherwise():
    assert resolve(arm=PENDULUM).params.horizon == 200
    assert resolve(arm=PENDULUM, horizon=7).params.horizon == 7


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"arm": "gymnax:CartPole-v1"}, "arm: gymnax:CartPole-v1 has discrete actions"),
        ({"arm": "gymnax:Pendulum-v2"}, "did you mean Pendulum-v1"),
        ({"arm": PENDULUM, "goal_radius": 2.0}, "goal_radius: no option of gymnax:Pendulum-v1, only of arms"),
        ({"arm": PENDULUM, "physics": "kinematic"}, "physics: no option of"),
        ({"arm": PENDULUM, "coverage_bins": 4}, "coverage_bins: no option of"),
        ({"arm": PENDULUM, "demonstrations": "oracle"}, "demonstrations: no option of"),
        ({"arm": PENDULUM, "walls": (1.0, 2.0)}, "walls: no option of"),
        ({"arm": PENDULUM, "task": "door"}, "task: must be one of reach"),
        ({"arm": PENDULUM, "preset": "best"}, "preset: must be one of paper"),
    ],
)
def test_what_a_world_has_not_is_refused_in_a_line(options, words):
    with pytest.raises(ConfigError, match=words):
        resolve(**options)


def test_without_gymnax_a_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "gymnax", None)
    with pytest.raises(
        ConfigError, match=r"^arm: a world of gymnax needs the extra, pip install 'icac_jax\[gymnax\]'$"
    ):
        resolve(arm=PENDULUM)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """ICAC for three episodes, then resumed to five."""
    out = tmp_path_factory.mktemp("world") / "run"
    small = ["--algo", "icac", "--seeds", "2", "--horizon", "12", "--map-capacity", "8"]
    assert main.main(["train", "--env", PENDULUM, *small, "--episodes", "3", "--out", str(out), "--no-cache"]) == 0
    assert main.main(["resume", str(out), "--episodes", "5", "--no-cache"]) == 0
    return out


def test_resumed_is_uninterrupted_and_python_is_the_command_line(run):
    straight = icac_jax.train(PENDULUM, "icac", seeds=2, horizon=12, map_capacity=8, episodes=5)
    rewards = pq.read_table(run / "episodes.parquet")["extrinsic_reward"].to_numpy().reshape(2, 5)
    np.testing.assert_array_equal(rewards, straight.episodes["extrinsic_reward"])
    assert folder.load(run).run.arm == PENDULUM
    summary = folder.read_json(run / "summary.json")
    assert summary["returns"]["last_tenth"] == pytest.approx(rewards[:, -1].mean(), rel=1e-6)
    assert summary["live_nodes"] > 0
    assert summary["physics"] == "gymnax"


def test_the_report_speaks_of_returns(run):
    page = (run / "report.html").read_text()
    assert "had a return of" in page
    assert "of its goals" not in page


@pytest.mark.parametrize("command", ["render", "evaluate", "export", "plot-map"])
def test_commands_that_need_an_arm_say_so(run, command, capsys):
    assert main.main([command, str(run)]) == 2
    assert "needs an arm, and gymnax:Pendulum-v1 has none" in capsys.readouterr().err


def test_evaluating_while_training_needs_an_arm(tmp_path, capsys):
    assert main.main(["train", f"--env={PENDULUM}", "--evaluate-every", "2", "--out", str(tmp_path / "new")]) == 2
    assert "evaluate_every: an evaluation needs an arm" in capsys.readouterr().err
