"""icac_jax: curiosity-driven, goal-reaching reinforcement learning as pure JAX functions, for one lane or many.

Importing this loads neither mujoco nor anything that touches files. The arms are in `icac_jax.envs`, the command line
is in `icac_jax.cli`.
"""

import importlib
from typing import TYPE_CHECKING, Any

from icac_jax import agents, curiosity, networks, rollout
from icac_jax.agents import cacla, icac
from icac_jax.agents.base import Agent, Report, Transition
from icac_jax.agents.curious import curious
from icac_jax.agents.icac import Hyper, Spec
from icac_jax.agents.registry import Learner
from icac_jax.curiosity import (
    CuriosityHyper,
    CuriosityInfo,
    CuriositySpec,
    CuriosityState,
    Map,
    MapInfo,
    itm,
    predictors,
)
from icac_jax.envs.base import Environment, Goal, TimeStep
from icac_jax.fields import ConfigError
from icac_jax.rollout import EpisodeRecord, LaneState, broadcast, init_lanes, run_chunk

__version__ = "0.1.0"

# Loaded when asked for: they read and write files and load the physics.
_LATE = {"preset": "training", "train": "training", "Trained": "trained"}


def __getattr__(name: str) -> Any:
    """Loads what is not needed by those who import the pure functions only."""
    if name not in _LATE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_LATE[name]}"), name)


if TYPE_CHECKING:
    from icac_jax.trained import Trained
    from icac_jax.training import preset, train

__all__ = [
    "Agent",
    "ConfigError",
    "CuriosityHyper",
    "CuriosityInfo",
    "CuriositySpec",
    "CuriosityState",
    "Environment",
    "EpisodeRecord",
    "Goal",
    "Hyper",
    "LaneState",
    "Learner",
    "Map",
    "MapInfo",
    "Report",
    "Spec",
    "TimeStep",
    "Trained",
    "Transition",
    "agents",
    "broadcast",
    "cacla",
    "curiosity",
    "curious",
    "icac",
    "init_lanes",
    "itm",
    "networks",
    "predictors",
    "preset",
    "rollout",
    "run_chunk",
    "train",
]
