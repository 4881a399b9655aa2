"""icac_jax: the curiosity-driven actor-critic ICAC as pure JAX functions, for one lane or many.

Importing this loads neither mujoco nor anything that touches files. The arms are in `icac_jax.envs`, the command line
is in `icac_jax.experiment`.
"""

from icac_jax import agent, cacla, curiosity, itm, networks, predictors, rollout
from icac_jax.agent import AgentState, StepInfo, Transition, act, init, update
from icac_jax.config import ConfigError, Hyper, Spec, validate
from icac_jax.curiosity import CuriosityInfo, CuriosityState
from icac_jax.envs.base import Environment, TimeStep
from icac_jax.itm import ItmInfo, ItmState
from icac_jax.rollout import EpisodeRecord, LaneState, broadcast, init_lanes, run_chunk

__version__ = "0.1.0"

__all__ = [
    "AgentState",
    "ConfigError",
    "CuriosityInfo",
    "CuriosityState",
    "Environment",
    "EpisodeRecord",
    "Hyper",
    "ItmInfo",
    "ItmState",
    "LaneState",
    "Spec",
    "StepInfo",
    "TimeStep",
    "Transition",
    "act",
    "agent",
    "broadcast",
    "cacla",
    "curiosity",
    "init",
    "init_lanes",
    "itm",
    "networks",
    "predictors",
    "rollout",
    "run_chunk",
    "update",
    "validate",
]
