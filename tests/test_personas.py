"""People who use this library, each as the few commands or lines that they would type, with small numbers.

What each command does in detail is tested elsewhere. Here is whether a way through them works, and whether its end is
what the person came for. The notebook user is in `test_notebook.py`.
"""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

import icac_jax
from icac_jax.gymnasium_curiosity import Curiosity
from tests.conftest import here

TINY = ("--physics", "kinematic", "--seeds", 2, "--episodes", 20)


def icac(*args, cwd):
    """A command that must work; what it printed."""
    done = here(*args, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a run of ICAC in it, in which the persons work one after another."""
    place = tmp_path_factory.mktemp("personas")
    icac("train", "--algo", "icac", *TINY, "--checkpoint-every", 0, "--out", "runs/icac", cwd=place)
    return place


def test_a_student_asks_for_help_trains_and_reads_the_report(place):
    assert "train one algorithm on one arm" in icac("--help", cwd=place)
    wrong = here("train", "--seed", 3, cwd=place)
    assert (wrong.returncode, "did you mean --seeds?" in wrong.stderr) == (2, True)
    assert "--sigma" in icac("help", "train", cwd=place)
    said = icac("train", "--algo", "cacla", *TINY, "--out", "runs/cacla", cwd=place)
    assert "cacla on planar2 (kinematic, preset paper): 2 seeds x 20 episodes" in said
    report = (place / "runs" / "cacla" / "report.html").read_text()
    assert "CACLA" in re.search(r'<p class="headline">(.*?)</p>', report)[1]
    table = icac("compare", "runs/cacla", "runs/icac", cwd=place)
    assert [line.split()[0] for line in table.splitlines()[2:4]] == ["cacla", "icac"]
    assert (place / "comparison.png").stat().st_size > 10_000


def test_a_tuner_lets_a_file_draw_settings_and_trains_with_the_best(place):
    (place / "rates.toml").write_text(
        '[base]\nalgo = "cacla"\nphysics = "kinematic"\nseeds = 2\nepisodes = 20\n'
        '[random]\ndraws = 4\nsampler = "sobol"\nactor_rate = {low = 0.003, high = 0.3, log = true}\n'
    )
    assert icac("sweep", "rates.toml", "--dry-run", cwd=place).count(" actor_rate=") == 4
    icac("sweep", "rates.toml", "--out", "runs/rates", cwd=place)
    best = icac("best", "runs/rates", cwd=place)
    (place / "best.toml").write_text(best)
    assert 0.003 <= float(re.search(r"actor_rate = (\S+)", best)[1]) <= 0.3
    icac("train", "--config", "best.toml", *TINY, "--out", "runs/tuned", cwd=place)
    rate = re.search(r"actor_rate = (\S+)", (place / "runs" / "tuned" / "config.toml").read_text())[1]
    assert float(rate) == float(re.search(r"actor_rate = (\S+)", best)[1])


def test_a_jax_developer_scans_curiosity_over_transitions_of_many_lanes():
    spec = icac_jax.CuriositySpec(observation_size=2, state_size=2, action_size=1, map_capacity=16)
    hyper = icac_jax.CuriosityHyper(e_max=0.3).traced()

    @jax.jit
    @jax.vmap
    def explore(key, places):
        def step(state, pair):
            state, info = icac_jax.curiosity.update(spec, state, pair[0], pair[1][:1], pair[1], hyper)
            return state, info.reward

        return jax.lax.scan(step, icac_jax.curiosity.init(spec, key, hyper), (places[:-1], places[1:]))

    places = jax.random.uniform(jax.random.key(1), (3, 40, 2), minval=-1.0, maxval=1.0)
    states, rewards = explore(jax.random.split(jax.random.key(0), 3), places)
    assert rewards.shape == (3, 39)
    assert jnp.isfinite(rewards).all()
    assert states.map.live.sum(axis=1).min() > 2


def test_an_sb3_user_types_known_names_and_wraps_a_world(place):
    wrong = here("train", "--total-timesteps", 1000, cwd=place)
    assert (wrong.returncode, "here it is --episodes" in wrong.stderr) == (2, True)
    world = Curiosity(
        gymnasium.make("icac_jax.envs.gymnasium:icac_jax/Planar2Reach-v0", physics="kinematic"),
        state_size=2,
        map_capacity=16,
    )
    observation, _ = world.reset(seed=0)
    for action in np.random.default_rng(0).uniform(-1, 1, (5, 2)).astype(np.float32):
        observation, reward, _, _, info = world.step(action)
    assert world.observation_space.contains(observation)
    assert reward == pytest.approx(info["extrinsic_reward"] + info["intrinsic_reward"])


def test_a_roboticist_takes_a_policy_to_a_machine_that_has_numpy_alone(place):
    icac("evaluate", "runs/icac", "--pairs", 10, cwd=place)
    icac("export", "runs/icac", "--format", "folder", "--out", "robot", cwd=place)
    code = """
import json, sys
sys.modules |= {"jax": None, "mujoco": None, "icac_jax": None}
from policy_reader import Policy
policy, joints = Policy("policy.npz"), [90.0, 90.0]
for step in range(20):
    joints = policy.move(joints, [0.3, 0.3, policy.header["reach"]["base"][2]])
try:
    policy.move(joints, [9.0, 9.0, 0.0])
except ValueError as error:
    print(json.dumps([list(joints), str(error)]))
"""
    robot = place / "robot"
    done = subprocess.run([sys.executable, "-c", code], cwd=robot, capture_output=True, text=True, check=True)
    joints, refused = json.loads(done.stdout)
    limits = icac_jax.preset("planar2").params
    assert np.all((joints >= np.array(limits.joint_low)) & (joints <= np.array(limits.joint_high)))
    assert refused.startswith("goal out of reach")
    assert "10 start and goal pairs without exploration" in (robot / "card.md").read_text()


def test_one_who_comes_back_after_a_month_finds_the_run_and_goes_on(place):
    month_ago = os.stat(place / "runs" / "icac" / "config.toml").st_mtime - 30 * 86_400
    for path in (place / "runs" / "icac").rglob("*"):
        os.utime(path, (month_ago, month_ago))
    (found,) = json.loads(icac("runs", "--filter", "algo=icac", "state=finished", "--json", cwd=place))
    run = place / found["folder"] if not Path(found["folder"]).is_absolute() else Path(found["folder"])
    assert run.samefile(place / "runs" / "icac")
    before = pq.read_table(run / "episodes.parquet")
    icac("resume", run, "--episodes", 30, cwd=place)
    after = pq.read_table(run / "episodes.parquet")
    assert (before.num_rows, after.num_rows) == (40, 60)
    early = after.filter(np.array(after["episode"]) < 20)
    key = [("seed", "ascending"), ("episode", "ascending")]
    assert early.sort_by(key).equals(before.sort_by(key))
    icac("train", "--config", run / "config.toml", "--out", "again", cwd=place)
    repeated = pq.read_table(place / "again" / "episodes.parquet")
    assert repeated.sort_by(key).equals(after.sort_by(key))


@pytest.mark.slow
def test_a_reproducer_gets_a_verdict_on_each_claim(tmp_path):
    said = icac("reproduce", "--quick", "--no-ablations", "--seeds", 2, "--episodes", 20, "--out", "all", cwd=tmp_path)
    claims = re.findall(r"^ *(C\d+)\b", said, re.M)
    assert set(claims) == {"C1", "C2", "C10", "C11"}  # those that need one arm and no ablations
    assert list((tmp_path / "all").rglob("report.html"))
