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
from icac_jax.runs import cache
from icac_jax.settings.options import Settings

# On other arms than planar2 the oracle is searched for, about 15 s for so many pairs (standard error 0.1 step).
_PAIRS_EXACT = 2000
_PAIRS_SEARCHED = 340
# Steps from one end of a joint's range to the other, above which the search would take too long.
_LONGEST = 200


def mean_steps(settings: Settings) -> float | None:
    """Mean of the least number of steps over random starts and goals; None where each step is a tiny one."""
    return _mean_steps(settings.arm, settings.params)  # pyright: ignore[reportArgumentType]  (frozen, has a hash)


@functools.lru_cache(maxsize=64)
def _mean_steps(arm: ArmSpec, params: ReachParams) -> float | None:
    widest = max(high - low for low, high in zip(params.joint_low, params.joint_high, strict=True))
    if widest > _LONGEST * params.action_bound:
        return None
    number = _PAIRS_EXACT if arm.name == PLANAR2.name else _PAIRS_SEARCHED
    facts = json.dumps([number, dataclasses.asdict(arm), dataclasses.asdict(params)]).encode()  # pyright: ignore

    def compute() -> float:
        tip_function(arm, cache=cache.current())  # the oracle's own is this one
        return oracle.mean_steps(arm, params, number)[0]

    mean = cache.current().kept("oracle", facts + facts_of_model(arm), compute)
    return mean if isinstance(mean, float) and math.isfinite(mean) else compute()


def steps(settings: Settings, start: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Least control steps [E] for these pairs; runs of one task that are evaluated on the same pairs share the work.

    Args:
      settings: of the run.
      start: [E, J] joint angles in rad.
      goal: [E, 3] goal positions in m.
    """
    as_bytes = tuple(np.ascontiguousarray(pairs, np.float64).tobytes() for pairs in (start, goal))
    return _steps(settings.arm, settings.params, *as_bytes).copy()  # pyright: ignore[reportArgumentType]  (as above)


@functools.lru_cache(maxsize=8)
def _steps(arm: ArmSpec, params: ReachParams, start: bytes, goal: bytes) -> np.ndarray:
    joints = np.frombuffer(start).reshape(-1, arm.joints)
    return oracle.steps(arm, params, joints, np.frombuffer(goal).reshape(-1, 3))
