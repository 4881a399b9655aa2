"""The oracle for the task of a run, computed once a task in a process: the search for nico4 takes many seconds."""

import dataclasses
import functools
import json
import math

import numpy as np

from icac_jax.envs import oracle
from icac_jax.envs.arms import PLANAR2, ArmSpec
from icac_jax.envs.model import facts_of_model
from icac_jax.envs.physics import tip_function
from icac_jax.envs.reach import ReachParams
from icac_jax.runs import build, cache
from icac_jax.settings.options import Settings

# On other arms than planar2 the oracle is searched for, about 15 s for so many pairs (standard error 0.1 step).
_PAIRS_EXACT = 2000
_PAIRS_SEARCHED = 340
# Behind walls each start is a search of its own, about a second.
_PAIRS_BY_START = 20
# Steps from one end of a joint's range to the other, above which the search would take too long.
_LONGEST = 200


def mean_steps(settings: Settings) -> float | None:
    """Mean of the least number of steps over random starts and goals; None without an arm or where steps are tiny.

    Where each seed has its goal, the goals are those of the run's seeds.
    """
    if settings.is_world:
        return None
    goals: tuple[tuple[float, ...], ...] = ()
    if settings.goals.goal_per == "seed":
        goals = tuple(build.task(settings, seed).goal_joints for seed in range(min(settings.run.seeds, _PAIRS_EXACT)))
    return _mean_steps(settings.arm, settings.params, goals)  # pyright: ignore[reportArgumentType]  (frozen, has a hash)


@functools.lru_cache(maxsize=64)
def _mean_steps(arm: ArmSpec, params: ReachParams, goals: tuple[tuple[float, ...], ...]) -> float | None:
    widest = max(high - low for low, high in zip(params.joint_low, params.joint_high, strict=True))
    if widest > _LONGEST * params.action_bound:
        return None
    number = _PAIRS_EXACT if arm.name == PLANAR2.name else _PAIRS_SEARCHED
    if params.walls:
        number = _PAIRS_EXACT if params.start_range == 0 else _PAIRS_BY_START
    facts = json.dumps([number, dataclasses.asdict(arm), dataclasses.asdict(params), goals]).encode()  # pyright: ignore

    def compute() -> float:
        tip_function(arm, cache=cache.current())  # the oracle's own is this one
        if not goals:
            return oracle.mean_steps(arm, params, number)[0]
        start, _ = oracle.pairs(arm, params, min(number, len(goals)))
        goal = oracle.tips(arm, np.radians(goals[: len(start)]))
        return float(oracle.steps(arm, params, start, goal).mean())

    mean = cache.current().kept("oracle", facts + facts_of_model(arm), compute)
    return mean if isinstance(mean, float) and math.isfinite(mean) else compute()


def steps(settings: Settings, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Least control steps [...] for these pairs; runs of one task that are evaluated on the same pairs share the work.

    Args:
      settings: of the run.
      start: [..., J] joint angles in rad.
      goal: [..., 3] goal positions in m.
    """
    joints = settings.arm.joints
    both = np.concatenate([start, goal], axis=-1).astype(np.float64)
    _, first, of = np.unique(both.reshape(-1, joints + 3), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)  # as they came: what is searched for depends on it in the last step
    pairs = both.reshape(-1, joints + 3)[first[order]]
    as_bytes = tuple(np.ascontiguousarray(part).tobytes() for part in np.split(pairs, [joints], axis=1))
    least = _steps(settings.arm, settings.params, *as_bytes)  # pyright: ignore[reportArgumentType]  (as above)
    return least[np.argsort(order)][of.ravel()].reshape(both.shape[:-1])


@functools.lru_cache(maxsize=8)
def _steps(arm: ArmSpec, params: ReachParams, start: bytes, goal: bytes) -> np.ndarray:
    joints = np.frombuffer(start).reshape(-1, arm.joints)
    return oracle.steps(arm, params, joints, np.frombuffer(goal).reshape(-1, 3))
