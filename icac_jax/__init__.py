"""icac_jax: curiosity-driven, goal-reaching reinforcement learning as pure JAX functions, for one lane or many.

Importing this loads neither mujoco nor anything that touches files. The arms are in `icac_jax.envs`, the command line
is in `icac_jax.cli`.
"""

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
    "rollout",
    "run_chunk",
]
