"""ICAC (Algorithm 2): curiosity around CACLA+Var."""

import dataclasses
import functools

from icac_jax.agents import cacla
from icac_jax.agents.base import Agent
from icac_jax.agents.cacla import CaclaHyper, CaclaSpec
from icac_jax.agents.curious import curious
from icac_jax.agents.on_policy_hindsight import with_hindsight
from icac_jax.curiosity.options import CuriosityHyper, CuriositySpec
from icac_jax.envs.base import Environment


@dataclasses.dataclass(frozen=True)
class Spec(CuriositySpec, CaclaSpec):
    """The static choices of ICAC: those of the actor-critic and those of curiosity."""


class Hyper(CuriosityHyper, CaclaHyper):
    """The traced numbers of ICAC: those of the actor-critic and those of curiosity."""


@functools.cache
def _around(actor_critic: Agent, spec: Spec) -> Agent:
    return curious(actor_critic, spec)


def agent(spec: Spec, env: Environment | None = None) -> Agent:
    """ICAC as an agent; equal arguments give the same object.

    Args:
      spec: static choices, sizes included.
      env: the world, for hindsight alone.

    Raises:
      ConfigError: hindsight is wanted and the environment has no goals.
    """
    actor_critic = cacla.agent(spec, cacla.by_variance)
    if env is not None:
        actor_critic = with_hindsight(actor_critic, spec, env)
    return _around(actor_critic, spec)


def check(spec: Spec, hyper: Hyper) -> None:
    """Checks that the window of errors is as long as the averages need.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    hyper.check_window(spec)
