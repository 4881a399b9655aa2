"""icac_jax: the curiosity-driven actor-critic ICAC as pure JAX functions, for one lane or many.

Importing this loads neither mujoco nor anything that touches files. The arms are in `icac_jax.envs`, the command line
is in `icac_jax.cli`.
"""

from icac_jax import networks, rollout
from icac_jax.agents import agent, cacla
from icac_jax.agents.agent import AgentState, StepInfo, Transition, act, init, update
from icac_jax.curiosity import curious, itm, predictors
from icac_jax.curiosity.curious import CuriosityInfo, CuriosityState
from icac_jax.curiosity.itm import ItmInfo, ItmState
from icac_jax.envs.base import Environment, Goal, TimeStep
from icac_jax.fields import ConfigError, Hyper, Spec, validate
from icac_jax.rollout import EpisodeRecord, LaneState, broadcast, init_lanes, run_chunk

__version__ = "0.1.0"

__all__ = [
    "AgentState",
    "ConfigError",
    "CuriosityInfo",
    "CuriosityState",
    "Environment",
    "EpisodeRecord",
    "Goal",
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
    "curious",
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
