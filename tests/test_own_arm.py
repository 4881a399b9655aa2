"""An arm of one's own: the example, what its file may leave out, and every way in which it can be wrong."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from icac_jax.agents import registry
from icac_jax.cli import main
from icac_jax.envs import oracle, reach
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import joint_names, load_model
from icac_jax.fields import ConfigError
from icac_jax.runs import folder
from icac_jax.settings import arm_files
from icac_jax.settings.options import defaults, resolve

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "own_arm"
TINY = ["--physics", "kinematic", "--seeds", "2", "--episodes", "4", "--map-capacity", "16"]


@pytest.fixture
def arm(tmp_path):
    """A copy of the example to spoil; returns its TOML file."""
    shutil.copytree(EXAMPLE, tmp_path / "own")
    return tmp_path / "own" / "arm.toml"


def edited(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_the_example():
    settings = resolve(arm=str(EXAMPLE / "arm.toml"))
    own = settings.arm
    assert (own.name, own.joints, own.tip, own.goal_radius, own.goal_reward) == ("arm7", 7, "fingertip", 0.1, 100.0)
    assert settings.params.joint_low == own.joint_low == (-160, -20, -150, 0, -150, -100, -150)
    assert settings.params.joint_high == own.joint_high == (160, 110, 150, 140, 150, 100, 150)
    assert (settings.params.horizon, settings.run.episodes, settings.hyper.sigma) == (40, 5000, 1.0)
    assert (settings.params.reset_range, own.observation_size, own.joints) == (0.35, 10, 7)
    assert resolve(**settings.flat()) == settings
    # The goal box holds nearly every tip there is, and not much more.
    joints = np.random.default_rng(5).uniform(np.radians(own.joint_low), np.radians(own.joint_high), (4000, 7))
    tips = oracle.tips(own, joints)
    assert np.mean(np.all((tips >= own.goal_low) & (tips <= own.goal_high), axis=1)) > 0.999
    assert np.all(np.ptp(tips, axis=0) > 0.9 * np.subtract(own.goal_high, own.goal_low))


def test_what_may_be_left_out(arm):
    text = arm.read_text()
    optional = r"(?m)^(name|goal_radius|goal_reward|episodes|horizon|reset_range|e_max|\[defaults\]).*\n"
    arm.write_text(re.sub(optional, "", text))
    settings = resolve(arm=str(arm))
    assert (settings.arm.name, settings.arm.goal_reward) == ("arm", 100.0)
    assert 0.08 < settings.arm.goal_radius < 0.12  # an eighth of about 0.8 m
    assert (settings.run.episodes, settings.params.horizon, settings.spec.map_capacity) == (15000, 50, 128)
    arm.write_text('goal_axes = ["z", "x"]\ngoal_low = [0, -1]\ngoal_high = [2, 1.5]\n' + arm.read_text())
    own = resolve(arm=str(arm)).arm
    assert (own.goal_axes, own.goal_low, own.goal_high) == ((2, 0), (0.0, -1.0), (2.0, 1.5))
    arm.write_text(f"joint_low = {[0] * 7}\njoint_high = {[30] * 7}\n" + arm.read_text())
    assert resolve(arm=str(arm)).params.joint_high == (30.0,) * 7


@pytest.mark.parametrize("algo", registry.LEARNERS)
def test_its_defaults_hold_for_every_learner_that_has_them(arm, algo):
    arm.write_text(arm.read_text() + "hidden_units = 20\nbeta = 0.5\nmap_capacity = 40\n")
    settings = resolve(arm=str(arm), algo=algo)
    if hasattr(settings.hyper, "beta"):
        assert (settings.spec.hidden_units, settings.hyper.beta) == (20, 0.5)
    else:  # an option of its own that has the same name
        assert settings.spec.hidden_units == 64
    assert getattr(settings.spec, "map_capacity", 40) == 40


WRONG = {
    "no toml": (lambda arm: arm.unlink(), ["arm: cannot read", "arm.toml", "No such file"]),
    "toml that is none": (lambda arm: arm.write_text("model ="), ["arm.toml is not valid TOML"]),
    "unknown key": (lambda arm: edited(arm, "tip =", "tipp ="), ["tipp: no such key; did you mean tip?"]),
    "wrong type": (
        lambda arm: edited(arm, "goal_radius = 0.1", 'goal_radius = "x"'),
        ["goal_radius: must be a number"],
    ),
    "no model key": (lambda arm: edited(arm, 'model = "arm7.xml"', ""), ["model: must be given"]),
    "no joints key": (lambda arm: arm.write_text('model = "arm7.xml"'), ["joints: must be given"]),
    "no model file": (lambda arm: arm.with_name("arm7.xml").unlink(), ["model: there is no file", "arm7.xml"]),
    "model that is no XML": (lambda arm: arm.with_name("arm7.xml").write_text("<mujoco"), ["model:", "not valid XML"]),
    "model that does not load": (
        lambda arm: edited(arm.with_name("arm7.xml"), 'type="hinge"', 'type="spring"'),
        ["model:", "does not load", "spring"],
    ),
    "unknown joint": (
        lambda arm: edited(arm, '"elbow_pitch"', '"elbow"'),
        ["joints:", "has no joint 'elbow', it has base_yaw, shoulder_pitch"],
    ),
    "joint left out": (
        lambda arm: edited(arm, '"wrist_roll",', ""),
        ["joints: must name every joint of", "'wrist_roll' is missing"],
    ),
    "other order": (
        lambda arm: edited(arm, '"base_yaw", "shoulder_pitch"', '"shoulder_pitch", "base_yaw"'),
        ["joints: must be those of", "in its order, base_yaw, shoulder_pitch"],
    ),
    "ball joint": (
        lambda arm: edited(
            arm.with_name("arm7.xml"), '"wrist_roll" axis="0 0 1" range="-150 150"', '"wrist_roll" type="ball"'
        ),
        ["joints: must be hinges, 'wrist_roll'", "is a ball joint"],
    ),
    "slide joint": (
        lambda arm: edited(arm.with_name("arm7.xml"), '"wrist_roll" axis', '"wrist_roll" type="slide" axis'),
        ["joints: must be hinges, 'wrist_roll'", "is a slide joint"],
    ),
    "no tip": (
        lambda arm: edited(arm, 'tip = "fingertip"', 'tip = "nose"'),
        ["tip:", "has no site 'nose', it has fingertip"],
    ),
    "unlimited joint": (
        lambda arm: edited(arm.with_name("arm7.xml"), ' axis="0 1 0" range="0 140"', ' axis="0 1 0"'),
        ["joint_low: joint 'elbow_pitch' has no range in the model; give joint_low and joint_high"],
    ),
    "half a range": (
        lambda arm: arm.write_text(f"joint_low = {[0] * 7}\n" + arm.read_text()),
        ["joint_low and joint_high must be given both or neither"],
    ),
    "too few limits": (
        lambda arm: arm.write_text("joint_low = [0]\njoint_high = [1]\n" + arm.read_text()),
        ["joint_low: must be 7 numbers"],
    ),
    "limits the wrong way": (
        lambda arm: arm.write_text(f"joint_low = {[10] * 7}\njoint_high = {[0] * 7}\n" + arm.read_text()),
        ["joint_low: must be less than joint_high"],
    ),
    "unknown axis": (
        lambda arm: edited(arm, "tip =", 'goal_axes = ["w"]\ntip ='),
        ["goal_axes: must be some of x, y, z"],
    ),
    "short goal box": (lambda arm: edited(arm, "tip =", "goal_low = [0]\ntip ="), ["goal_low: must be 3 numbers"]),
    "empty goal box": (
        lambda arm: edited(arm, "tip =", "goal_low = [9, 9, 9]\ntip ="),
        ["goal_low is not below goal_high"],
    ),
    "axis without motion": (
        lambda arm: edited(arm, "tip =", f"joint_low = {[0] * 7}\njoint_high = {[1e-6] * 7}\ntip ="),
        ["goal_axes: along x the tip does not move"],
    ),
    "name of a shipped arm": (
        lambda arm: edited(arm, '"arm7"\n', '"planar2"\n'),
        ["name: must be letters", "'planar2'"],
    ),
    "unknown default": (lambda arm: edited(arm, "horizon =", "horison ="), ["horison: no such option"]),
    "wrong default": (lambda arm: edited(arm, "horizon = 40", "horizon = 0"), ["horizon: must be a whole number"]),
    "default that is a key": (lambda arm: edited(arm, "horizon = 40", "goal_radius = 1"), ["defaults: goal_radius"]),
    "no actuator": (
        lambda arm: edited(arm.with_name("arm7.xml"), '<position name="wrist_roll" joint="wrist_roll"/>', ""),
        ["physics: servo needs a position actuator a joint", "'wrist_roll'", "kinematic needs none"],
    ),
    "a motor": (
        lambda arm: edited(arm.with_name("arm7.xml"), "position name", "motor name"),
        ["physics: servo needs a position actuator a joint", "'base_yaw'"],
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong(name, arm, capsys, monkeypatch):
    monkeypatch.chdir(arm.parent)
    spoil, words = WRONG[name]
    spoil(arm)
    assert main.main(["train", "--arm", "arm.toml"]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1), said.err
    for word in words:
        assert word in said.err
    assert not Path("runs").exists()


def test_a_preset_that_an_own_arm_has_not():
    with pytest.raises(ConfigError, match="preset: must be one of paper, best, got 'paper-literal'"):
        defaults(str(EXAMPLE / "arm.toml"), "paper-literal")


def test_kinematic_physics_needs_no_actuators(arm):
    text = arm.with_name("arm7.xml").read_text()
    arm.with_name("arm7.xml").write_text(re.sub(r"(?s)<actuator>.*</actuator>", "", text))
    assert resolve(arm=str(arm), physics="kinematic").arm.joints == 7


def test_an_arm_from_python():
    """Without a TOML file: an ArmSpec with the path of a model."""
    own = ArmSpec(
        name="mine",
        model=str(EXAMPLE / "arm7.xml"),
        goal_axes=(0, 1, 2),
        goal_low=(-1.0, -1.0, 0.0),
        goal_high=(1.0, 1.0, 1.2),
        joint_low=(-90.0,) * 7,
        joint_high=(90.0,) * 7,
        goal_radius=0.1,
        goal_reward=1.0,
        tip="fingertip",
    )
    assert joint_names(own)[0] == "base_yaw"
    assert reach.make(own, "kinematic") is reach.make(own, "kinematic")
    with pytest.raises(ConfigError, match="model: there is no file /absent"):
        load_model(ArmSpec(**vars(own) | {"model": "/absent.xml"}))
    with pytest.raises(ConfigError, match=r"tip: .* has no site 'tip', it has fingertip"):
        load_model(ArmSpec(**vars(own) | {"tip": "tip"}))
    with pytest.raises(ConfigError, match="joints: must be those of"):
        load_model(ArmSpec(**vars(own) | {"joint_low": (0.0,), "joint_high": (1.0,)}))


def test_files_of_the_model_count(arm):
    """A mesh or an included file that changes changes the checksum; a folder moved as a whole does not."""
    (arm.parent / "meshes").mkdir()
    mesh, part = arm.parent / "meshes" / "cube.obj", arm.parent / "part.xml"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    part.write_text('<mujocoinclude><mesh name="cube" file="cube.obj"/></mujocoinclude>')
    model = arm.with_name("arm7.xml")
    edited(model, 'autolimits="true"', 'autolimits="true" meshdir="meshes"')
    edited(model, "<asset>", '<asset><include file="part.xml"/>')
    first = arm_files.find(str(arm)).sha256
    shutil.copytree(arm.parent, arm.parent.with_name("moved"))
    assert arm_files.find(str(arm.parent.with_name("moved") / "arm.toml")).sha256 == first
    mesh.write_text(mesh.read_text().replace("1 0 0", "2 0 0"))
    second = arm_files.find(str(arm)).sha256
    part.write_text(part.read_text() + "\n")
    third = arm_files.find(str(arm)).sha256
    assert len({first, second, third}) == 3


def test_a_run_from_another_folder_and_a_changed_arm(arm, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(arm.parent)
    run = tmp_path / "run"
    assert main.main(["train", "--arm", "arm.toml", *TINY, "--out", str(run)]) == 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    # The arm's files went along: where the original is, and what it is now, does not count.
    assert folder.load(run).run.arm == str(run / "arm" / "arm.toml")
    assert (run / "arm" / "arm7.xml").read_bytes() == arm.with_name("arm7.xml").read_bytes()
    assert 'arm = "arm/arm.toml"' in (run / "config.toml").read_text()
    shutil.rmtree(arm.parent)
    run = run.rename(tmp_path / "elsewhere" / "moved")
    assert main.main(["resume", str(run), "--episodes", "5"]) == 0
    assert main.main(["plot-map", str(run), "--seed", "0"]) == 0
    assert main.main(["export", str(run), "--seed", "1"]) == 0
    assert main.main(["render", str(run), "--seed", "0", "--episodes", "1", "--format", "png"]) == 0
    capsys.readouterr()
    assert main.main(["evaluate", str(run), "--pairs", "3", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["arm"] == "arm7"
    assert 1 <= result["oracle_steps"] < 10
    # The file of options gives a run too.
    assert main.main(["train", "--config", str(run / "config.toml"), "--out", "again"]) == 0
    # Another arm with the options of that file is a new run.
    options = ["--config", str(run / "config.toml"), "--arm", str(EXAMPLE / "arm.toml"), "--out", "other"]
    assert main.main(["train", *options]) == 0
    # A run whose copy was changed is refused.
    edited(run / "arm" / "arm7.xml", 'pos="0.055 0 0.095"', 'pos="0.055 0 0.195"')
    for command in (["resume", run], ["evaluate", run], ["render", run], ["train", "--config", run / "config.toml"]):
        capsys.readouterr()
        assert main.main([str(part) for part in command]) == 2
        said = capsys.readouterr()
        assert said.err.count("\n") == 1
        assert f"arm: {run}/arm/arm.toml or a file of its model is not what it was when the run began" in said.err


@pytest.mark.parametrize("value", ["[]", "{}", '"x"', "[0.1, 0.2]", "-1", "true"])
def test_defaults_of_an_arm_are_checked_as_the_options_they_are(value, tmp_path, capsys):
    folder = tmp_path / "arm"
    shutil.copytree(Path(__file__).resolve().parents[1] / "examples" / "own_arm", folder)
    text = (folder / "arm.toml").read_text()
    (folder / "arm.toml").write_text(re.sub("reset_range = [0-9.]*", f"reset_range = {value}", text))
    for args in (["train", "--arm", str(folder / "arm.toml")], ["train", "--arm", str(folder / "arm.toml"), "--help"]):
        assert main.main(args) == 2
        said = capsys.readouterr().err
        assert (said.count("\n"), "arm.toml: defaults: reset_range: must be" in said) == (1, True), said
