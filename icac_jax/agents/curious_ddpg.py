"""Curiosity around DDPG and TD3: the bonus is kept with each transition, and replayed with it.

Stored bonuses are those of the time of the visit; they are not computed again when the map or a predictor has changed.
"""

import dataclasses
import functools
from typing import Any

from icac_jax.agents import ddpg, hindsight, td3
from icac_jax.agents.base import Agent
from icac_jax.agents.curious import curious
from icac_jax.agents.ddpg_learning import DDPG, Refinements
from icac_jax.agents.ddpg_options import DdpgHyper, DdpgSpec
from icac_jax.curiosity.options import CuriosityHyper, CuriositySpec
from icac_jax.envs.base import Environment
from icac_jax.fields import param


@dataclasses.dataclass(frozen=True)
class Spec(DdpgSpec, CuriositySpec):
    """The static choices of DDPG or TD3 and those of curiosity; the predictors have a size of their own."""

    predictor_units: int = param(12, "width of a predictor's hidden layers", source="Sec. IV", low=1, high=4096)
    predictor_layers: int = param(1, "number of a predictor's hidden layers", source="Sec. IV", low=1, high=8)

    @property
    def of_curiosity(self) -> CuriositySpec:
        """What curiosity is told."""
        values: dict[str, Any] = {field.name: getattr(self, field.name) for field in dataclasses.fields(CuriositySpec)}
        values |= {"hidden_units": self.predictor_units, "hidden_layers": self.predictor_layers}
        return CuriositySpec(**values)


class Hyper(DdpgHyper, CuriosityHyper):
    """The traced numbers of curious DDPG."""


class Td3Hyper(td3.Hyper, CuriosityHyper):
    """The traced numbers of curious TD3."""


@functools.cache
def agent(spec: Spec, goal_size: int, refined: Refinements) -> Agent:
    """Curious DDPG or TD3 as an agent; equal arguments give the same object.

    Args:
      spec: static choices, sizes included.
      goal_size: entries of the goals that hindsight keeps.
      refined: DDPG's own, or TD3's.
    """
    return curious(ddpg.agent(spec, goal_size, refined), spec.of_curiosity)


def build(spec: Spec, env: Environment, refined: Refinements = DDPG) -> Agent:
    """Curious DDPG, or with its refinements TD3, for an environment.

    Raises:
      ConfigError: hindsight is wanted and the environment has no goals.
    """
    return agent(spec, hindsight.goal_size(spec.hindsight, env), refined)


def check(spec: Spec, hyper: Any) -> None:
    """Checks that the window of errors is as long as the averages need.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    hyper.check_window(spec.of_curiosity)
