"""The Python door: names or objects in, arrays over seeds and settings out, in one compile."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

import icac_jax as icac
from icac_jax.cli import main
from icac_jax.runs import loop, programs
from icac_jax.settings.options import resolve
from tests import worlds

FAST = {"physics": "kinematic", "episodes": 20}


@pytest.fixture(scope="module")
def grid():
    return icac.train("planar2", "icac", seeds=range(3), sigma=[[0.1], [1.0]], **FAST)


def test_broadcasting_is_the_sweep(grid):
    assert grid.success.shape == grid.steps.shape == grid.diverged.shape == (2, 3)
    assert grid.episodes["steps"].shape == (2, 3, 20)
    assert {"reached", "extrinsic_reward", "intrinsic_reward", "live_nodes"} <= grid.episodes.keys()
    np.testing.assert_array_equal(grid.varied["sigma"], [[0.1] * 3, [1.0] * 3])
    np.testing.assert_array_equal(grid.success, grid.episodes["reached"][..., 18:].mean(axis=-1))
    np.testing.assert_array_equal(grid.steps, grid.episodes["steps"][..., 18:].mean(axis=-1))
    assert "2 x 3 learners" in repr(grid)


def test_a_cell_is_what_it_is_alone(grid):
    alone = icac.train("planar2", "icac", seeds=[2], sigma=1.0, **FAST)
    np.testing.assert_array_equal(alone.episodes["steps"][0, :5], grid.episodes["steps"][1, 2, :5])
    np.testing.assert_allclose(
        alone.episodes["intrinsic_reward"][0, :5], grid.episodes["intrinsic_reward"][1, 2, :5], rtol=1e-4
    )


def test_two_grids_of_one_shape_are_one_compile(grid):
    before = set(map(id, programs.PROGRAMS.values()))
    icac.train("planar2", "icac", seeds=[[5, 6, 7]], gamma=[[0.5], [0.8]], **FAST)
    assert set(map(id, programs.PROGRAMS.values())) == before


def test_tables(grid):
    frame, other = grid.to_pandas(), grid.to_polars()
    assert len(frame) == len(other) == 2 * 3 * 20
    assert list(frame.columns[:3]) == ["seed", "sigma", "episode"]
    mine = frame[(frame.seed == 1) & (frame.sigma == 0.1)]
    np.testing.assert_array_equal(mine.steps, grid.episodes["steps"][0, 1])


def test_a_policy_acts(grid):
    one, several = np.zeros(4), np.zeros((5, 2, 4))
    action = grid.policy(1, 2)(one)
    assert action.shape == (2,)
    assert np.abs(action).max() <= 1
    np.testing.assert_allclose(grid.policy(1, 2)(several), np.broadcast_to(action, (5, 2, 2)), atol=1e-6)
    assert not np.allclose(action, grid.policy(0, 2)(one))
    for index in ((2, 0), (0,), (0, 3)):
        with pytest.raises(icac.ConfigError, match="index: must name one learner"):
            grid.policy(*index)


def test_a_callback_sees_each_chunk():
    seen = []
    run = icac.train("planar2", "cacla", seeds=2, callback=lambda chunk: seen.append(chunk.table.num_rows), **FAST)
    assert sum(seen) == 2 * 20
    assert len(seen) == -(-int(run.episodes["steps"].sum(axis=1).max()) // loop.CHUNK_STEPS)


def test_out_is_the_folder_of_the_command_line(tmp_path, capsys):
    here, there = tmp_path / "here", tmp_path / "there"
    run = icac.train("planar2", "cacla_var", seeds=3, sigma=0.4, out=here, **FAST)
    options = ["--physics", "kinematic", "--episodes", "20", "--seeds", "3", "--sigma", "0.4", "--algo", "cacla_var"]
    assert main.main(["train", *options, "--out", str(there)]) == 0
    assert pq.read_table(here / "episodes.parquet").equals(pq.read_table(there / "episodes.parquet"))
    assert (here / "config.toml").read_text() == (there / "config.toml").read_text()
    assert {path.name for path in here.iterdir()} == {path.name for path in there.iterdir()}
    record = pq.read_table(here / "episodes.parquet")
    np.testing.assert_array_equal(run.episodes["steps"].ravel(), record["steps"].to_numpy())
    capsys.readouterr()


def test_objects_go_where_names_go():
    world = worlds.line()
    named = icac.train(world, "cacla", params=0.5, seeds=3, episodes=60, sigma=[[0.3], [0.6]])
    assert named.success.shape == (2, 3)
    agent = icac.cacla.agent(icac.cacla.CaclaSpec(observation_size=2, action_size=1), icac.cacla.once)
    mine = icac.train(
        world, agent, hyper=icac.cacla.CaclaHyper(), params=0.5, seeds=3, episodes=60, sigma=[[0.3], [0.6]]
    )
    np.testing.assert_array_equal(named.episodes["steps"], mine.episodes["steps"])
    assert named.episodes["reached"].shape == (2, 3, 60)


WRONG = [
    ({"gamma": 2.0}, "gamma: must be a number at least 0 and less than 1, got 2.0"),
    ({"gamma": [0.5, 1.5], "seeds": [0, 1]}, "gamma: must be a number at least 0 and less than 1, got 1.5"),
    ({"sigma": [0.1, np.nan], "seeds": [0, 1]}, "sigma: must be a number at least 0, got nan"),
    ({"mu": [40, 70], "seeds": [0, 1]}, r"window: must be at least mu \+ T = 90, got 60"),
    ({"window": 10}, r"window: must be at least mu \+ T = 60, got 10"),
    ({"sigmaa": 0.1}, "sigmaa: no such option; did you mean sigma?"),
    ({"agent": "cacla", "e_max": 0.5}, "e_max: no option of cacla, only of icac"),
    ({"agent": "ddpgg"}, "algo: must be one of "),
    ({"env": "planar3"}, "arm: must be one of "),
    ({"sigma": [0.1, 0.2], "seeds": range(3)}, r"sigma: shapes must broadcast, got seeds \(3,\), sigma \(2,\)"),
    ({"hidden_units": [6, 12]}, "hidden_units: no number that can be an array"),
    ({"seeds": []}, "seeds: must be whole numbers at least 0, at least one of them"),
    ({"seeds": [-1]}, "seeds: must be whole numbers at least 0"),
    ({"seeds": [0.5]}, "seeds: must be whole numbers at least 0"),
    ({"seeds": 0}, "seeds: must be a whole number at least 1"),
    ({"episodes": 0}, "episodes: must be a whole number at least 1"),
    ({"mu": [40.5, 41.0], "seeds": [0, 1]}, "mu: must be numbers of the kind int32, got float64"),
    ({"arm": "planar2"}, "arm: must be given as env"),
    ({"hyper": icac.Hyper()}, "hyper: must be left out with names"),
    ({"agent": icac.cacla.agent(icac.cacla.CaclaSpec())}, "hyper: must be given with an Agent"),
    ({"agent": 3}, "agent: must be a name, a Learner or an Agent, got int"),
    ({"out": "x", "sigma": [0.1, 0.2], "seeds": 2}, "sigma: must be one value with out"),
    ({"out": "x", "seeds": [3, 4]}, "seeds: must be 0 to n - 1 with out"),
    ({"env": worlds.line(), "out": "x"}, "out: must be left out with objects"),
]


@pytest.mark.parametrize(("changed", "said"), WRONG)
def test_what_is_not_allowed_is_named_before_anything_is_traced(changed, said, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(loop.Loop, "chunks", lambda *_: pytest.fail("it would have trained"))
    with pytest.raises(icac.ConfigError, match=said):
        icac.train(**{"env": "planar2", "agent": "icac", "physics": "kinematic", "episodes": 5} | changed)
    assert list(tmp_path.iterdir()) == []


def test_records_are_checked_when_they_are_made():
    for make, said in (
        (lambda: icac.Hyper(gamma=2.0), "gamma: must be a number at least 0 and less than 1, got 2.0"),
        (lambda: icac.Hyper(mu=0), "mu: must be a whole number at least 1, got 0"),
        (lambda: icac.Spec(window=1), "window: must be a whole number at least 2"),
        (lambda: icac.Spec(optimizer="lion"), "optimizer: must be one of sgd, adam, rmsprop, got 'lion'"),
        (lambda: icac.Spec(state_size=9), "state_size: must be at most observation_size = 4, got 9"),
        (lambda: icac.Hyper().replace(e_max=-1.0), "e_max: must be a number greater than 0, got -1.0"),
    ):
        with pytest.raises(icac.ConfigError, match=said):
            make()
    assert icac.Hyper(mu=np.int64(30), gamma=np.float32(0.5)).mu == 30


def test_a_preset_has_a_public_way_in():
    settings = icac.preset("nico4")
    assert settings.hyper.sigma == 1.0
    assert settings.run.episodes == 15000
    assert icac.preset("planar2", "cacla", "paper-literal").spec.critic_target == "previous"
    assert settings == resolve(arm="nico4")


def test_three_lines_from_a_bare_interpreter():
    """JAX has started already, and the program's own settings are left alone."""
    code = (
        "import jax, jax.numpy as jnp; jnp.ones(3).sum().block_until_ready(); before = dict(jax.config.values)\n"
        "import icac_jax\n"
        "run = icac_jax.train('planar2', 'cacla', seeds=2, episodes=3, physics='kinematic')\n"
        "assert run.success.shape == (2,) and dict(jax.config.values) == before\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_wrong_arrays_are_named_at_the_functions(monkeypatch):
    spec, hyper = icac.Spec(), icac.Hyper().traced()
    agent = icac.icac.agent(spec)
    state = agent.init(jax.random.key(0), hyper)
    curious, bank = icac.curiosity.init(spec, jax.random.key(0), hyper), state.curiosity.bank
    query = icac.predictors.Query(jnp.array(0), jnp.array(False), jnp.zeros(3), jnp.zeros(2))
    net = icac.curiosity.intrinsic.predictor_network(spec)
    lanes = icac.broadcast(hyper, 3)
    world = worlds.line()
    key, act, feel, start = jax.random.key(0), agent.act, icac.curiosity.update, icac.init_lanes
    wrong = (
        (
            lambda: act(state, jnp.zeros(3), key, hyper),
            r"observation: must be an array of shape \(4\)",
        ),
        (
            lambda: act(state, jnp.zeros(4, int), key, hyper),
            "observation: .* type float, got .* int32",
        ),
        (lambda: agent.greedy(state, jnp.zeros((4, 1)), hyper), r"observation: .* got \(4, 1\) of float32"),
        (
            lambda: feel(spec, curious, jnp.zeros(4), jnp.zeros(2), jnp.zeros(2), hyper),
            "sensed: must be",
        ),
        (
            lambda: feel(spec, curious, jnp.zeros(2), jnp.zeros(3), jnp.zeros(2), hyper),
            "action: must be",
        ),
        (lambda: icac.itm.update(curious.map, jnp.zeros(3), rate=0.1, e_max=0.9), "stimulus: must be"),
        (lambda: icac.predictors.update(net, spec, bank, query, hyper), "inputs: must be"),
        (
            lambda: start(agent, world, key, jnp.arange(2), lanes, jnp.ones(2)),
            "hyper.gamma: must have",
        ),
        (
            lambda: start(agent, world, key, jnp.arange(3), lanes, jnp.ones(2)),
            "params: must have",
        ),
        (lambda: start(agent, world, key, jnp.zeros(3), lanes, jnp.ones(3)), "seeds: must be"),
    )
    for call, said in wrong:
        with pytest.raises(icac.ConfigError, match=said):
            call()
