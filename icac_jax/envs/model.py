"""An arm's MuJoCo model: read from its MJCF file, checked, described, and handed to MJX.

J is the number of joints. Only this module reads models, and all that makes one fit for an arm is checked here.
"""

import contextlib
import functools
import io
from typing import Any

import jax
import numpy as np

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
    from mujoco import MjData, MjModel, mj_kinematics, mj_saveModel, mj_sizeModel, mjtJoint, mjtTrn  # pyright: ignore
except (AttributeError, ImportError) as error:
    raise no_opengl(error) from error


def load_model(arm: ArmSpec) -> MjModel:
    """The arm's MuJoCo model, the same file for MJX and C MuJoCo.

    Raises:
      ConfigError: it does not load, has no such tip, or its joints are not the arm's, hinges all.
    """
    path = assets.path(arm.model)
    try:
        model = MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise ConfigError(f"model: {path} does not load: {' '.join(str(error).split())}") from error
    names = [model.joint(joint).name for joint in range(model.njnt)]
    for name in arm.joint_names:
        if name not in names:
            raise ConfigError(f"joints: {path} has no joint {name!r}, it has {', '.join(names)}")
    for name, kind in zip(names, model.jnt_type, strict=True):
        if kind != mjtJoint.mjJNT_HINGE:
            kind = mjtJoint(kind).name.removeprefix("mjJNT_").lower()
            raise ConfigError(f"joints: must be hinges, {name!r} in {path} is a {kind} joint")
        if arm.joint_names and name not in arm.joint_names:
            raise ConfigError(f"joints: must name every joint of {path}, {name!r} is missing; weld what does not move")
    if (arm.joint_names and list(arm.joint_names) != names) or arm.joints != len(names):
        raise ConfigError(f"joints: must be those of {path} in its order, {', '.join(names)}")
    sites = [model.site(site).name for site in range(model.nsite)]
    if arm.tip not in sites:
        raise ConfigError(f"tip: {path} has no site {arm.tip!r}, it has {', '.join(sites) or 'none'}")
    return model


def check_actuators(arm: ArmSpec, physics: str) -> None:
    """Whether the arm can be run in a kind of physics.

    Raises:
      ConfigError: servo physics lacks a position actuator for a joint, in joint order, or has others.
    """
    model = load_model(arm)
    if physics == "servo":
        for joint, name in enumerate(joint_names(arm)):
            driven = joint < model.nu and model.actuator_trntype[joint] == mjtTrn.mjTRN_JOINT
            driven = driven and model.actuator_trnid[joint, 0] == joint
            # A position actuator's force is kp (ctrl - angle) - kv velocity, in MuJoCo's general terms:
            if not driven or not model.actuator_gainprm[joint, 0] == -model.actuator_biasprm[joint, 1] > 0:
                raise ConfigError(
                    f"physics: servo needs a position actuator a joint, in joint order, {arm.model} lacks "
                    f"that of {name!r} as number {joint + 1}; kinematic needs none"
                )
        if model.nu > arm.joints:
            raise ConfigError(f"physics: servo needs one actuator a joint, {arm.model} has {model.nu}")


def facts_of_model(arm: ArmSpec) -> bytes:
    """All that MuJoCo read for the arm, by which results of it can be recognised: equal models, equal bytes."""
    model = load_model(arm)
    content = np.zeros(mj_sizeModel(model), np.uint8)
    mj_saveModel(model, None, content)
    return content.tobytes()


def on_mjx(arm: ArmSpec) -> tuple[Any, MjModel, Any, Any]:
    """MJX, the model, the same for MJX, and MJX's data.

    Raises:
      ConfigError: it does not load, or MJX cannot run it.
    """
    # Imported here: half a second, and not needed where the arithmetic is kept.
    with contextlib.redirect_stdout(io.StringIO()):  # the import prints two lines about an absent warp
        from mujoco import mjx  # pyright: ignore  (as above)
    model = load_model(arm)
    here = jax.local_devices()[0]  # MJX's own choice can be another host's
    try:
        return mjx, model, mjx.put_model(model, device=here, impl="jax"), mjx.make_data(model, device=here, impl="jax")
    except NotImplementedError as error:
        raise ConfigError(f"model: MJX cannot run {arm.model}: {' '.join(str(error).split())}") from error


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
    data, site = MjData(model), model.site(arm.tip).id
    joints = np.random.default_rng(0).uniform(np.radians(joint_low), np.radians(joint_high), (samples, arm.joints))
    tips = np.empty((samples, 3))
    far = 0.0
    for number, configuration in enumerate(joints):
        data.qpos[:] = configuration
        mj_kinematics(model, data)
        tips[number] = data.site_xpos[site]
        far = max(far, float(np.linalg.norm(tips[number] - data.xanchor[0])))
    return tips.min(axis=0), tips.max(axis=0), far


@functools.cache
def tip_bounds(arm: ArmSpec) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest tip position [3] in m that the arm's links allow at any joint angles: a box about a sphere."""
    model = load_model(arm)
    data = MjData(model)
    mj_kinematics(model, data)
    points = np.concatenate([data.xanchor, data.site(arm.tip).xpos[None]])  # an anchor and the next are on one link
    reach = np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1))
    return points[0] - reach, points[0] + reach
