"""Where the oracle goes: for each start and goal a posture of the arm, as few control steps away as can be.

The number of steps is that of `oracle.steps`; the posture is found by damped least squares within the joints that so
many steps can reach. Behind walls there is no planner. E is the number of start and goal pairs, J the number of joints.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.envs import oracle
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.physics import as_mjx_wants, tip_function
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError

_TRIALS = 24
_DESCENT_STEPS = 60
_DAMPING = 1e-4
# Share of the goal radius within which a tip counts as being in the goal zone, whatever rounding does to it.
_WITHIN = 0.999
# Largest change of a joint in one step of the descent, rad.
_LONGEST = 0.5
# Pairs that are planned together: one shape, one compile.
_BLOCK = 32


def postures(arm: ArmSpec, params: ReachParams, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Joints [E, J] in rad whose tip is in the goal zone, as few steps from the start as `oracle.steps` says.

    Of several the one whose tip is nearest to the goal, so that rounding does not miss it. Where none is found in so
    few steps it is one of the next larger number; where there is none at all, the one with the nearest tip.

    Args:
      arm: which arm.
      params: Python numbers of the task.
      start: [E, J] joint angles in rad.
      goal: [E, 3] goal positions in m.

    Raises:
      ConfigError: there are walls.
    """
    if params.walls:
        raise ConfigError("demonstrations: must not be oracle where there are walls, it plans without them")
    low, high = np.radians(params.joint_low), np.radians(params.joint_high)
    bound = np.radians(params.action_bound)
    steps = oracle.steps(arm, params, start, goal)
    most = int(np.ceil(np.max(high - low) / bound))
    share = np.random.default_rng(2).uniform(size=(_TRIALS, arm.joints))  # of each box, the same for all pairs
    found, miss = np.array(start, float), np.full(len(start), np.inf)
    left = np.arange(len(start))
    while len(left):
        box = steps[left, None] * bound
        floor, ceiling = np.clip(start[left] - box, low, high), np.clip(start[left] + box, low, high)
        trial = floor[:, None] + share * (ceiling - floor)[:, None]
        near, distance = _nearest(arm, trial, floor, ceiling, goal[left])
        better = distance < miss[left]
        found[left[better]], miss[left[better]] = near[better], distance[better]
        left = left[(miss[left] > _WITHIN * params.goal_radius) & (steps[left] < most)]
        steps[left] += 1
    return found


def _nearest(
    arm: ArmSpec, trial: np.ndarray, floor: np.ndarray, ceiling: np.ndarray, goal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What descents from trials [E, T, J] come to: joints [E, J] and distance [E] nearest to each goal [E, 3]."""
    number = len(goal)
    padded = -(-number // _BLOCK) * _BLOCK
    parts = [np.zeros((padded, *array.shape[1:]), np.float32) for array in (trial, floor, ceiling, goal)]
    for part, array in zip(parts, (trial, floor, ceiling, goal), strict=True):
        part[:number] = array
    split = (np.split(part, padded // _BLOCK) for part in parts)
    blocks = [_descend(arm)(*block) for block in zip(*split, strict=True)]
    joints, distance = (np.concatenate(leaves)[:number].astype(float) for leaves in zip(*blocks, strict=True))
    return joints, distance


def _solved(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """The solution [3] of a symmetric system [3, 3] by Cramer's rule, which compiles in a tenth of a solver's time."""
    first, second, third = matrix
    normals = jnp.stack([jnp.cross(second, third), jnp.cross(third, first), jnp.cross(first, second)])
    return normals @ right / (first @ normals[0])


@functools.cache
def _descend(arm: ArmSpec) -> Any:
    """Descends from trials [E, T, J] within boxes; the best of each pair, and its distance."""
    tip = tip_function(arm)

    def one(joints: jax.Array, floor: jax.Array, ceiling: jax.Array, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
        def step(_: int, carry: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
            joints, best, least = carry
            miss, jacobian = goal - tip(joints), jax.jacfwd(tip)(joints)
            distance = jnp.linalg.norm(miss)
            best, least = jnp.where(distance < least, joints, best), jnp.minimum(distance, least)
            # A joint at its end of the box that should go beyond it takes no part in the step.
            pull = miss @ jacobian
            stuck = ((joints <= floor) & (pull < 0)) | ((joints >= ceiling) & (pull > 0))
            free = jnp.where(stuck, 0.0, jacobian)
            change = free.T @ _solved(free @ free.T + _DAMPING * jnp.eye(3), miss)
            return jnp.clip(joints + jnp.clip(change, -_LONGEST, _LONGEST), floor, ceiling), best, least

        return jax.lax.fori_loop(0, _DESCENT_STEPS, step, (joints, joints, jnp.float32(jnp.inf)))[1:]

    def pair(trial: jax.Array, floor: jax.Array, ceiling: jax.Array, goal: jax.Array) -> tuple[jax.Array, jax.Array]:
        joints, distance = jax.vmap(one, (0, None, None, None))(trial, floor, ceiling, goal)
        best = jnp.argmin(distance)
        return joints[best], distance[best]

    pairs = jax.jit(jax.vmap(pair))

    def compute(*arrays: np.ndarray) -> Any:
        with as_mjx_wants():
            return jax.device_get(pairs(*map(jnp.asarray, arrays)))

    return compute
