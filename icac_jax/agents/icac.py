"""ICAC (Algorithm 2): curiosity around CACLA+Var."""

import dataclasses
import functools

from icac_jax.agents import cacla
from icac_jax.agents.base import Agent
from icac_jax.agents.cacla import CaclaHyper, CaclaSpec
from icac_jax.agents.curious import curious
from icac_jax.curiosity.options import CuriosityHyper, CuriositySpec


@dataclasses.dataclass(frozen=True)
class Spec(CuriositySpec, CaclaSpec):
    """The static choices of ICAC: those of the actor-critic and those of curiosity."""


class Hyper(CuriosityHyper, CaclaHyper):
    """The traced numbers of ICAC: those of the actor-critic and those of curiosity."""


@functools.cache
def agent(spec: Spec) -> Agent:
    """ICAC as an agent; equal arguments give the same object.

    Args:
      spec: static choices, sizes included.
    """
    return curious(cacla.agent(spec, cacla.by_variance), spec)


def check(spec: Spec, hyper: Hyper) -> None:
    """Checks that the window of errors is as long as the averages need.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    hyper.check_window(spec)
