"""What `icac export` hands to whoever has a robot: the reader's refusals, the card, ONNX."""

import json
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax.policies import export, saved
from tests.conftest import here
from tests.test_tools import greedy_actions

ROOT = Path(__file__).resolve().parents[1]
TINY = ("--physics", "kinematic", "--seeds", 2, "--episodes", 20)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    place = tmp_path_factory.mktemp("robot") / "run"
    assert here("train", *TINY, "--arm", "nico4", "--algo", "cacla", "--out", place).returncode == 0
    return place


def test_a_bare_export_is_what_it_was_and_has_a_folder_beside(run):
    done = here("export", run, "--seed", 1)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{run / 'policy-seed-1.npz'}\n"
    folder = run / "policy-seed-1"
    assert sorted(path.name for path in folder.iterdir()) == ["card.md", "policy.npz", "policy_reader.py"]
    assert (folder / "policy.npz").read_bytes() == (run / "policy-seed-1.npz").read_bytes()
    assert (folder / "policy_reader.py").read_text() == (ROOT / "docs" / "policy_reader.py").read_text()


def test_the_folder_works_by_itself(run, tmp_path):
    assert here("export", run, "--seed", 0, "--format", "folder", "--out", tmp_path / "robot").returncode == 0
    code = """
import sys
for name in ("jax", "mujoco", "icac_jax"):
    sys.modules[name] = None
import json
from policy_reader import Policy
policy = Policy("policy.npz")
reach = policy.header["reach"]
near = [(a + b) / 2 for a, b in zip(*reach["box"])]
said = []
for joints, goal in [([0, 0, 0, 0], near), ([0, 0, 0], near), ([0, 0, 0, 0], near[:2]), ([0, 0, 0, float("nan")], near),
                     ([0, 0, 0, 0], [9, 9, 9])]:
    try:
        said.append(list(policy.move(joints, goal)))
    except ValueError as error:
        said.append(str(error))
try:
    policy.act([0.0, 0.0])
    said.append(None)
except ValueError as error:
    said.append(str(error))
print(json.dumps(said))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path / "robot", capture_output=True, check=True)
    moved, joints, goal, number, far, size = json.loads(done.stdout)
    assert len(moved) == 4
    for refused in (joints, goal, number):
        assert refused.startswith("must be one angle per joint and three coordinates")
    assert far.startswith("goal out of reach: [9 9 9]")
    assert size


def test_no_goal_of_the_training_is_out_of_reach(run):
    learner = saved.pick(run, "0")
    reach = export.reach(learner)
    from icac_jax.envs import oracle

    _, goals = oracle.pairs(learner.settings.arm, learner.settings.params, 3000, seed=5)
    assert np.all(np.linalg.norm(goals - reach["base"], axis=1) <= reach["most"])
    assert np.all((goals >= reach["box"][0]) & (goals <= reach["box"][1]))


def test_the_card_says_what_a_robot_needs(run):
    assert here("export", run, "--seed", 0, "--format", "folder").returncode == 0
    path = run / "policy-seed-0" / "card.md"
    text = path.read_text()
    assert "| Control period | 0.15 s (3 physics steps), kinematic physics |" in text
    assert "| r_shoulder_z | -100 | 125 |" in text or "| r_shoulder_z | -100 |" in text
    assert "at most 10 degrees per joint" in text
    assert "Not evaluated without exploration yet" in text
    assert here("evaluate", run, "--pairs", 20).returncode == 0
    assert here("export", run, "--seed", 0, "--format", "folder").returncode == 0
    rate = json.loads((run / "evaluation.json").read_text())["by_seed"]["success_rate"][0]
    assert f"It reached {rate:.1%} of the goals" in path.read_text()
    assert "20 start and goal pairs without exploration" in path.read_text()


def test_onnx_acts_as_the_policy_does(run, tmp_path):
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    out = tmp_path / "policy.onnx"
    assert here("export", run, "--seed", 0, "--format", "onnx", "--out", out).returncode == 0
    session = runtime.InferenceSession(out)
    seen = np.random.default_rng(0).uniform(-1, 1, (50, 7)).astype(np.float32)
    (actions,) = session.run(["action"], {"observation": seen})
    np.testing.assert_allclose(actions, greedy_actions(saved.pick(run, "0"))(jnp.asarray(seen)), atol=1e-6)
    header = json.loads(session.get_modelmeta().custom_metadata_map["icac_jax"])
    assert header["arm"] == "nico4"


def test_a_missing_onnx_is_one_line(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    done = here("export", run, "--seed", 0, "--format", "onnx", "--out", tmp_path / "x.onnx")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "pip install 'icac_jax[onnx]'" in done.stderr
    assert not (tmp_path / "x.onnx").exists()


def test_the_reader_takes_files_of_version_0_1_0(run, tmp_path):
    """They do not say how far the arm reaches: nothing is refused for that."""
    assert here("export", run, "--seed", 0, "--format", "folder", "--out", tmp_path / "robot").returncode == 0
    with np.load(tmp_path / "robot" / "policy.npz") as file:
        arrays = dict(file)
    header = json.loads(arrays.pop("header").tobytes())
    del header["reach"]
    np.savez(tmp_path / "robot" / "policy.npz", header=np.frombuffer(json.dumps(header).encode(), np.uint8), **arrays)
    code = "from policy_reader import Policy; print(len(Policy('policy.npz').move([0, 0, 0, 0], [9, 9, 9])))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path / "robot", capture_output=True, text=True, check=True
    )
    assert done.stdout == "4\n"
