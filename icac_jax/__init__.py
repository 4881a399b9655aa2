"""icac_jax: curiosity-driven, goal-reaching reinforcement learning as pure JAX functions, for one lane or many.

Importing this loads nothing, not even JAX: what is used is loaded when it is. The arms are in `icac_jax.envs`, the
command line is in `icac_jax.cli`.
"""

TYPE_CHECKING = False  # as in typing, which takes long to load
if TYPE_CHECKING:
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
    from icac_jax.runs.encoders import encode
    from icac_jax.runs.observers import Observer, Told
    from icac_jax.trained import Trained
    from icac_jax.training import preset, train

__version__ = "0.2.0.dev0"

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
    "Observer",
    "Report",
    "Spec",
    "TimeStep",
    "Told",
    "Trained",
    "Transition",
    "agents",
    "broadcast",
    "cacla",
    "curiosity",
    "curious",
    "encode",
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

# Where each name is: in which module, or which module it is.
_MODULES = {
    "agents": "agents",
    "cacla": "agents.cacla",
    "curiosity": "curiosity",
    "icac": "agents.icac",
    "itm": "curiosity.itm",
    "networks": "networks",
    "predictors": "curiosity.predictors",
    "rollout": "rollout",
}
_NAMES = {
    "agents.base": ("Agent", "Report", "Transition"),
    "agents.curious": ("curious",),
    "agents.icac": ("Hyper", "Spec"),
    "agents.registry": ("Learner",),
    "curiosity": ("CuriosityHyper", "CuriosityInfo", "CuriositySpec", "CuriosityState", "Map", "MapInfo"),
    "envs.base": ("Environment", "Goal", "TimeStep"),
    "fields": ("ConfigError",),
    "runs.encoders": ("encode",),
    "runs.observers": ("Observer", "Told"),
    "rollout": ("EpisodeRecord", "LaneState", "broadcast", "init_lanes", "run_chunk"),
    "trained": ("Trained",),
    "training": ("preset", "train"),
}


def __getattr__(name: str) -> object:
    """A public name, loaded when it is first used: `icac --version` does not wait for JAX."""
    import importlib

    if name in _MODULES:
        value = importlib.import_module(f"icac_jax.{_MODULES[name]}")
    else:
        place = next((place for place, names in _NAMES.items() if name in names), None)
        if place is None:
            raise AttributeError(f"module 'icac_jax' has no attribute {name!r}")
        value = getattr(importlib.import_module(f"icac_jax.{place}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
