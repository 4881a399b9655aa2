"""Walls: boxes of joint space that stop the arm. For one lane on JAX and for many places on the host alike.

A box has a lowest and a highest angle of each joint, its faces belong to it, and the arm never is in one. The move of a
control step is the straight line in joint space from where the joints were to where they would be. A move that would
touch a box is refused as a whole: no joint moves in that step, and the arm is at rest. The line counts, not its end
alone, so that no step is so long that it jumps over a wall or cuts its corner; a face at a joint's limit is no way
through. K is the number of boxes, J the number of joints.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.fields import ConfigError


def boxes(walls: Any, joints: int) -> Any:
    """Lowest and highest angles [K, 2, J] of the option `walls`, in its own unit and kind of array."""
    return walls.reshape(-1, 2, joints)


def in_rad(walls: Sequence[float], joints: int) -> np.ndarray:
    """The boxes [K, 2, J] in rad of the option `walls` in degrees, in float64 on the host."""
    return boxes(np.radians(np.asarray(walls, float)), joints)


def blocked(start: Any, end: Any, walls: Any) -> Any:
    """Whether straight moves touch a box, [...] bool, on NumPy or on JAX as the arrays are.

    Args:
      start: [..., J] joint angles before the move, in rad.
      end: [..., J] joint angles after it, in rad.
      walls: [K, 2, J] the boxes, in rad.
    """
    xp = start.__array_namespace__()
    place, way = start[..., None, :], (end - start)[..., None, :]
    low, high = (xp.broadcast_to(walls[:, side], (*start.shape[:-1], *walls[:, side].shape)) for side in (0, 1))
    # The part of the way, 0 to 1, within the box's angles of each joint; a joint that stands still is there or is not.
    still = way == 0
    share = xp.where(still, 1.0, way)
    one, other = (low - place) / share, (high - place) / share
    beside = still & ((place < low) | (place > high))
    enters = xp.where(still, -xp.inf, xp.minimum(one, other))
    leaves = xp.where(still, xp.inf, xp.maximum(one, other))
    enters, leaves = xp.maximum(xp.max(enters, axis=-1), 0.0), xp.minimum(xp.min(leaves, axis=-1), 1.0)
    return xp.any((enters <= leaves) & ~xp.any(beside, axis=-1), axis=-1)


def within(joints: Any, walls: Any) -> Any:
    """Whether joint angles [..., J], in rad, are in a box, faces included, [...] bool; arguments as in `blocked`."""
    return blocked(joints, joints, walls)


def stop(before: jax.Array, joints: jax.Array, velocity: jax.Array, walls: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Where a move of one lane ends: where it would, or, at rest, where it began.

    Args:
      before: [J] joint angles before the move, in rad, outside all boxes.
      joints: [J] joint angles after it if nothing stops it, in rad.
      velocity: [J] joint velocities then, in rad/s.
      walls: [K, 2, J] the boxes, in rad.

    Returns:
      Joint angles and velocities [J] after the control step.
    """
    hit = blocked(before, joints, walls)
    return jnp.where(hit, before, joints), jnp.where(hit, 0.0, velocity)


def check(walls: Sequence[float], joint_low: Sequence[float], joint_high: Sequence[float]) -> None:
    """Checks the option `walls`.

    Args:
      walls: of each box J lowest and J highest angles, in degrees.
      joint_low: [J] lower joint limits, in degrees.
      joint_high: [J] upper joint limits, in degrees.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    joints = len(joint_low)
    if len(walls) % (2 * joints):
        raise ConfigError(
            f"walls: must be boxes of {2 * joints} numbers each, the lowest angles of all joints and then the highest, "
            f"got {len(walls)} numbers"
        )
    for number, (low, high) in enumerate(boxes(np.asarray(walls, float), joints)):
        if np.any(low >= high):
            joint = int(np.flatnonzero(low >= high)[0])
            raise ConfigError(
                f"walls: the lowest angles of box {number} must be less than its highest, got {low[joint]:g} and "
                f"{high[joint]:g} for joint {joint}"
            )
        if np.all(low <= joint_low) and np.all(high >= joint_high):
            raise ConfigError(f"walls: box {number} must leave the arm room within the joint limits")
