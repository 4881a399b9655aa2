"""Forward kinematics of a chain of hinges as a product of small matrices.

It is what `mjx.kinematics` computes, in a form that stays fast for long chains: on a CPU the compiler repeats the work
of every body for each body behind it, which with seven joints costs forty times as much as with four.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


def _rigid(rotation: np.ndarray, place: np.ndarray) -> np.ndarray:
    """A homogeneous matrix [4, 4]."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, place
    return matrix


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """The rotation matrix [3, 3] of a unit quaternion [4], scalar first."""
    w, v = quaternion[0], quaternion[1:]
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * _cross(v)


def _cross(axis: np.ndarray) -> np.ndarray:
    """The matrix [3, 3] that takes the cross product with `axis` [3]."""
    x, y, z = axis
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def tip_function(model: Any, site: int) -> Callable[[jax.Array], jax.Array]:
    """The position of a site: joint angles [J] in rad to [3] in m.

    Args:
      model: a MuJoCo model whose joints are hinges.
      site: index of the site; joints that do not carry it have no effect.

    Returns:
      A pure function; turning joint j by q gives the matrix still_j + sin(q) sine_j + (1 - cos(q)) cosine_j
      (Rodrigues' formula), with all that is fixed between two joints in them.
    """
    bodies = [int(model.site_bodyid[site])]
    while bodies[-1]:
        bodies.append(int(model.body_parentid[bodies[-1]]))
    joints, still, sine, cosine = [], [], [], []
    fixed = np.eye(4)  # from the last joint so far to here
    for body in reversed(bodies):
        fixed = fixed @ _rigid(_rotation(model.body_quat[body]), model.body_pos[body])
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            there, back = (_rigid(np.eye(3), sign * model.jnt_pos[joint]) for sign in (1, -1))
            cross = np.zeros((4, 4))
            cross[:3, :3] = _cross(model.jnt_axis[joint])
            joints.append(joint)
            still.append(fixed @ there @ back)
            sine.append(fixed @ there @ cross @ back)
            cosine.append(fixed @ there @ cross @ cross @ back)
            fixed = np.eye(4)
    tip = fixed @ np.append(model.site_pos[site], 1.0)
    zero = np.array(model.qpos0)

    def tip_position(angles: jax.Array) -> jax.Array:
        turned = angles - zero
        place = jnp.asarray(tip, angles.dtype)
        for joint, fixed, by_sine, by_cosine in reversed(list(zip(joints, still, sine, cosine, strict=True))):
            matrix = fixed + jnp.sin(turned[joint]) * by_sine + (1 - jnp.cos(turned[joint])) * by_cosine
            place = jnp.matmul(matrix.astype(angles.dtype), place, precision="highest")
        return place[:3]

    return tip_position
