"""The least number of control steps to a goal, for the kinematic arm.

On the planar arm it is exact: no controller can do better. On other arms it is the best path found, an upper bound on
the least. A step moves each joint by at most the action bound, within its limits, so k steps reach exactly the box of
+- k bounds around the start, cut to the limits; the oracle is the least k whose box holds a configuration with the tip
in the goal zone. An episode has at least one step; a goal that cannot be reached counts as the whole range of the
joints. Behind walls (`walls`) the steps are those of a search on a grid of joint space (`rooms.ways`), an upper bound
on the least. E is the number of start and goal pairs, J the number of joints.
"""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.envs import reach, rooms, walls
from icac_jax.envs.arms import PLANAR2, ArmSpec
from icac_jax.envs.physics import tip_function
from icac_jax.envs.reach import ReachParams
from icac_jax.envs.rooms import Space

if TYPE_CHECKING:
    from scipy.spatial import KDTree

_SAMPLES = 300_000
_BLOCK = 4096
_STARTS = 12
_DESCENT_STEPS = 25


class _Task(NamedTuple):
    """Radius of the goal zone in m; largest joint change a step and joint limits [J] in rad."""

    radius: float
    bound: float
    low: np.ndarray
    high: np.ndarray

    def box(self, start: np.ndarray, steps: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest joint angles that can be reached in so many steps."""
        return np.clip(start - steps * self.bound, self.low, self.high), np.clip(
            start + steps * self.bound, self.low, self.high
        )


def pairs(arm: ArmSpec, params: ReachParams, number: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Starts [E, J] in rad and goals [E, 3] in m as episodes draw them (uniform configurations in the reset range).

    Args:
      arm: which arm.
      params: Python numbers of the task.
      number: E.
      seed: of the draw.
    """
    start, goal = reach.placed(params, np.random.default_rng(seed).uniform(-0.5, 0.5, (2, number, arm.joints)))
    return start, _tips(arm)(goal)


def steps(arm: ArmSpec, params: ReachParams, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Least control steps [E] from each start to its goal zone, at least 1.

    Exact for the planar arm. For other arms an upper bound, the number of steps of the best path found from
    300,000 sampled configurations and descent into the goal zone; tests compare it with the exact one and with grids.

    Args:
      arm: which arm.
      params: Python numbers of the task.
      start: [E, J] joint angles in rad.
      goal: [E, 3] goal positions in m.
    """
    task = _Task(
        radius=params.goal_radius,
        bound=np.radians(params.action_bound),
        low=np.radians(params.joint_low),
        high=np.radians(params.joint_high),
    )
    if params.walls:
        return _behind_walls(arm, params, start, goal)
    solve = _planar if arm.model == PLANAR2.model else _searched
    return solve(arm, task, start, goal)


def space(arm: ArmSpec, params: ReachParams, start: np.ndarray | None = None) -> Space:
    """Joint space between the walls of a task.

    Args:
      arm: which arm.
      params: Python numbers of the task.
      start: [J] in rad; by default the middle of the starts.
    """
    middle = reach.placed(params, np.zeros((2, arm.joints)))[0] if start is None else start
    return Space(
        low=tuple(np.radians(params.joint_low)),
        high=tuple(np.radians(params.joint_high)),
        walls=tuple(walls.in_rad(params.walls, arm.joints).ravel()),
        bound=float(np.radians(params.action_bound)),
        start=tuple(middle),
    )


def distances(arm: ArmSpec, params: ReachParams, goal: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Least control steps [E] from one start to each goal zone with the walls of the task, if any; inf: no way there.

    From the places that `rooms.ways` finds, on the planar arm all, and on others 300,000 of them with any angles of the
    joints that no wall divides: an upper bound on the least, on the planar arm by a step or two.

    Args:
      arm: which arm.
      params: Python numbers of the task.
      goal: [E, 3] goal positions in m.
      start: [J] in rad; by default the middle of the starts.
    """
    steps, tree = _places(arm, space(arm, params, start))
    near = tree.query_ball_point(goal, params.goal_radius)
    return np.array([max(1, steps[found].min()) if found else np.inf for found in near])


def reachable(arm: ArmSpec, params: ReachParams, bins: int) -> np.ndarray:
    """Which cells of a grid over the joints' range can be reached from the start, [bins] * J bool; `rooms.reachable`.

    Args:
      arm: which arm.
      params: Python numbers of the task.
      bins: cells per joint.
    """
    return rooms.reachable(space(arm, params), bins)


def mean_steps(arm: ArmSpec, params: ReachParams, number: int = 2000, seed: int = 0) -> tuple[float, float]:
    """Mean of the oracle over random pairs, and its standard error."""
    least = steps(arm, params, *pairs(arm, params, number, seed))
    return float(least.mean()), float(least.std() / np.sqrt(number))


@functools.lru_cache(maxsize=16)
def _places(arm: ArmSpec, space: Space) -> "tuple[np.ndarray, KDTree]":
    """Steps [N] to places that can be reached, and a tree of their tips."""
    from scipy.spatial import KDTree  # as in `_sampled`

    found, searched = rooms.ways(space), space.searched
    free = np.setdiff1d(np.arange(arm.joints), searched)
    joints, steps = np.zeros((len(found.steps), arm.joints)), found.steps
    joints[:, searched] = found.joints
    if len(free):
        rng = np.random.default_rng(0)
        some = rng.integers(len(joints), size=_SAMPLES)
        joints, steps = joints[some], steps[some]
        start, low, high = (np.asarray(angles)[free] for angles in (space.start, space.low, space.high))
        joints[:, free] = rng.uniform(low, high, (_SAMPLES, len(free)))
        moves = np.max(np.abs(joints[:, free] - start), axis=1)
        steps = np.maximum(steps, np.ceil(moves / space.bound - 1e-9).astype(int))
    return steps, KDTree(_tips(arm)(joints))


def _behind_walls(arm: ArmSpec, params: ReachParams, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Steps [E] as in `steps`, a search for each distinct start."""
    least = np.empty(len(start))
    starts, of = np.unique(start, axis=0, return_inverse=True)
    for number, place in enumerate(starts):
        mine = of.ravel() == number
        least[mine] = distances(arm, params, goal[mine], place)
    known = np.isfinite(least)
    most = np.ceil(np.max(np.subtract(params.joint_high, params.joint_low)) / params.action_bound)
    least[~known] = max(most, least[known].max(initial=0.0))
    return least.astype(int)


def _in_blocks(compute: Callable[[jax.Array], Any]) -> Callable[[np.ndarray], Any]:
    """Runs a compiled function of [block, J] over [n, J] for any n: one shape, one compile."""

    def run(joints: np.ndarray) -> Any:
        number = len(joints)
        padded = np.zeros((-(-number // _BLOCK) * _BLOCK, joints.shape[1]), np.float32)
        padded[:number] = joints
        parts = [compute(jnp.asarray(block)) for block in np.split(padded, len(padded) // _BLOCK)]
        return jax.tree.map(lambda *pieces: np.concatenate(pieces)[:number].astype(float), *parts)

    return run


def tips(arm: ArmSpec, joints: np.ndarray) -> np.ndarray:
    """Tip positions [n, 3] in m of configurations [n, J] in rad, on the host."""
    return _tips(arm)(joints)


@functools.cache
def _tips(arm: ArmSpec) -> Callable[[np.ndarray], np.ndarray]:
    """Tips [n, 3] of configurations [n, J], on the host."""
    return _in_blocks(jax.jit(jax.vmap(tip_function(arm))))


@functools.cache
def _tips_and_jacobians(arm: ArmSpec) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Tips [n, 3] of configurations [n, J] and their derivatives [n, 3, J], on the host."""
    tip = tip_function(arm)
    return _in_blocks(jax.jit(jax.vmap(lambda joints: (tip(joints), jax.jacfwd(tip)(joints)))))


def _planar(arm: ArmSpec, task: _Task, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Two links of length 1 about the origin: exact."""
    most = int(np.ceil(np.max(task.high - task.low) / task.bound))
    least = np.ones(len(start), int)
    for pair, (joints, target) in enumerate(zip(start, goal, strict=True)):
        first, last = 1, most  # the boxes grow with k, so the least k is found by halving
        while first < last:
            middle = (first + last) // 2
            if _planar_box_reaches(*task.box(joints, middle), target[:2], task.radius):
                last = middle
            else:
                first = middle + 1
        least[pair] = first
    return least


def _planar_box_reaches(low: np.ndarray, high: np.ndarray, goal: np.ndarray, radius: float) -> bool:
    """Whether the box holds a configuration with the tip within `radius` of the goal.

    For a given elbow the best shoulder is known in closed form, so one variable is left. The distance changes by at
    most the length of the second link, 1, a radian of elbow: intervals that cannot reach are dropped, others halved.
    """
    middle, half = (low[0] + high[0]) / 2, (high[0] - low[0]) / 2
    direction = np.arctan2(goal[1], goal[0])

    def distance(elbow: np.ndarray) -> np.ndarray:
        # With two equal links the tip is at the angle shoulder + elbow / 2, at the distance 2 cos(elbow / 2), signed.
        reach_out = 2 * np.cos(elbow / 2)
        wanted = direction - elbow / 2 + np.where(reach_out < 0, np.pi, 0.0)
        off = np.mod(wanted - middle + np.pi, 2 * np.pi) - np.pi
        shoulder = middle + np.clip(off, -half, half)
        tip = reach_out * np.array([np.cos(shoulder + elbow / 2), np.sin(shoulder + elbow / 2)])
        return np.hypot(tip[0] - goal[0], tip[1] - goal[1])

    centre, width = np.array([(low[1] + high[1]) / 2]), (high[1] - low[1]) / 2
    while len(centre):
        found = distance(centre)
        if np.any(found <= radius):
            return True
        if width < 1e-9:
            return False
        centre = centre[found - width <= radius]
        width /= 2
        centre = np.concatenate([centre - width, centre + width])
    return False


@functools.cache
def _sampled(arm: ArmSpec, low: tuple[float, ...], high: tuple[float, ...]) -> "tuple[np.ndarray, KDTree]":
    """Random configurations within the limits, and a tree of their tips."""
    from scipy.spatial import KDTree  # takes long to load, and a mean that is kept needs none

    joints = np.random.default_rng(0).uniform(low, high, (_SAMPLES, arm.joints))
    return joints, KDTree(_tips(arm)(joints))


def _searched(arm: ArmSpec, task: _Task, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Any arm: the best of many configurations in the goal zone, then descent into smaller and smaller boxes."""
    known, tree = _sampled(arm, tuple(task.low), tuple(task.high))
    least = np.full(len(start), int(np.ceil(np.max(task.high - task.low) / task.bound)))
    seeds = np.repeat(start[:, None], _STARTS, axis=1)
    for pair, near in enumerate(tree.query_ball_point(goal, task.radius)):
        if near:
            moves = np.max(np.abs(known[near] - start[pair]), axis=1)
            best = np.argsort(moves)[:_STARTS]
            least[pair] = max(1, int(np.ceil(moves[best[0]] / task.bound - 1e-9)))
            seeds[pair, : len(best)] = known[np.array(near)[best]]
    rng = np.random.default_rng(1)
    open_pairs = np.flatnonzero(least > 1)
    while len(open_pairs):
        floor, ceiling = task.box(start[open_pairs][:, None], (least[open_pairs] - 1)[:, None, None])
        trial = np.clip(seeds[open_pairs], floor, ceiling)
        half = _STARTS // 2  # half of the trials from the sampled solutions, half from anywhere in the box
        trial[:, half:] = rng.uniform(floor, ceiling, trial[:, half:].shape)
        reached = _descend(arm, trial, goal[open_pairs], task.radius, floor, ceiling)
        least[open_pairs[reached]] -= 1
        open_pairs = open_pairs[reached & (least[open_pairs] > 1)]
    return least


def _descend(
    arm: ArmSpec, trial: np.ndarray, goal: np.ndarray, radius: float, floor: np.ndarray, ceiling: np.ndarray
) -> np.ndarray:
    """Which pairs [n] find a configuration in the goal zone from trials [n, m, J], by damped least squares in a box."""
    number, several, joints = trial.shape
    reached = np.zeros(number, bool)
    for _ in range(_DESCENT_STEPS):
        tip, jacobian = _tips_and_jacobians(arm)(trial.reshape(-1, joints))
        miss = goal[:, None] - tip.reshape(number, several, 3)
        reached |= np.any(np.linalg.norm(miss, axis=-1) <= radius, axis=1)
        if reached.all():
            break
        jacobian = jacobian.reshape(number, several, 3, joints)
        # A joint at its end of the box that should go beyond it takes no part in the step.
        pull = np.einsum("nmxj,nmx->nmj", jacobian, miss)
        stuck = ((trial <= floor) & (pull < 0)) | ((trial >= ceiling) & (pull > 0))
        free = np.where(stuck[:, :, None], 0.0, jacobian)
        square = np.einsum("nmxj,nmyj->nmxy", free, free) + 1e-4 * np.eye(3)
        step = np.einsum("nmxj,nmx->nmj", free, np.linalg.solve(square, miss[..., None])[..., 0])
        trial = np.clip(trial + np.clip(step, -0.5, 0.5), floor, ceiling)
    return reached
