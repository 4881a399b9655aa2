"""The learner of `examples/own_learner`: everything that a run can do, and no file of the package knows it."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.conftest import DEVICES, also_on_path, apart, here, installed

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "own_learner"
TRAIN = ["--algo", "replay_ddpg", "--physics", "kinematic", "--seeds", "2", "--buffer", "200", "--batch", "16"]


@pytest.fixture(scope="module")
def icac(tmp_path_factory):
    """The command line with the example installed: its module, and what an installer writes beside it.

    In this process, or with `own` in a process of its own.
    """
    place = tmp_path_factory.mktemp("installed")
    shutil.copy(EXAMPLE / "replay_ddpg.py", place)
    facts = place / "replay_ddpg-1.0.dist-info"
    facts.mkdir()
    project = (EXAMPLE / "pyproject.toml").read_text(encoding="utf-8")
    points = project.split('entry-points."icac_jax.learners"]\n')[1].split("\n\n")[0].replace('"', "")
    (facts / "entry_points.txt").write_text(f"[icac_jax.learners]\n{points}\n")
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: replay-ddpg\nVersion: 1.0\n")
    env = also_on_path(place) | {"JAX_NUM_CPU_DEVICES": str(DEVICES)}

    def run(*args, status=0, own=False):
        done = apart(*args, env=env) if own else here(*args)
        assert done.returncode == status, done.stderr
        return done

    with installed(place):
        yield run


@pytest.fixture(scope="module")
def trained(icac, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "run"
    icac("train", *TRAIN, "--episodes", 8, "--out", out, own=True)
    return out


def test_its_options_and_columns_are_its_own(icac, trained):
    page = icac("train", "--algo", "replay_ddpg", "--help").stdout
    assert "--tau" in page
    assert "--e-max" not in page
    refused = icac("train", "--algo", "replay_ddpg", "--e-max", "0.5", status=2)
    assert "e_max: no option of replay_ddpg, only of icac" in refused.stderr
    table = pq.read_table(trained / "episodes.parquet")
    assert table.column_names[-1] == "critic_loss"
    assert (table["critic_loss"].to_numpy() > 0).all()


def test_it_is_resumed_to_the_bit_buffer_and_all(icac, trained, tmp_path):
    whole, resumed = tmp_path / "whole", tmp_path / "resumed"
    icac("train", *TRAIN, "--episodes", 16, "--out", whole)
    shutil.copytree(trained, resumed)
    icac("resume", resumed, "--episodes", 16)
    assert pq.read_table(whole / "episodes.parquet").equals(pq.read_table(resumed / "episodes.parquet"))
    arrays = []
    for run in (whole, resumed):
        with np.load(sorted((run / "checkpoints").glob("*.npz"))[-1]) as archive:
            arrays.append({name: archive[name] for name in archive.files if name != "meta"})
    assert any("buffer" in name for name in arrays[0])
    assert arrays[0].keys() == arrays[1].keys()
    for name, value in arrays[0].items():
        np.testing.assert_array_equal(value, arrays[1][name], err_msg=name)


def test_it_is_evaluated_rendered_and_exported(icac, trained, tmp_path):
    found = json.loads(icac("evaluate", trained, "--pairs", 20, "--json").stdout)
    assert found["algo"] == "replay_ddpg"
    icac("export", trained, "--seed", 1, "--out", tmp_path / "policy.npz")
    with np.load(tmp_path / "policy.npz") as policy:
        assert json.loads(policy["header"].tobytes())["network"]["output"] == "tanh"
        assert policy["weights_0"].shape == (32, 4)
    icac("render", trained, "--seed", 1, "--episodes", 1, "--out", tmp_path / "film.png")
    assert (tmp_path / "film.png").stat().st_size > 1000


def test_curiosity_goes_around_it(icac):
    """One line: the bonus is stored with the transition."""
    sys.path.insert(0, str(EXAMPLE))
    try:
        import replay_ddpg
    finally:
        sys.path.remove(str(EXAMPLE))
    import icac_jax

    class Hyper(icac_jax.CuriosityHyper, replay_ddpg.Hyper):
        pass

    inside = replay_ddpg.agent(replay_ddpg.Spec(buffer=100, batch=8))
    agent = icac_jax.curious(inside, icac_jax.CuriositySpec(observation_size=4, state_size=2, action_size=2))
    run = icac_jax.train("planar2", agent, hyper=Hyper(), seeds=2, episodes=5, physics="kinematic")
    assert {"critic_loss", "intrinsic_reward", "live_nodes"} <= run.episodes.keys()
    assert (run.states.agent.buffer[2] > 0).any()
