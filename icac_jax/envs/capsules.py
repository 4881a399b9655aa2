"""An arm as capsules: what of its model moves, and where that is for given joints. All that a schematic picture shows.

K is the number of capsules, J of joints.
"""

import functools
import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import load_model

# MuJoCo's numbers of shapes (mjtGeom), and from the sizes of a geom half its extents along its own axes.
_EXTENTS: dict[int, Callable[[Any], tuple[float, ...]]] = {
    2: lambda size: (size[0], size[0], size[0]),  # sphere
    3: lambda size: (size[0], size[0], size[0] + size[1]),  # capsule
    4: tuple,  # ellipsoid
    5: lambda size: (size[0], size[0], size[1]),  # cylinder
    6: tuple,  # box
    7: tuple,  # mesh, by the box about it
}
_LINE = 0.03  # radius of a line between joints, of the length of all


class Capsules(NamedTuple):
    """Capsules fixed to the bodies of a model.

    Attributes:
      bodies: [K, 2] number of the body that each end is fixed to.
      ends: [K, 2, 3] its place in that body's frame, in m.
      radii: [K] in m.
    """

    bodies: np.ndarray
    ends: np.ndarray
    radii: np.ndarray


def of_arm(arm: ArmSpec) -> Capsules:
    """The arm's moving geoms as capsules; an arm without geoms has a line from each joint to the next and to the tip.

    A capsule lies along the longest axis of its geom, and is as thick as the mean of the other two.

    Raises:
      ConfigError: the model does not load.
    """
    model = load_model(arm)
    found = []
    for geom in range(model.ngeom):
        body, extents = model.geom_bodyid[geom], _EXTENTS.get(int(model.geom_type[geom]))
        if model.body_weldid[body] == 0 or extents is None:
            continue
        half = np.array(extents(model.geom_size[geom]))
        along = int(np.argmax(half))
        radius = float(np.mean(np.delete(half, along)))
        way = _axes(model.geom_quat[geom])[:, along] * max(0.0, half[along] - radius)
        middle = model.geom_pos[geom]
        found.append(((body, body), (middle - way, middle + way), radius))
    if not found:
        tip = model.site(arm.tip).id
        places = [(model.jnt_bodyid[joint], model.jnt_pos[joint]) for joint in range(arm.joints)]
        places.append((model.site_bodyid[tip], model.site_pos[tip]))
        lengths = [np.linalg.norm(model.body_pos[body]) for body, _ in places[1:]] + [np.linalg.norm(places[-1][1])]
        found = [
            ((body, other), (place, end), _LINE * float(sum(lengths)))
            for (body, place), (other, end) in itertools.pairwise(places)
        ]
    return Capsules(*(np.array(part) for part in zip(*found, strict=True)))


def _axes(quaternion: Any) -> np.ndarray:
    """The axes [3, 3] of a frame, as columns, by its unit quaternion [4]."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@functools.cache
def ends_function(arm: ArmSpec) -> Callable[[jax.Array], jax.Array]:
    """From joints [J] in rad to the ends [K, 2, 3] of the arm's capsules, in m.

    The forward kinematics of hinges in a tree of bodies, by a product of frames: unlike the tip's arithmetic, which is
    taken from MJX, it can be differentiated in both directions.
    """
    model, (bodies, places, _) = load_model(arm), of_arm(arm)
    parents, first, number = model.body_parentid, model.body_jntadr, model.body_jntnum
    offsets, turns = model.body_pos.copy(), [_axes(quaternion) for quaternion in model.body_quat]
    anchors, axes, zero = model.jnt_pos.copy(), model.jnt_axis.copy(), model.qpos0.copy()

    def ends(joints: jax.Array) -> jax.Array:
        frames: list[tuple[Any, Any]] = [(np.zeros(3), np.eye(3))]
        for body in range(1, len(parents)):
            place, turn = frames[parents[body]]
            place, turn = place + _times(turn, offsets[body]), _times(turn, turns[body])
            for joint in range(first[body], first[body] + number[body]):
                anchor = place + _times(turn, anchors[joint])
                turn = _times(turn, _about(axes[joint], joints[joint] - np.float32(zero[joint])))
                place = anchor - _times(turn, anchors[joint])
            frames.append((place, turn))
        pairs = zip(bodies.ravel(), places.reshape(-1, 3), strict=True)
        found = [frames[body][0] + _times(frames[body][1], end) for body, end in pairs]
        return jnp.stack([_single(place) for place in found]).reshape(places.shape)

    return ends


def _times(turn: Any, other: Any) -> Any:
    """A frame's axes [3, 3] times a vector or other axes, in NumPy or not at all where that will do."""
    if isinstance(other, np.ndarray):
        if not isinstance(turn, jax.Array):
            return turn @ other
        if other.ndim == 1 and not np.any(other):
            return 0.0
        if other.ndim == 2 and np.array_equal(other, np.eye(3)):
            return turn
    return _single(turn) @ _single(other)


def _single(numbers: Any) -> jax.Array:
    return jnp.asarray(numbers, jnp.float32)


def _about(axis: np.ndarray, angle: jax.Array) -> jax.Array:
    """The rotation [3, 3] by an angle in rad about a unit axis [3] (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return jnp.eye(3) + jnp.sin(angle) * _single(cross) + (1 - jnp.cos(angle)) * _single(cross @ cross)
