"""An arm's MuJoCo model: read from its MJCF file, checked, described, and handed to MJX.

J is the number of joints. Only this module reads models, and all that makes one fit for an arm is checked here.
"""

import contextlib
import functools
import io
from typing import Any

import jax
import numpy as np

from icac_jax.console import shown
from icac_jax.envs import assets
from icac_jax.envs.arms import ArmSpec
from icac_jax.fields import ConfigError


def no_opengl(error: Exception) -> ConfigError:
    """What is said wherever MuJoCo cannot draw, in one line with the reason."""
    reason = str(error).partition("\n")[0] or type(error).__name__
    return ConfigError(
        f"rendering: there is no OpenGL that can be used here ({reason}); without a display it has to be EGL, "
        "on Debian: apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri"
    )


try:  # with MUJOCO_GL=egl in the environment this loads EGL; an AttributeError is what a missing libEGL gives
    import mujoco as _mujoco
except (AttributeError, ImportError) as error:
    raise no_opengl(error) from error

mujoco: Any = _mujoco  # a compiled module without stubs

_NO_CONTACTS = '<option><flag contact="disable"/></option>'
# What MJX says that it lacks, and how that is switched off in the model.
_SWITCHES = (
    ("mjENBL_ENERGY", 'remove <flag energy="enable"/>'),
    ("mjENBL_", "remove that <flag> from <option>"),
    ("margin/gap", f"remove margin and gap, or switch contacts off: {_NO_CONTACTS}"),
    ("collisions", f"switch contacts off: {_NO_CONTACTS}"),
    ("condim", f'choose <option cone="pyramidal"/>, or switch contacts off: {_NO_CONTACTS}'),
    ("mjSENS", "remove that <sensor>"),
    ("sensor", "remove that <sensor>"),
    ("mjINT_", 'choose <option integrator="implicitfast"/>'),
    ("fluid", 'choose <option integrator="Euler"/>, or remove density and viscosity'),
    ("mjSOL_", 'choose <option solver="Newton"/>'),
    ("mjEQ_", 'switch equality constraints off: <option><flag equality="disable"/></option>, and remove that one'),
    ("mjWRAP_", "remove that <tendon>"),
    ("Flex", "remove the <flexcomp> or <deformable>"),
)


def load_model(arm: ArmSpec, lit: bool = False) -> Any:
    """The arm's MuJoCo model, the same file for MJX and C MuJoCo; a body that is the tip gets a site of its name.

    Args:
      arm: which arm.
      lit: for pictures: a model without a light gets one, and a sky and a camera that sees the whole arm.

    Raises:
      ConfigError: it does not load, has no such tip, or its joints are not the arm's, hinges all.
    """
    path = assets.path(arm.model)
    model = _compiled(str(path), arm.tip, lit)
    names = [model.joint(joint).name for joint in range(model.njnt)]
    for name in arm.joint_names:
        if name not in names:
            had = shown(", ".join(names)) or "none"
            raise ConfigError(f"joints: {shown(path)} has no joint {shown(repr(name))}, it has {had}")
    for number, (name, kind) in enumerate(zip(names, model.jnt_type, strict=True), 1):
        if kind != mujoco.mjtJoint.mjJNT_HINGE:
            kind = mujoco.mjtJoint(kind).name.removeprefix("mjJNT_").lower()
            named = shown(repr(name)) if name else f"number {number}"
            hint = "; fix the base to the world: remove that joint" if kind == "free" else ""
            raise ConfigError(f"joints: must be hinges, {named} in {shown(path)} is a {kind} joint{hint}")
        if arm.joint_names and name not in arm.joint_names:
            raise ConfigError(
                f"joints: must name every joint of {shown(path)}, {shown(repr(name))} is missing; "
                "weld what does not move"
            )
    if not names:
        raise ConfigError(f"joints: {shown(path)} has none; an arm has one at least")
    if (arm.joint_names and list(arm.joint_names) != names) or arm.joints != len(names):
        raise ConfigError(f"joints: must be those of {shown(path)} in its order, {shown(', '.join(names))}")
    sites = [model.site(site).name for site in range(model.nsite)]
    if arm.tip not in sites:
        had = shown(", ".join(sites)) or "none"
        raise ConfigError(f"tip: {shown(path)} has no site {shown(repr(arm.tip))}, it has {had}")
    return model


def _compiled(path: str, tip: str, lit: bool = False) -> Any:
    """A model file as MuJoCo reads it, with a site `tip` where only a body has that name; `lit` as in `load_model`."""
    try:
        model = mujoco.MjModel.from_xml_path(path)
        dark = lit and model.nlight == 0
        from_body = bool(tip) and tip not in [model.site(site).name for site in range(model.nsite)]
        if dark or from_body:
            spec = _spec(path) if from_body else mujoco.MjSpec.from_file(path)
            if from_body and (body := spec.body(tip)) is not None:
                body.add_site(name=tip)
            if dark:
                _light(spec, model)
            model = spec.compile()
    except ValueError as error:
        hint = ""
        if path.lower().endswith(".urdf"):
            hint = "; of a URDF only links, joints and limits are needed: <visual> and <collision> can be removed"
        reason = shown(" ".join(str(error).split()))
        raise ConfigError(f"model: {shown(path)} does not load: {reason}{hint}") from error
    for name in _PLACES:
        values = getattr(model, name)
        if not np.all(np.isfinite(values)):
            raise ConfigError(f"model: {shown(path)}: {name} must be finite numbers, it has {float(np.sum(values))}")
    return model


def _light(spec: Any, model: Any) -> None:
    """Adds what a model needs to be seen: a light, a sky unless it has one, and a look at it from the side."""
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[1, -1, 3], dir=[-0.5, 0.4, -0.9], diffuse=[0.55] * 3
    )
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.35] * 3, [0.35] * 3
    if mujoco.mjtTexture.mjTEXTURE_SKYBOX not in model.tex_type:
        sky = {"type": mujoco.mjtTexture.mjTEXTURE_SKYBOX, "builtin": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT}
        spec.add_texture(name="icac_sky", **sky, rgb1=[0.95, 0.95, 0.93], rgb2=[0.8, 0.82, 0.84], width=64, height=384)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = np.concatenate([data.xanchor, data.site_xpos, data.xpos[1:]])
    if not spec.cameras and len(points) and len(data.xanchor):
        middle = data.xanchor[0]
        spec.stat.center, spec.stat.extent = middle, max(1e-3, 1.4 * np.max(np.linalg.norm(points - middle, axis=1)))
        spec.visual.global_.azimuth, spec.visual.global_.elevation = 140, -20


_PLACES = (
    *("body_pos", "body_quat", "body_mass", "body_inertia", "jnt_pos", "jnt_axis", "jnt_range", "site_pos"),
    *("site_quat", "qpos0", "dof_armature", "dof_damping", "actuator_gainprm", "actuator_biasprm"),
)


def _spec(path: str) -> Any:
    """A model file before it is compiled, with all of its bodies."""
    spec = mujoco.MjSpec.from_file(path)
    spec.compiler.fusestatic = 0  # as it is for a URDF, a tool's link would be no body of its own
    return spec


def tips_of(path: str) -> tuple[list[str], list[str]]:
    """The names of the sites and of the bodies of a model file, any of which can be a tip.

    Raises:
      ConfigError: it does not load.
    """
    _compiled(path, "")
    spec = _spec(path)
    return [site.name for site in spec.sites if site.name], [body.name for body in spec.bodies[1:] if body.name]


def joint_names_of(path: str) -> list[str]:
    """The names of the joints of a model file, in its order.

    Raises:
      ConfigError: it does not load.
    """
    model = _compiled(path, "")
    return [model.joint(joint).name for joint in range(model.njnt)]


def has_actuators(arm: ArmSpec) -> bool:
    """Whether the arm's model has any actuator."""
    return load_model(arm).nu > 0


def has_contacts(arm: ArmSpec) -> bool:
    """Whether geoms of the arm's model can touch."""
    model = load_model(arm)
    if model.opt.disableflags & (
        mujoco.mjtDisableBit.mjDSBL_CONTACT.value | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
    ):
        return False
    first, second = np.triu_indices(model.ngeom, 1)
    may = (model.geom_contype[first] & model.geom_conaffinity[second]) != 0
    may |= (model.geom_contype[second] & model.geom_conaffinity[first]) != 0
    may &= model.geom_bodyid[first] != model.geom_bodyid[second]
    return bool(model.npair or np.any(may))


def check_actuators(arm: ArmSpec, physics: str) -> None:
    """Whether the arm can be run in a kind of physics.

    Raises:
      ConfigError: servo physics lacks a position actuator for a joint, in joint order, or has others.
    """
    model = load_model(arm)
    if physics == "servo":
        for joint, name in enumerate(joint_names(arm)):
            driven = joint < model.nu and model.actuator_trntype[joint] == mujoco.mjtTrn.mjTRN_JOINT
            driven = driven and model.actuator_trnid[joint, 0] == joint
            # A position actuator's force is kp (ctrl - angle) - kv velocity, in MuJoCo's general terms:
            if not driven or not model.actuator_gainprm[joint, 0] == -model.actuator_biasprm[joint, 1] > 0:
                raise ConfigError(
                    f"physics: servo needs a position actuator a joint, in joint order, {shown(arm.model)} lacks "
                    f"that of {shown(repr(name))} as number {joint + 1}; kinematic needs none"
                )
        if model.nu > arm.joints:
            raise ConfigError(f"physics: servo needs one actuator a joint, {shown(arm.model)} has {model.nu}")


def facts_of_model(arm: ArmSpec) -> bytes:
    """All that MuJoCo read for the arm, by which results of it can be recognised: equal models, equal bytes."""
    model = load_model(arm)
    content = np.zeros(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


def skeleton(arm: ArmSpec) -> Any:
    """The arm's bodies, hinges and tip alone: all that its kinematics depend on, and nothing that MJX may lack."""
    model = load_model(arm)
    spec = mujoco.MjSpec()
    bodies = [spec.worldbody]
    for number in range(1, model.nbody):
        body = bodies[model.body_parentid[number]].add_body(
            pos=model.body_pos[number], quat=model.body_quat[number], mass=1.0, ipos=[0, 0, 0], inertia=[1, 1, 1]
        )
        body.explicitinertial = True
        bodies.append(body)
        first = model.body_jntadr[number]
        for joint in range(first, first + model.body_jntnum[number]):
            body.add_joint(
                type=mujoco.mjtJoint.mjJNT_HINGE,
                pos=model.jnt_pos[joint],
                axis=model.jnt_axis[joint],
                ref=model.qpos0[joint],
            )
    site = model.site(arm.tip).id
    bodies[model.site_bodyid[site]].add_site(name=arm.tip, pos=model.site_pos[site], quat=model.site_quat[site])
    spec.compiler.degree = False
    return spec.compile()


def on_mjx(arm: ArmSpec, kinematic: bool = False) -> tuple[Any, Any, Any, Any]:
    """MJX, the model, the same for MJX, and MJX's data.

    Args:
      arm: which arm.
      kinematic: of its `skeleton` alone.

    Raises:
      ConfigError: it does not load, or MJX cannot run it.
    """
    # Imported here: half a second, and not needed where the arithmetic is kept.
    with contextlib.redirect_stdout(io.StringIO()):  # the import prints two lines about an absent warp
        from mujoco import mjx  # pyright: ignore
    model = skeleton(arm) if kinematic else load_model(arm)
    here = jax.local_devices()[0]  # MJX's own choice can be another host's
    try:
        return mjx, model, mjx.put_model(model, device=here, impl="jax"), mjx.make_data(model, device=here, impl="jax")
    except NotImplementedError as error:
        reason = " ".join(str(error).split())
        switch = next((f"; {what}" for word, what in _SWITCHES if word in reason), "")
        raise ConfigError(
            f"model: MJX cannot run {shown(arm.model)}: {shown(reason)}{switch}; "
            "or physics kinematic, which needs none of it"
        ) from error


def joint_names(arm: ArmSpec) -> tuple[str, ...]:
    """The names of the joints in the model, in the order of every array [J]."""
    model = load_model(arm)
    return tuple(model.joint(joint).name for joint in range(arm.joints))


def joint_ranges(arm: ArmSpec) -> list[tuple[float, float] | None]:
    """The range of each joint in the model, in degrees; None where it has none."""
    model = load_model(arm)
    ranges = np.round(np.degrees(model.jnt_range), 9)  # the model holds radians; 110 should stay 110
    return [
        (float(low), float(high)) if limited else None
        for (low, high), limited in zip(ranges, model.jnt_limited, strict=True)
    ]


def tip_box(
    arm: ArmSpec, joint_low: tuple[float, ...], joint_high: tuple[float, ...], samples: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Where the tip can be, from random configurations, always the same ones.

    Args:
      arm: which arm.
      joint_low: lower joint limits [J] in degrees.
      joint_high: upper joint limits [J] in degrees.
      samples: how many configurations.

    Returns:
      Least and greatest coordinates of the tip, [3] in m, and its greatest distance from the first joint, in m.
    """
    model = load_model(arm)
    data, site = mujoco.MjData(model), model.site(arm.tip).id
    joints = np.random.default_rng(0).uniform(np.radians(joint_low), np.radians(joint_high), (samples, arm.joints))
    tips = np.empty((samples, 3))
    far = 0.0
    for number, configuration in enumerate(joints):
        data.qpos[:] = configuration
        mujoco.mj_kinematics(model, data)
        tips[number] = data.site_xpos[site]
        far = max(far, float(np.linalg.norm(tips[number] - data.xanchor[0])))
    return tips.min(axis=0), tips.max(axis=0), far


@functools.cache
def tip_bounds(arm: ArmSpec) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest tip position [3] in m that the arm's links allow at any joint angles: a box about a sphere."""
    model = load_model(arm)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = np.concatenate([data.xanchor, data.site(arm.tip).xpos[None]])  # an anchor and the next are on one link
    reach = np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1))
    return points[0] - reach, points[0] + reach
