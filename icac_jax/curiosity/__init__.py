"""Curiosity: maps of experience, predictors and the intrinsic reward. `agents.curious` puts it around an agent."""

from icac_jax.curiosity import itm, predictors
from icac_jax.curiosity.base import Map, MapInfo, Nodes
from icac_jax.curiosity.intrinsic import CuriosityInfo, CuriosityState, init, map_of, update
from icac_jax.curiosity.options import CuriosityHyper, CuriositySpec
from icac_jax.curiosity.reward import TERMS, Seen

__all__ = [
    "TERMS",
    "CuriosityHyper",
    "CuriosityInfo",
    "CuriositySpec",
    "CuriosityState",
    "Map",
    "MapInfo",
    "Nodes",
    "Seen",
    "init",
    "itm",
    "map_of",
    "predictors",
    "update",
]
