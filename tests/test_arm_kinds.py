"""Arms in the style of common ones: what they have beside hinges, how they are given, and what is said of the rest."""

import json
import shutil
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from icac_jax.cli import main
from icac_jax.cli.commands import common
from icac_jax.cli.commands import train as train_command
from icac_jax.envs import own_arms, reach
from icac_jax.envs import physics as physics_of
from icac_jax.envs.model import check_actuators, has_contacts, load_model
from icac_jax.fields import ConfigError
from icac_jax.runs import folder
from icac_jax.settings import arm_files
from icac_jax.settings.options import defaults, resolve

TINY = ["--algo", "cacla", "--seeds", "1", "--episodes", "1"]  # each arm is a program, and that of cacla is small
CUBE = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
URDF = """<robot name="r">
<link name="base"/>
<link name="arm"><inertial><mass value="1"/><origin xyz="0 0 .1"/>
  <inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="hand"><inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>
</link>
<link name="tool0"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
  <limit lower="-6.28319" upper="6.28319" effort="1" velocity="1"/></joint>
<joint name="wrist" type="continuous"><parent link="arm"/><child link="hand"/><origin xyz=".3 0 0"/><axis xyz="0 0 1"/>
</joint>
<joint name="flange" type="fixed"><parent link="hand"/><child link="tool0"/><origin xyz=".2 0 0"/></joint>
</robot>"""


def mjcf(
    option="", asset="", compiler='<compiler autolimits="true"/>', base="", geom="", joint='range="-100 100"', rest=""
):
    """Two hinges, links of 0.3 and 0.2 m along x, a site at the end."""
    return f"""<mujoco>{compiler}<option timestep="0.01">{option}</option><asset>{asset}</asset><worldbody>{base}
    <body name="upper"><joint name="a" axis="0 1 0" {joint}/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".03"/>
    <body name="lower" pos=".3 0 0"><joint name="b" axis="0 0 1" {joint}/>
      <geom type="cylinder" fromto=".05 0 0 .2 0 0" size=".02"/>{geom}<site name="end" pos=".2 0 0"/>
    </body></body></worldbody>{rest}</mujoco>"""


FREE = mjcf().replace('<body name="upper">', '<body><freejoint/><geom size=".1"/><body name="upper">')
FREE = FREE.replace("</worldbody>", "</body></worldbody>")
SERVOS = '<actuator><position joint="a" kp="50" kv="5"/><position joint="b" kp="50" kv="5"/></actuator>'


def model(path, **parts):
    path.write_text(mjcf(**parts))
    return str(path)


def toml(path, **parts):
    """A TOML file beside such a model."""
    model(path.with_name("arm.xml"), **parts)
    path.write_text('model = "arm.xml"\njoints = ["a", "b"]\ntip = "end"\n')
    return str(path)


def refused(capsys, *command):
    """The one line that a command says when it refuses."""
    capsys.readouterr()
    assert main.main([str(part) for part in command]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1), said.err
    return said.err


def tip_of(arm, joints):
    return np.asarray(physics_of.tip_function(arm)(jnp.asarray(joints, jnp.float32)))


@pytest.mark.parametrize(
    ("compiler", "limit", "degrees"),
    [
        ('<compiler angle="radian" autolimits="true"/>', "-6.28319 6.28319", 360.000268879),
        ('<compiler autolimits="true"/>', "-360.5 360.5", 360.5),
        ('<compiler angle="radian" autolimits="true"/>', "-12.566370614359172 12.566370614359172", 720.0),
    ],
)
def test_ranges_of_full_turns_and_more(tmp_path, compiler, limit, degrees):
    path = toml(tmp_path / "arm.toml", compiler=compiler, joint=f'range="{limit}"')
    settings = resolve(arm=path)
    np.testing.assert_allclose(settings.params.joint_low, [-degrees] * 2)
    np.testing.assert_allclose(settings.params.joint_high, [degrees] * 2)
    with pytest.raises(ConfigError, match="joint_low: must be a list of numbers at least -36000 and at most 36000"):
        resolve(arm=path, joint_low=[-36001.0, 0.0])


# What a model may have that kinematics do not need, and what of it servo is refused for.
BESIDE = {
    "energy": ({"option": '<flag energy="enable"/>'}, 'remove <flag energy="enable"/>'),
    "a cylinder that touches a mesh": (
        {
            "asset": '<mesh name="cube" file="cube.obj"/>',
            "base": '<geom type="mesh" mesh="cube" pos="1 1 1"/>',
        },
        'contacts off: <option><flag contact="disable"/></option>',
    ),
    "a margin of a mesh": (
        {
            "asset": '<mesh name="cube" file="cube.obj"/>',
            "base": '<geom type="mesh" mesh="cube" margin=".01" pos="1 1 1"/><geom size=".1"/>',
        },
        'contacts off: <option><flag contact="disable"/></option>',
    ),
    "a sensor": ({"rest": '<sensor><e_potential name="e"/><user dim="1"/></sensor>'}, None),
    "a tendon": (
        {"rest": '<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="b" coef="1"/></fixed></tendon>'},
        None,
    ),
    "an equality": ({"rest": '<equality><joint joint1="a" joint2="b"/></equality>'}, None),
}


@pytest.mark.parametrize("name", BESIDE)
def test_kinematic_physics_needs_kinematics_only(name, tmp_path):
    parts, switch = BESIDE[name]
    (tmp_path / "cube.obj").write_text(CUBE)
    parts = {"rest": "", **parts}
    parts["rest"] += SERVOS
    arm = resolve(arm=toml(tmp_path / "arm.toml", **parts), physics="kinematic").arm
    # At 90 degrees about y the arm points down, and then the lower link to the side.
    np.testing.assert_allclose(tip_of(arm, [np.pi / 2, np.pi / 2]), [0.0, 0.2, -0.3], atol=1e-6)
    reach.make(arm, "kinematic")
    if switch:
        with pytest.raises(ConfigError, match=r"^model: MJX cannot run .*; or physics kinematic") as caught:
            physics_of.step_function(arm)
        assert switch in str(caught.value)


def test_kinematics_are_those_of_the_whole_model(tmp_path):
    """Axes off the joints, reference angles, frames and static bodies: the tip is where C MuJoCo has it."""
    import mujoco

    text = mjcf(compiler='<compiler autolimits="true" angle="degree" eulerseq="zyx"/>')
    text = text.replace('<joint name="a" axis="0 1 0"', '<joint name="a" axis="1 2 -1" pos=".02 .1 0" ref="30"')
    text = text.replace('<body name="lower"', '<body name="mount" euler="10 20 30" pos=".1 0 .1"><body name="lower"')
    text = text.replace("</body></body></worldbody>", "</body></body></body></worldbody>")
    (tmp_path / "arm.xml").write_text(text)
    arm = own_arms.find(str(tmp_path / "arm.xml")).arm
    whole = load_model(arm)
    data = mujoco.MjData(whole)
    for joints in np.random.default_rng(0).uniform(-1.5, 1.5, (10, 2)):
        data.qpos[:] = joints
        mujoco.mj_kinematics(whole, data)
        np.testing.assert_allclose(tip_of(arm, joints), data.site("end").xpos, atol=1e-6)


def test_a_mesh_of_an_included_file(tmp_path, capsys):
    """`meshdir` said by an included file: the mesh counts, and goes along."""
    (tmp_path / "parts" / "shapes").mkdir(parents=True)
    mesh = tmp_path / "parts" / "shapes" / "cube.obj"
    mesh.write_text(CUBE)
    (tmp_path / "parts" / "common.xml").write_text(
        '<mujoco><compiler meshdir="parts/shapes"/><include file="more.xml"/></mujoco>'
    )
    (tmp_path / "parts" / "more.xml").write_text('<mujoco><asset><mesh name="cube" file="cube.obj"/></asset></mujoco>')
    path = toml(
        tmp_path / "arm.toml",
        compiler='<include file="parts/common.xml"/><compiler autolimits="true"/>',
        geom='<geom type="mesh" mesh="cube"/>',
    )
    first = arm_files.find(path).sha256
    mesh.write_text(CUBE.replace("v .1 0 0", "v .2 0 0"))
    assert arm_files.find(path).sha256 != first
    run = tmp_path / "run"
    assert main.main(["train", "--arm", path, *TINY, "--out", str(run)]) == 0
    assert "kinematic, the model has no actuators" in capsys.readouterr().err
    copied = sorted(str(file.relative_to(run / "arm")) for file in (run / "arm").rglob("*") if file.is_file())
    assert copied == ["arm.toml", "arm.xml", "parts/common.xml", "parts/more.xml", "parts/shapes/cube.obj"]
    assert folder.load(run).run.arm_sha256 == arm_files.find(path).sha256


def test_an_arm_that_names_files_elsewhere_travels_too(tmp_path, capsys):
    """`..` and whole paths: after the run has moved and the original is gone, nothing of it is asked for."""
    home = tmp_path / "home"
    for name in ("robot", "meshes", "config"):
        (home / name).mkdir(parents=True)
    (home / "meshes" / "cube.obj").write_text(CUBE)
    (home / "meshes" / "other.obj").write_text(CUBE)
    model(
        home / "robot" / "arm.xml",
        compiler='<compiler autolimits="true" meshdir="../meshes"/>',
        asset=f'<mesh name="cube" file="cube.obj"/><mesh name="other" file="{home}/meshes/other.obj"/>',
        geom='<geom type="mesh" mesh="cube"/><geom type="mesh" mesh="other"/>',
    )
    path = home / "config" / "arm.toml"
    path.write_text('model = "../robot/arm.xml"\njoints = ["a", "b"]\ntip = "end"\n')
    assert main.main(["train", "--arm", str(path), *TINY, "--out", str(tmp_path / "run")]) == 0
    shutil.rmtree(home)
    run = (tmp_path / "run").rename(tmp_path / "moved")
    assert str(tmp_path / "home") not in (run / "arm" / "robot" / "arm.xml").read_text()
    assert main.main(["resume", str(run), "--episodes", "2"]) == 0
    assert main.main(["evaluate", str(run), "--pairs", "2"]) == 0
    assert main.main(["train", "--config", str(run / "config.toml"), "--out", str(tmp_path / "again")]) == 0
    assert folder.load(tmp_path / "again").run.arm == str(tmp_path / "again" / "arm" / "config" / "arm.toml")


def test_an_edited_original_does_not_count(tmp_path):
    path = Path(toml(tmp_path / "arm.toml"))
    run = tmp_path / "run"
    assert main.main(["train", "--arm", str(path), *TINY, "--out", str(run)]) == 0
    path.write_text("no arm any more")
    assert main.main(["resume", str(run), "--episodes", "2"]) == 0
    assert json.loads((run / "summary.json").read_text())["episodes"] == 2


def test_a_run_of_before_goes_on_with_the_path_it_has(tmp_path, capsys):
    """Earlier versions kept only the path: such a folder goes on, and an edited arm is refused."""
    path = toml(tmp_path / "arm.toml")
    run = tmp_path / "run"
    assert main.main(["train", "--arm", path, *TINY, "--out", str(run)]) == 0
    shutil.rmtree(run / "arm")
    config = run / "config.toml"
    config.write_text(config.read_text().replace('arm = "arm/arm.toml"', f'arm = "{path}"'))
    assert main.main(["resume", str(run), "--episodes", "2"]) == 0
    assert folder.load(run).run.arm == path
    model(tmp_path / "arm.xml", geom='<geom size=".01"/>')
    assert "is not what it was when the run began" in refused(capsys, "resume", run)


def test_a_copied_config_alone_says_what_is_missing(tmp_path, capsys):
    path = toml(tmp_path / "arm.toml")
    assert main.main(["train", "--arm", path, *TINY, "--out", str(tmp_path / "run")]) == 0
    (tmp_path / "elsewhere").mkdir()
    lone = tmp_path / "elsewhere" / "config.toml"
    lone.write_text((tmp_path / "run" / "config.toml").read_text())
    assert "arm: cannot read" in refused(capsys, "train", "--config", lone)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (mjcf(base='<include file="arm.xml"/>'), ["already included"]),
        (mjcf(base='<body pos="nan 0 0"/>'), ["body pos: must be numbers, got 'nan 0 0'"]),
        (mjcf(joint='range="-1 NaN"'), ["joint range: must be numbers"]),
        (mjcf(geom='<geom size="nan"/>'), ["geom size: must be numbers"]),
        (FREE, ["joints: must be hinges, number 1", "is a free joint; fix the base"]),
        ("<mujoco>" + "<worldbody>" * 300 + "</worldbody>" * 300 + "</mujoco>", ["nested too deeply"]),
        ('<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', ["must declare no entities"]),
        ("<mujoco/>", ["tip: must be given"]),
        ('<mujoco><worldbody><site name="tip"/></worldbody></mujoco>', ["joints:", "has none"]),
        (mjcf(joint=""), None),
    ],
)
def test_models_that_are_refused_in_one_line(text, words, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(text)
    if words is None:  # joints without a range turn all the way round
        assert resolve(arm="arm.xml").params.joint_high == (180.0, 180.0)
        return
    said = refused(capsys, "train", "--arm", "arm.xml")
    for word in words:
        assert word in said
    assert not Path("runs").exists()


def test_files_that_are_none_do_not_hang(tmp_path, capsys):
    import os

    os.mkfifo(tmp_path / "pipe.obj")
    path = toml(tmp_path / "arm.toml", asset='<mesh name="m" file="pipe.obj"/>', geom='<geom type="mesh" mesh="m"/>')
    assert "pipe.obj: Not a regular file" in refused(capsys, "train", "--arm", path)
    (tmp_path / "pipe.obj").unlink()
    (tmp_path / "arm.xml").unlink()
    os.mkfifo(tmp_path / "arm.xml")
    assert "Not a regular file" in refused(capsys, "train", "--arm", path)


def test_an_arm_as_a_model_file(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model(tmp_path / "two sites.xml", geom='<site name="other" pos="0 0 .1"/>')
    said = refused(capsys, "train", "--arm", "two sites.xml")
    assert "tip: must be given, --tip NAME" in said
    assert "one of its sites: other, end" in said
    assert main.main(["train", "--arm", "two sites.xml", "--tip", "end", *TINY, "--out", "run"]) == 0
    settings = folder.load(Path("run"))
    assert (settings.run.tip, settings.arm.tip, settings.arm.name) == ("end", "end", "two-sites")
    assert settings.run.arm == str(tmp_path / "run" / "arm" / "two sites.xml")
    assert resolve(**settings.flat()) == settings
    assert main.main(["resume", "run", "--episodes", "2"]) == 0
    assert main.main(["train", "--config", "run/config.toml", "--episodes", "1", "--out", "again"]) == 0
    assert folder.load(Path("again")).arm.tip == "end"
    # A body is a tip too: the origin of its frame.
    np.testing.assert_allclose(
        tip_of(resolve(arm="two sites.xml", tip="lower").arm, [0.0, 0.3]), [0.3, 0, 0], atol=1e-6
    )
    assert "has no site 'nose', it has other, end" in refused(
        capsys, "train", "--arm", "two sites.xml", "--tip", "nose"
    )
    # Only where the arm's file does not say it.
    assert "tip: only for an arm given as a model file" in refused(capsys, "train", "--arm", "nico4", "--tip", "tip")
    own = toml(tmp_path / "arm.toml")
    assert "tip: only for an arm given as a model file" in refused(capsys, "train", "--arm", own, "--tip", "end")
    assert "tip" not in resolve().flat()


def test_an_arm_as_a_folder(tmp_path, capsys):
    (tmp_path / "own").mkdir()
    path = toml(tmp_path / "own" / "arm.toml")
    assert resolve(arm=str(tmp_path / "own")).run.arm == path
    (tmp_path / "own" / "b.toml").write_text("")
    assert "must hold one .toml file, it has arm.toml, b.toml" in refused(capsys, "train", "--arm", tmp_path / "own")
    (tmp_path / "empty").mkdir()
    assert "must hold one .toml file, it has none" in refused(capsys, "train", "--arm", tmp_path / "empty")


def test_a_urdf(tmp_path, capsys):
    path = tmp_path / "r.urdf"
    path.write_text(URDF)
    assert "one of its bodies: base, arm, hand, tool0" in refused(capsys, "train", "--arm", path)
    arm = resolve(arm=str(path), tip="tool0").arm
    assert (arm.joint_names, arm.tip) == (("shoulder", "wrist"), "tool0")
    np.testing.assert_allclose(arm.joint_low, [-360.000268879, -180.0])
    np.testing.assert_allclose(tip_of(arm, [0.0, np.pi / 2]), [0.3, 0.2, 0.0], atol=1e-6)
    assert main.main(["train", "--arm", str(path), "--tip", "tool0", *TINY, "--out", str(tmp_path / "run")]) == 0
    mesh = '<geometry><mesh filename="package://x/t.dae"/></geometry>'
    drawn = f'<link name="tool0"><visual>{mesh}</visual><collision>{mesh}</collision></link>'
    path.write_text(URDF.replace('<link name="tool0"/>', drawn))
    said = refused(capsys, "train", "--arm", path, "--tip", "tool0")
    assert "<visual> and <collision> can be removed" in said


def test_two_arms_in_one_file(tmp_path, capsys):
    """All joints are the arm's, or the line says which one is missing."""
    second = mjcf().partition("<worldbody>")[2].partition("</worldbody>")[0]
    for name in ("upper", "lower", "end", "a", "b"):
        second = second.replace(f'name="{name}"', f'name="{name}2"')
    path = toml(tmp_path / "arm.toml", base=second)
    assert "joints: must name every joint of" in refused(capsys, "train", "--arm", path)
    Path(path).write_text('model = "arm.xml"\njoints = ["a2", "b2", "a", "b"]\ntip = "end"\n')
    assert resolve(arm=path).arm.joints == 4


def test_the_default_physics_is_what_the_model_can(tmp_path):
    assert defaults(toml(tmp_path / "arm.toml"))["physics"] == "kinematic"
    with pytest.raises(ConfigError, match=r"servo needs a position actuator a joint.*'a' as number 1"):
        resolve(arm=str(tmp_path / "arm.toml"), physics="servo")
    assert defaults(toml(tmp_path / "arm.toml", rest=SERVOS))["physics"] == "servo"
    path = toml(tmp_path / "arm.toml", rest=SERVOS.replace("position", "motor").replace('kp="50" kv="5"', ""))
    with pytest.raises(ConfigError, match=r"servo needs a position actuator a joint.*'a' as number 1"):
        resolve(arm=path)


def test_slow_contacts_are_named(tmp_path, monkeypatch):
    floor = '<geom type="plane" size="2 2 .1" pos="0 0 -1"/>'
    for option, there in (("", True), ('<flag contact="disable"/>', False)):
        assert has_contacts(own_arms.find(toml(tmp_path / "arm.toml", base=floor, option=option)).arm) is there
    said = []
    monkeypatch.setattr(common, "warn", said.append)
    watch = train_command._slow_contacts()
    for seconds, steps in ((0.0, 0), (10.0, 70), (20.0, 140)):
        watch(type("Chunk", (), {"seconds": seconds, "lane_steps": steps}))
    assert len(said) == 1
    assert "takes 7 lane-steps per second" in said[0]
    assert '<flag contact="disable"/>' in said[0]
    fast = train_command._slow_contacts()
    fast(type("Chunk", (), {"seconds": 1.0, "lane_steps": 5000}))
    assert len(said) == 1


def test_an_arm_without_a_light_is_seen(tmp_path):
    """A light, a sky and a camera are added for pictures only; a model that has a light is left as it is."""
    path = toml(tmp_path / "arm.toml")
    arm = own_arms.find(path).arm
    plain, lit = load_model(arm), load_model(arm, lit=True)
    assert (plain.nlight, lit.nlight, lit.ntex) == (0, 1, 1)
    assert lit.stat.extent == pytest.approx(0.7)
    assert lit.body_pos.tolist() == plain.body_pos.tolist()
    check_actuators(arm, "kinematic")
    kept = own_arms.find(toml(tmp_path / "arm.toml", base='<light pos="0 0 3"/>')).arm
    assert (load_model(kept, lit=True).nlight, load_model(kept, lit=True).ntex) == (1, 0)
