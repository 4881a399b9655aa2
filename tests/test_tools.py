"""What is made of a finished run: pictures, the plot of the map, policy files."""

import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from icac_jax import curiosity, greedy
from icac_jax.cli import main
from icac_jax.envs import oracle, reach
from icac_jax.fields import ConfigError
from icac_jax.policies import evaluate, export, film, map_picture, saved
from icac_jax.runs import build, folder

ROOT = Path(__file__).resolve().parents[1]
TINY = "--physics kinematic --seeds 3 --episodes 60 --weight-scale 0.5"


def trained(place, more):
    assert main.main(["train", *TINY.split(), *more.split(), "--out", str(place)]) == 0
    return place


@pytest.fixture(scope="module")
def planar(tmp_path_factory):
    return trained(tmp_path_factory.mktemp("planar") / "run", "--joint-high 90 90 --map-capacity 32")


@pytest.fixture(scope="module")
def nico(tmp_path_factory):
    return trained(tmp_path_factory.mktemp("nico") / "run", "--arm nico4 --episodes 10 --map-capacity 32")


@pytest.fixture(scope="module")
def without_map(tmp_path_factory):
    return trained(tmp_path_factory.mktemp("plain") / "run", "--algo cacla --episodes 2")


@pytest.fixture(params=["planar", "nico"])
def run(request):
    return request.getfixturevalue(request.param)


def refused(capsys, words, *args):
    capsys.readouterr()
    assert main.main([str(arg) for arg in args]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1), said.err
    assert said.err.startswith(f"icac {args[0]}: ")
    for word in words:
        assert word in said.err


def test_the_best_seed(planar, tmp_path):
    shutil.copytree(planar, tmp_path / "run")
    parts = {
        "0": {"success_rate": 0.5, "steps": 9.0},
        "1": {"success_rate": 0.7, "steps": 12.0},
        "2": {"success_rate": 0.7, "steps": 11.0},
    }
    path = tmp_path / "run" / "summary.json"
    whole = json.loads(path.read_text())
    for seed, part in parts.items():
        whole["last_tenth_by_seed"][seed] |= part
    path.write_text(json.dumps(whole))
    assert saved.pick(tmp_path / "run").seed == 2
    path.unlink()
    with pytest.raises(ConfigError, match=r"best needs the summary\.json of a finished run"):
        saved.pick(tmp_path / "run")
    learner = saved.pick(tmp_path / "run", "1")
    lanes = evaluate.newest(planar, folder.load(planar)).lanes
    np.testing.assert_array_equal(learner.agent.agent.actor, lanes.agent.agent.actor[1])
    assert (learner.seed, learner.episodes) == (1, 60)


def test_the_path_of_a_greedy_episode(planar):
    """Where the episode shown goes: the start and goal, the end and the length are those of `icac evaluate`."""
    learner = saved.pick(planar, "1")
    settings = learner.settings
    shown = film.play(learner, 5)
    one = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], learner.agent)
    known = evaluate.greedy_episodes(settings, one, 5, 0)
    for number, played in enumerate(shown):
        assert len(played.joints) == known.steps[0, number] + 1
        assert played.reached == known.reached[0, number]
        np.testing.assert_allclose(played.joints[0], known.start.joints[0, number], atol=1e-6)
        np.testing.assert_allclose(played.joints[-1], known.end.joints[0, number], atol=1e-4)
        moves = np.degrees(np.abs(np.diff(played.joints, axis=0)))
        assert moves.max() <= settings.params.action_bound + 1e-3
        distance = np.linalg.norm(oracle.tips(settings.arm, played.joints) - played.goal, axis=1)
        assert np.all(distance[1:-1] > settings.params.goal_radius - 1e-5)
        assert (distance[-1] <= settings.params.goal_radius + 1e-5) == played.reached


def test_greedy_path_repeats_the_end(planar):
    learner = saved.pick(planar, "0")
    settings = learner.settings
    world = reach.make(settings.arm, "kinematic", settings.run.sub_steps)
    policy = jax.tree.map(jnp.asarray, learner.agent)
    numbers = settings.hyper.traced(), settings.params.traced()
    play = jax.jit(lambda key: greedy.greedy_path(build.agent(settings), world, policy, key, *numbers, 50))
    episode, path = play(jax.random.key(1))
    assert path.joints.shape == (50, 2)
    last = int(episode.steps) - 1
    np.testing.assert_array_equal(path.joints[last:], np.broadcast_to(episode.end.joints, (50 - last, 2)))


def greens(picture):
    """Pixels of the goal zone's colour."""
    pixels = np.asarray(picture.convert("RGB")).astype(int)
    return int(np.sum((pixels[..., 1] > pixels[..., 0] + 40) & (pixels[..., 1] > pixels[..., 2] + 15)))


def reds(picture):
    """Pixels of the trail's colour."""
    pixels = np.asarray(picture.convert("RGB")).astype(int)
    return int(np.sum((pixels[..., 0] > pixels[..., 1] + 100) & (pixels[..., 0] > pixels[..., 2] + 100)))


def test_a_frame_shows_goal_and_trail(run):
    learner = saved.pick(run, "0")
    studio = film.Studio(learner, 400, 356)
    arm, params = learner.settings.arm, learner.settings.params
    middle = np.radians(np.add(params.joint_low, params.joint_high) / 2)
    way = np.linspace(middle, middle + 0.6, 5)
    played = film.Played(way, oracle.tips(arm, way[-1:] + 0.4)[0], False)
    first, last = studio.frame(played, 1, 0.0, 3), studio.frame(played, 1, 4.0, 3)
    assert first.size == (400, 356)
    assert greens(first) > 50
    assert reds(last) > reds(first) + 20
    studio.radius *= 2
    assert greens(studio.frame(played, 1, 0.0, 3)) > 2.5 * greens(first)
    studio.canvas.close()


@pytest.mark.parametrize("format", ["png", "gif", "mp4"])
def test_render(format, planar, tmp_path, capsys):
    out = tmp_path / f"x.{format}"
    capsys.readouterr()
    assert main.main(["render", str(planar), "--seed", "1", "--episodes", "1", "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{out}\n"
    steps = len(film.play(saved.pick(planar, "1"), 1)[0].joints) - 1
    if format == "png":
        with Image.open(out) as page:
            assert page.size == (min(5, steps + 1) * 406 - 6, 356)
    elif format == "gif":
        seconds = 0.0
        with Image.open(out) as shown:
            for frame in range(shown.n_frames):  # equal frames may be one, shown for longer
                shown.seek(frame)
                seconds += shown.info["duration"] / 1000
            assert shown.size == (480, 426)
        assert seconds == pytest.approx(0.07 * (steps * 3 + 12))
    else:
        from imageio_ffmpeg import count_frames_and_secs

        frames, seconds = count_frames_and_secs(str(out))
        assert (frames, seconds) == (steps * 5 + 20, pytest.approx((steps * 5 + 20) / 25, abs=0.1))


def test_render_without_graphics(planar, icac, tmp_path):
    """No driver for EGL: one line that names what to install."""
    nothing = {"__EGL_VENDOR_LIBRARY_FILENAMES": str(tmp_path / "none.json"), "DISPLAY": "", "MUJOCO_GL": ""}
    done = icac("render", planar, "--format", "png", env=nothing, check=2)
    assert done.stderr.count("\n") == 1, done.stderr
    assert "apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri" in done.stderr
    assert not list(planar.glob("render*"))


def test_missing_extras(planar, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    refused(capsys, ["pip install 'icac_jax[video]'"], "render", planar, "--format", "mp4")
    monkeypatch.setitem(sys.modules, "flatbuffers", None)
    monkeypatch.delitem(sys.modules, "jax._src.export.serialization", raising=False)
    refused(capsys, ["pip install 'icac_jax[export]'"], "export", planar, "--format", "jax")
    assert not list(planar.glob("policy*"))


def test_the_nodes_are_those_of_the_map(run):
    learner = saved.pick(run, "2")
    found = map_picture.nodes(learner)
    state, params = learner.agent.curiosity, learner.settings.params
    live = np.flatnonzero(state.map.live)
    assert len(found.joints) == len(live) > 2
    assert 2 * len(found.edges) == state.map.adjacency.sum()
    low, high = np.array(params.joint_low), np.array(params.joint_high)
    np.testing.assert_allclose(2 * (found.joints - low) / (high - low) - 1, state.map.weights[live], atol=1e-5)
    for row, slot in enumerate(live):
        asked = state.bank.queries[slot]
        assert found.queries[row] == asked
        if 0 < asked <= 40:  # fewer than mu: the plain mean of all errors so far
            assert found.errors[row] == pytest.approx(state.bank.errors[slot, :asked].mean(), rel=1e-5)
    for one, other in found.edges:
        assert state.map.adjacency[live[one], live[other]]


def test_plot_map(run, tmp_path):
    assert main.main(["plot-map", str(run), "--seed", "0"]) == 0
    with Image.open(run / "map-seed-0.png") as page:
        assert min(page.size) > 600
    assert main.main(["plot-map", str(run), "--seed", "0", "--out", str(tmp_path / "m.svg")]) == 0
    assert "<svg" in (tmp_path / "m.svg").read_text()[:2000]
    figure = map_picture.figure(saved.pick(run, "0"))
    panels = {"planar2": 2, "nico4": 16}[folder.load(run).run.arm]
    assert len(figure.axes) == panels + 2  # and two colour bars


def test_a_single_predictor_is_plotted_too(planar):
    learner = saved.pick(planar, "0")
    settings = learner.settings
    spec = settings.spec.__class__(**settings.spec.__dict__ | {"predictors": "single"})
    state = jax.device_get(curiosity.init(spec, jax.random.key(0), settings.hyper.traced()))
    learner = learner._replace(agent=learner.agent.replace(curiosity=state))
    assert np.all(map_picture.nodes(learner).queries == 0)
    assert np.all(np.isnan(map_picture.nodes(learner).errors))
    assert map_picture.figure(learner) is not None


def greedy_actions(learner):
    """What the learner does without exploration, for a batch of observations."""
    agent, hyper = build.agent(learner.settings), learner.settings.hyper.traced()
    state = jax.tree.map(jnp.asarray, learner.agent)
    return jax.vmap(lambda seen: agent.greedy(state, seen, hyper))


@pytest.mark.parametrize("algo_run", ["planar", "nico", "without_map"])
def test_a_policy_file_acts_the_same_without_jax(algo_run, request, tmp_path):
    run = request.getfixturevalue(algo_run)
    out = tmp_path / "policy.npz"
    assert main.main(["export", str(run), "--seed", "1", "--out", str(out)]) == 0
    learner = saved.pick(run, "1")
    settings, arm = learner.settings, learner.settings.arm
    rng = np.random.default_rng(0)
    low, high = np.array(settings.params.joint_low), np.array(settings.params.joint_high)
    joints = rng.uniform(low, high, (200, arm.joints))
    goals = oracle.tips(arm, np.radians(rng.uniform(low, high, joints.shape)))
    np.savez(tmp_path / "cases.npz", joints=joints, goals=goals)
    code = f"""
import sys
for name in ("jax", "jaxlib", "flax", "mujoco", "icac_jax"):
    sys.modules[name] = None
sys.path.insert(0, {str(ROOT / "docs")!r})
import numpy as np
from policy_reader import Policy
policy, cases = Policy("policy.npz"), np.load("cases.npz")
space = policy.header["observation"]
low, high = (np.array(space["joint_" + end] + space["goal_" + end]) for end in ("low", "high"))
raw = np.hstack([cases["joints"], cases["goals"][:, space["goal_axes"]]])
seen = 2 * (raw - low) / (high - low) - 1
moves = [policy.move(joints, goal) for joints, goal in zip(cases["joints"], cases["goals"])]
np.savez("answers.npz", seen=seen, actions=[policy.act(one) for one in seen], moves=moves)
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)
    answers = np.load(tmp_path / "answers.npz")
    world_params = settings.params.traced()
    wanted = greedy_actions(learner)(jnp.asarray(answers["seen"], jnp.float32))
    np.testing.assert_allclose(answers["actions"], wanted, atol=1e-6)
    # The environment itself makes the same observations and the same moves of joints and goals.
    world = reach.make(arm, "kinematic", settings.run.sub_steps)
    zero = jnp.zeros(arm.joints)
    for number in range(5):
        before = reach.ReachState(jnp.radians(joints[number]), zero, jnp.asarray(goals[number]), jnp.int32(0))
        still = world.step(before, zero, world_params)[1].observation
        np.testing.assert_allclose(still, answers["seen"][number], atol=1e-5)
        moved = world.step(before, wanted[number], world_params)[0].joints
        np.testing.assert_allclose(np.degrees(moved), answers["moves"][number], atol=1e-3)


def test_the_header_of_a_policy_file(nico):
    learner = saved.pick(nico, "2")
    head = json.loads(export.arrays(learner)["header"].tobytes())
    assert (head["format"], head["format_version"], head["arm"], head["seed"]) == ("icac_jax policy", 1, "nico4", 2)
    assert head["joints"] == ["r_shoulder_z", "r_shoulder_y", "r_arm_x", "r_elbow_y"]
    assert head["observation"]["joint_low"] == [-100, -180, -140, -100]
    assert head["network"]["sizes"] == [7, 12, 4]
    assert (head["action"]["bound"], head["episodes"], head["algo"]) == (10, 10, "icac")
    assert set(head["versions"]) == {"icac_jax", "jax", "mujoco", "numpy"}
    assert len((ROOT / "docs" / "policy_reader.py").read_text().splitlines()) <= 30


@pytest.mark.skipif(importlib.util.find_spec("flatbuffers") is None, reason="jax.export writes with flatbuffers")
def test_the_jax_artifact(planar, tmp_path):
    out = tmp_path / "p.jaxexport"
    assert main.main(["export", str(planar), "--seed", "0", "--format", "jax", "--out", str(out)]) == 0
    from jax import export as jax_export

    again = jax_export.deserialize(bytearray(out.read_bytes()))
    learner = saved.pick(planar, "0")
    for batch in (1, 37):
        seen = jax.random.uniform(jax.random.key(0), (batch, 4), minval=-1.0)
        np.testing.assert_allclose(again.call(seen), greedy_actions(learner)(seen), atol=1e-6)


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ("render", ["run: must be the folder of a run"]),
        ("render absent", ["run: there is no folder absent"]),
        ("render RUN --seed 3", ["seed: must be best or a whole number from 0 to 2, got '3'"]),
        ("render RUN --seed -1", ["seed: must be best or"]),
        ("render RUN --seed first", ["seed: must be best or", "'first'"]),
        ("render RUN --episodes 0", ["episodes: must be a whole number at least 1"]),
        ("render RUN --pair-seed -1", ["pair_seed: must be"]),
        ("render RUN --format avi", ["format: must be one of mp4, gif, png, got 'avi'"]),
        ("render RUN --out x.avi", ["format: must be one of mp4, gif, png, got 'avi'"]),
        ("render RUN --format gif --out x.png", ["out: must end in .gif"]),
        ("render RUN --format png --out no/where/x.png", ["out: cannot write no/where/x.png"]),
        ("plot-map RUN --out x.pdf", ["out: must end in .png or .svg, got x.pdf"]),
        ("plot-map PLAIN", ["run: cacla has no map, which only a learner with curiosity has"]),
        ("plot-map", ["run: must be the folder of a run"]),
        ("export", ["run: must be the folder of a run"]),
        ("export RUN --format tflite", ["format: must be one of folder, npz, jax, onnx, got 'tflite'"]),
        ("export RUN --out no/where.npz", ["out: cannot write"]),
    ],
)
def test_wrong_input(args, words, planar, without_map, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    places = {"RUN": planar, "PLAIN": without_map}
    refused(capsys, words, *[places.get(arg, arg) for arg in args.split()])
    assert list(tmp_path.iterdir()) == []


def test_a_seed_that_failed_is_refused(planar, capsys, monkeypatch):
    newest = evaluate.newest(planar, folder.load(planar))
    inside = newest.lanes.agent.agent
    actor = np.array(inside.actor)
    actor[1, 3] = np.nan
    agent = newest.lanes.agent.replace(agent=inside.replace(actor=actor))
    monkeypatch.setattr(evaluate, "newest", lambda *_: newest._replace(lanes=newest.lanes.replace(agent=agent)))
    refused(capsys, ["seed: seed 1 diverged, take another"], "export", planar, "--seed", 1)
    assert saved.pick(planar, "0").seed == 0


@pytest.mark.parametrize("command", ["render", "plot-map", "export"])
def test_help(command, capsys):
    assert main.main([command, "--help"]) == 0
    said = capsys.readouterr().out
    run = "[RUN]" if command == "render" else "RUN"  # a policy of the package needs none
    assert said.startswith(f"usage: icac {command} {run} [OPTIONS]")
    assert max(map(len, said.splitlines())) <= 130
