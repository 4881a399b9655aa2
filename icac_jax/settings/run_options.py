"""The options that a run has whatever its learner and its task are, each declared once."""

import dataclasses

from icac_jax.envs import arms, tasks
from icac_jax.envs.physics import SUB_STEPS, Physics
from icac_jax.fields import param


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """What a run is, beside the learner's and the task's own numbers."""

    arm: str = param("planar2", f"{', '.join(arms.ARMS)}, a file or folder of an arm, or gymnax:NAME", source="Sec. IV")
    tip: str = param("", "site or body that reaches, of an arm that is a model file", source="own")
    arm_sha256: str = param("", "checksum of an own arm's files, filled in by itself", source="own")
    preset: str = param("paper", "defaults: paper, paper-literal or best", source="open points")
    task: str = param(
        tasks.REACH,
        f"what is learnt: {', '.join(tasks.NAMES)}",
        source="own",
    )
    algo: str = param("icac", "learning algorithm", source="Sec. II, III")
    physics: Physics = param("servo", "mjx.step with servos, or kinematics only", source="own")
    sub_steps: int = param(SUB_STEPS, "physics steps per control step (servo)", source="own", low=1, high=1000)
    seeds: int = param(20, "learners, seeds 0 to seeds - 1", source="Sec. IV", low=1, high=10**7)
    episodes: int = param(1000, "episodes per learner", source="Sec. IV", low=1, high=10**9)
    coverage_bins: int = param(0, "cells per joint, whose visits are counted; 0: none", source="own", low=0, high=1000)
    root_seed: int = param(0, "randomness of the whole run", source="own", low=0, high=2**32 - 1)


@dataclasses.dataclass(frozen=True)
class WarmOptions:
    """What a run starts with instead of a fresh map."""

    warm_map: str = param("", "run whose map and predictors this one starts with", source="own")
    warm_map_from: str = param("", "the run it came from, filled in by itself", source="own")
    warm_map_sha256: str = param("", "checksum of the run's copy, filled in by itself", source="own")


@dataclasses.dataclass(frozen=True)
class CameraOptions:
    """What the learner sees, if not its joints and the goal's coordinates."""

    encoder: str = param("", "file of icac encode: see its embeddings of pictures", source="own")
    encoder_sha256: str = param("", "checksum of that file, filled in by itself", source="own")
