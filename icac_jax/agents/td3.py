"""Twin delayed DDPG (Fujimoto et al. 2018): what it does otherwise than DDPG."""

from typing import Any

import jax
import jax.numpy as jnp

from icac_jax.agents import ddpg, hindsight
from icac_jax.agents.base import Agent
from icac_jax.agents.ddpg_learning import Refinements
from icac_jax.agents.ddpg_options import DdpgHyper, DdpgSpec
from icac_jax.envs.base import Environment
from icac_jax.fields import param


class Spec(DdpgSpec):
    """The static choices of TD3: those of DDPG."""


class Hyper(DdpgHyper):
    """The traced numbers of TD3; a grid over any of them is one compile."""

    policy_delay: int = param(2, "critic updates per update of the actor", source="Fujimoto 2018, Sec. 5.2", low=1)
    target_noise: float = param(
        0.2, "deviation of the noise on target actions", unit="action bound", source="Fujimoto 2018, Sec. 5.3", low=0.0
    )
    target_noise_clip: float = param(
        0.5, "bound of the noise on target actions", unit="action bound", source="Fujimoto 2018, Sec. 5.3", low=0.0
    )


def smoothed(action: jax.Array, noise: jax.Array, hyper: Any) -> jax.Array:
    """Target policy smoothing: similar actions have similar values (Fujimoto 2018, Sec. 5.3, Eq. 14).

    Args:
      action: [B, A] of the target policy.
      noise: [B, A] of the standard normal distribution.
      hyper: `target_noise` and `target_noise_clip`.
    """
    clipped = jnp.clip(hyper.target_noise * noise, -hyper.target_noise_clip, hyper.target_noise_clip)
    return jnp.clip(action + clipped, -1.0, 1.0)


# Clipped double Q-learning (Sec. 4.2, Eq. 10), target policy smoothing (Sec. 5.3), delayed policy updates (Sec. 5.2).
TD3 = Refinements(critics=2, smoothed=smoothed, delay=lambda hyper: hyper.policy_delay)


def build(spec: Spec, env: Environment) -> Agent:
    """TD3 for an environment.

    Raises:
      ConfigError: hindsight is wanted and the environment has no goals.
    """
    return ddpg.agent(spec, hindsight.goal_size(spec.hindsight, env), TD3)
