"""Pictures drawn in JAX, encoders of them, and runs whose learners see pictures instead of joints."""

import importlib.util
import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

import icac_jax
from icac_jax.cli import main
from icac_jax.envs import arms, capsules, drawing
from icac_jax.envs.model import load_model, mujoco
from icac_jax.envs.pictures import Renderer
from icac_jax.errors import ConfigError
from icac_jax.reports.statistics import Estimate
from icac_jax.runs import build, checkpoints, encoders, folder, train
from icac_jax.settings import encoder_files
from icac_jax.settings.options import resolve
from icac_jax.sweeps import sweep_file
from tests.conftest import here

SMALL = {"picture_size": 16, "latent_size": 3, "pictures": 100, "steps": 3}
TINY = {"physics": "kinematic", "seeds": 2, "episodes": 6, "horizon": 10, "map_capacity": 16}
TD3 = {"physics": "kinematic", "hidden_units": 8, "batch_size": 8, "warm_up": 20, "buffer_size": 64}
POSES = {
    "planar2": [(0.3, 0.9), (1.5, 1.5), (2.8, 0.1)],
    "nico4": [(0.1, 0.2, -0.3, 0.4), (-0.9, -1.1, 0.6, 0.9), (0.8, 1.2, -1.0, -0.6)],
}


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("encoder") / "some.npz"
    icac_jax.encode("planar2", path, **SMALL)
    return path


def by_numpy(arm, size, joints, softness):
    """A picture by MuJoCo's kinematics and one pixel after the other."""
    model = load_model(arm)
    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(model, data)
    found, seen = capsules.of_arm(arm), drawing.window(arm)
    picture = np.zeros((len(seen.axes), size, size))
    for view, axes in enumerate(seen.axes):
        for row in range(size):
            for column in range(size):
                across, up = (2 * column + 1) / size - 1, 1 - (2 * row + 1) / size
                pixel = seen.centre[axes] + seen.half * np.array([across, up])
                gaps = []
                for bodies, ends, radius in zip(*found, strict=True):
                    pairs = zip(bodies, ends, strict=True)
                    a, b = ((data.xpos[k] + data.xmat[k].reshape(3, 3) @ end)[axes] for k, end in pairs)
                    length = np.sum((b - a) ** 2)
                    share = np.clip((pixel - a) @ (b - a) / length, 0, 1) if length else 0.0
                    gaps.append(np.linalg.norm(pixel - a - share * (b - a)) - radius)
                picture[view, row, column] = 1 / (1 + np.exp(min(gaps) / (softness * 2 * seen.half / size)))
    return picture


@pytest.mark.parametrize("name", POSES)
def test_a_picture_is_that_of_the_equations(name):
    arm = arms.get(name)
    drawn = jax.jit(jax.vmap(drawing.camera(arm, 16).arm))(jnp.array(POSES[name]))
    for joints, picture in zip(POSES[name], drawn, strict=True):
        np.testing.assert_allclose(picture, by_numpy(arm, 16, joints, drawing.SOFTNESS), atol=2e-4)
        assert picture.max() > 0.3
        assert picture.mean() < 0.2


def silhouette(arm, size, joints):
    """What MuJoCo draws of the moving parts of an arm, from far away: [V, size, size] bool."""
    model = load_model(arm)
    moving = model.body_weldid[model.geom_bodyid] != 0
    model.geom_group[:] = np.where(moving, 0, 5)
    model.site_group[:] = 5
    model.vis.global_.offwidth = model.vis.global_.offheight = size
    seen, data = drawing.window(arm), mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_forward(model, data)
    try:
        renderer = Renderer(model, size, size)
    except ConfigError as error:
        pytest.skip(f"this machine cannot draw: {error}")
    renderer._option.geomgroup[:], renderer._option.sitegroup[:] = [1, 0, 0, 0, 0, 0], 0
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT.value] = 1
    views, far = [], 10.0
    for axes in seen.axes:
        right, up = np.eye(3)[axes]
        eye = mujoco.MjvCamera()
        renderer.update(data, eye)
        for gl in renderer.scene.camera:
            gl.pos[:], gl.forward[:], gl.up[:] = seen.centre + far * np.cross(right, up), -np.cross(right, up), up
            gl.orthographic, gl.frustum_center, gl.frustum_near, gl.frustum_far = 1, 0, 0.01, 2 * far
            gl.frustum_width, gl.frustum_bottom, gl.frustum_top = seen.half, -seen.half, seen.half
        views.append(renderer.picture().any(axis=-1))
    renderer.close()
    return np.stack(views)


@pytest.mark.parametrize("name", POSES)
def test_a_picture_is_that_of_mujoco(name):
    """Intersection over union with MuJoCo's own silhouette; a cylinder has edges where its capsule has caps."""
    arm, size = arms.get(name), 128
    mine = jax.jit(jax.vmap(drawing.camera(arm, size).arm))(jnp.array(POSES[name])) > 0.5
    for joints, picture in zip(POSES[name], np.asarray(mine), strict=True):
        theirs = silhouette(arm, size, joints)
        for view, other in zip(picture, theirs, strict=True):
            assert (view & other).sum() / (view | other).sum() > 0.85


def test_gradients_are_finite_and_point_to_where_the_arm_was():
    camera = drawing.camera(arms.get("planar2"), 16)
    draw = jax.jit(camera.arm)
    wanted = draw(jnp.array([0.9, 1.1]))
    loss = jax.jit(jax.value_and_grad(lambda joints: jnp.sum((camera.arm(joints) - wanted) ** 2)))
    for joints in ([0.0, 0.0], [np.pi / 2, np.pi], [0.9, 1.1]):  # folded up and stretched out too
        assert np.all(np.isfinite(loss(jnp.array(joints))[1]))
    joints = jnp.array([0.85, 1.15])
    before, gradient = loss(joints)
    assert loss(joints - 1e-3 * gradient)[0] < before
    assert np.all(np.isfinite(jax.jit(jax.grad(lambda place: jnp.sum(camera.goal(place))))(jnp.array([1.0, 1.0, 0.0]))))


def test_an_autoencoder_learns_and_says_how_well():
    facts = icac_jax.encode(picture_size=16, latent_size=4, pictures=500, steps=300).facts
    assert facts["goal"]["error"] < 0.8  # 1 is what the mean of all pictures would have
    assert len(facts["arm"]["read_out"]) == 2
    assert np.mean(facts["goal"]["read_out"]) > 0.4


@pytest.mark.parametrize("method", ["projection", "pixels"])
def test_controls_need_no_training(method, tmp_path):
    options = SMALL | {"method": method}
    made = icac_jax.encode("planar2", tmp_path / "e.npz", **options)
    assert made.facts["arm"]["error"] is None
    read = encoders.read(tmp_path / "e.npz", arms.get("planar2"))
    camera = drawing.camera(arms.get("planar2"), 16)
    picture = jax.jit(camera.arm)(jnp.array([0.4, 0.8]))
    np.testing.assert_array_equal(read.embed("arm", picture), made.embed("arm", picture))
    assert read.size == (256 if method == "pixels" else 3)
    assert np.abs(made.embed("arm", picture)).max() < 1.5


def test_the_same_options_give_the_same_file(file):
    assert encoders.content(icac_jax.encode("planar2", **SMALL)._replace(facts={})) == encoders.content(
        encoders.read(file, arms.get("planar2"))._replace(facts={})
    )


def test_files_that_are_refused(file, tmp_path):
    content = bytearray(file.read_bytes())
    bad = tmp_path / "bad.npz"
    for place in (len(content) // 3, len(content) // 2, len(content) - 30):
        altered = bytearray(content)
        altered[place] ^= 0x40
        bad.write_bytes(altered)
        with pytest.raises(ConfigError, match=r"^encoder: .*bad\.npz is no readable encoder \(.*\)$"):
            resolve(encoder=str(bad))
    bad.write_bytes(content[:-100])
    with pytest.raises(ConfigError, match="no readable encoder"):
        resolve(encoder=str(bad))
    with pytest.raises(ConfigError, match=r"^encoder: cannot read .*none: No such file"):
        resolve(encoder=str(tmp_path / "none"))
    with pytest.raises(ConfigError, match=r"^encoder: must be of nico4, .* is of planar2$"):
        resolve(arm="nico4", encoder=str(file))
    with pytest.raises(ConfigError, match=r"^demonstrations: must be none with encoder"):
        resolve(encoder=str(file), demonstrations="oracle")
    with pytest.raises(ConfigError, match=r"^coverage_bins: must be 0 with encoder"):
        resolve(encoder=str(file), coverage_bins=3)
    other = encoders.read(file, arms.get("planar2"))
    weights = other.weights | {"arm": dict(other.weights["arm"]) | {"example": np.zeros((1, 16, 16), np.float32)}}
    encoders.write(bad, other._replace(weights=weights))
    with pytest.raises(ConfigError, match=r"^encoder: must be of this planar2, .* was made for another of that name$"):
        build.environment(resolve(encoder=str(bad)))


def test_the_world_is_the_same_and_seen_otherwise(file):
    settings = resolve(**TINY, encoder=str(file))
    env, plain = build.environment(settings), build.environment(resolve(**TINY))
    assert (env.observation_size, env.state_size, env.goal.size) == (6, 3, 6)
    assert build.environment(resolve(**TINY, encoder=str(file))) is env
    key, params, action = jax.random.key(3), settings.params.traced(), jnp.array([0.5, -0.2])

    @jax.jit
    def both(key):
        found = []
        for world in (env, plain):
            state, first = world.init(key, params)
            found.append((state, first, *world.step(state, action, params)))
        return found

    (state, first, moved, seen), (state2, _, moved2, seen2) = both(key)
    np.testing.assert_allclose(moved.joints, moved2.joints)
    np.testing.assert_allclose(state.goal, state2.goal)
    assert (seen.reward, seen.terminated) == (seen2.reward, seen2.terminated)
    np.testing.assert_array_equal(first[3:], seen.observation[3:])
    assert np.abs(first[:3] - seen.observation[:3]).max() > 1e-3
    # A goal at the tip is reached, and looks as the embedding of a goal there.
    achieved = env.goal.achieved(moved)
    assert env.goal.reached(achieved, achieved, params)
    assert not env.goal.reached(achieved, achieved + jnp.array([1.0, 0, 0, 0, 0, 0]), params)
    relabelled = env.goal.relabel(seen.observation, achieved)
    np.testing.assert_array_equal(relabelled[:3], seen.observation[:3])
    embedding = encoders.read(file, settings.arm)
    goal = jax.jit(drawing.camera(settings.arm, 16).goal)(plain.goal.achieved(moved2))
    wanted = embedding.embed("goal", goal)
    np.testing.assert_allclose(relabelled[3:], wanted, atol=1e-5)


def test_resumed_exactly_from_its_own_copy(file, tmp_path):
    options = TD3 | {"algo": "td3", "hindsight": "future", "seeds": 2, "episodes": 8, "horizon": 10}
    elsewhere = shutil.copy(file, tmp_path / "given.npz")
    train.train(resolve(**options, encoder=str(elsewhere)), tmp_path / "whole")
    train.train(resolve(**options | {"episodes": 4}, encoder=str(elsewhere)), tmp_path / "part")
    elsewhere.unlink()
    moved = (tmp_path / "part").rename(tmp_path / "moved")
    assert 'encoder = "encoder.npz"' in (moved / folder.CONFIG).read_text()
    train.resume(moved, episodes=8)
    whole, part = (pq.read_table(run / "episodes.parquet") for run in (tmp_path / "whole", moved))
    assert whole.equals(part)
    newest = [checkpoints.listed(run / folder.CHECKPOINTS)[-1] for run in (tmp_path / "whole", moved)]
    one, other = (np.load(path) for path in newest)
    states = [name for name in one.files if name.startswith("agent.")]
    assert states
    for name in states:
        np.testing.assert_array_equal(one[name], other[name])
    found = here("evaluate", moved, "--pairs", 3)
    assert found.returncode == 0, found.stderr
    for command in ("export", "plot-map"):
        refused = here(command, moved, "--seed", 0)
        assert refused.returncode == 2
        assert "see pictures (encoder)" in refused.stderr
    (moved / folder.ENCODER).write_bytes(b"x")
    with pytest.raises(ConfigError, match=r"encoder: .* is not what it was when the run began"):
        train.resume(moved, episodes=9)


def test_python_door_and_a_sweep(file, tmp_path):
    run = icac_jax.train("planar2", "icac", encoder=str(file), progress=False, **TINY)
    assert run.policy(0)(np.zeros(6)).shape == (2,)
    assert np.isfinite(run.episodes["steps"]).all()
    text = 'algo = "cacla"\n' + "\n".join(f"{name} = {TINY[name]!r}" for name in TINY if name != "map_capacity")
    (tmp_path / "s.toml").write_text(f'[base]\n{text}\n[grid]\nencoder = ["", "{file}"]\n')
    assert [cell.settings.camera.encoder for cell in sweep_file.read(tmp_path / "s.toml").cells()] == ["", str(file)]
    done = here("sweep", tmp_path / "s.toml", "--out", tmp_path / "sweep")
    assert done.returncode == 0, done.stderr
    rows = pq.read_table(tmp_path / "sweep" / "episodes.parquet").to_pandas()
    assert len(rows) == 2 * TINY["seeds"] * TINY["episodes"]


def test_the_command(tmp_path, capsys):
    out = tmp_path / "e.npz"
    words = [f"--{name.replace('_', '-')}={value}" for name, value in SMALL.items()]
    assert main.main(["encode", "--arm", "planar2", "--out", str(out), *words]) == 0
    said = capsys.readouterr().out
    assert "R^2 of a linear read-out" in said
    assert out.with_suffix(".png").stat().st_size > 10_000
    assert encoder_files.found(resolve(encoder=str(out)).camera, arms.get("planar2")).encoder_sha256
    assert main.main(["encode", "--picture-size", "20"]) == 2
    assert "picture_size: must be a multiple of 8" in capsys.readouterr().err
    assert main.main(["encode", "--arm", "planar3", *words]) == 2
    assert main.main(["encode", "--help"]) == 0
    assert "--latent-size" in capsys.readouterr().out


def test_the_rules_of_the_study():
    path = Path(__file__).resolve().parents[1] / "examples" / "camera.py"
    found = importlib.util.spec_from_file_location("camera_study", path)
    study = importlib.util.module_from_spec(found)
    found.loader.exec_module(study)
    said = [study.learns(Estimate(*one)) for one in ((0.97, 0.93, 1), (0.97, 0.88, 1), (0.94, 0.92, 0.96))]
    assert said == ["learns", "does not", "does not"]
    differences = ((-0.1, -0.2, -0.01), (0.1, 0.02, 0.2), (0.01, -0.02, 0.04), (0.1, -0.1, 0.3))
    said = [study.decided(Estimate(*one)) for one in differences]
    assert said == ["costs success", "gains success", "makes no difference", "undecided"]
    reached = {("td3", sight): np.full((3, 20), sight != "projection", float) for sight in study.SIGHTS}
    nodes = {"joints": [5], "embedding": [8], "projection": [20], "pixels": [17]}
    page = study.markdown(reached, dict.fromkeys(reached, 1e-3), nodes, dict.fromkeys(nodes, 0.9))
    assert "| TD3 + HER | embedding | projection | +100.0% [+100.0%, +100.0%] | **gains success** |" in page
    assert "| TD3 + HER | projection | 0.0% [0.0%, 0.0%] | **does not** | 1000 |" in page
    assert "in the pixels: **holds**" in page
    page = study.markdown(reached, dict.fromkeys(reached, 1e-3), nodes | {"pixels": [9]}, dict.fromkeys(nodes, 0.9))
    assert "in the pixels: **does not hold**" in page
