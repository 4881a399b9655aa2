"""Hindsight (Andrychowicz et al. 2017): a goal that was reached later takes the place of the one that was asked for.

The numbers of `HindsightHyper` are the options of every learner that has hindsight.
"""

from typing import Literal

import jax
import jax.numpy as jnp

from icac_jax.agents import replay
from icac_jax.agents.base import SeenGoal
from icac_jax.agents.replay import Experience, Replay
from icac_jax.envs.base import Environment
from icac_jax.fields import ConfigError, Numbers, param

Hindsight = Literal["none", "future", "final"]


class HindsightHyper(Numbers):
    """The traced numbers of hindsight."""

    hindsight_share: float = param(
        0.8, "share of a batch whose goal is replaced", source="Andrychowicz 2017, k = 4", low=0.0, high=1.0
    )
    hindsight_horizon: int = param(
        16, "how far ahead a transition's goal may be taken from (future)", unit="steps", source="trials", low=1
    )


def goal_size(hindsight: Hindsight, env: Environment) -> int:
    """Entries of the goals that have to be kept: 0 without hindsight.

    Raises:
      ConfigError: the environment has no goals that could be replaced.
    """
    if hindsight == "none":
        return 0
    if env.goal is None:
        raise ConfigError("hindsight: must be none, the environment has no goals")
    return env.goal.size


def as_if(was: Experience, goal: SeenGoal, instead: jax.Array) -> Experience:
    """What a transition would have been with another goal [G]; its bonus stays."""
    reward, terminated = goal.outcome(was.achieved, instead)
    return was._replace(
        observation=goal.relabel(was.observation, instead),
        next_observation=goal.relabel(was.next_observation, instead),
        reward=reward,
        terminated=terminated.astype(was.terminated.dtype),
    )


def relabelled(
    hindsight: Hindsight,
    buffer: Replay,
    places: jax.Array,
    drawn: Experience,
    goal: SeenGoal,
    key: jax.Array,
    hyper: HindsightHyper,
) -> Experience:
    """A batch with the goals of some of its transitions replaced, and with the rewards that they would have brought.

    Args:
      hindsight: "future" takes the goal achieved by one of the next `hindsight_horizon` transitions of the episode, the
        transition itself among them, each as likely; "final" the one achieved by the episode's latest transition.
      buffer: where the batch was drawn from.
      places: [B] where each transition lies in it.
      drawn: the batch, leaves [B, ...].
      goal: how to replace one.
      key: which are replaced, and by what.
      hyper: `hindsight_share` and `hindsight_horizon`.
    """
    which_key, steps_key = jax.random.split(key)
    steps = replay.steps_left(buffer, places)
    if hindsight == "future":
        choices = jnp.minimum(steps + 1, hyper.hindsight_horizon)
        steps = jnp.minimum(
            jnp.floor(jax.random.uniform(steps_key, steps.shape) * choices).astype(jnp.int32), choices - 1
        )
    sizes = drawn.observation.shape[-1], drawn.action.shape[-1]
    instead = replay.achieved_after(buffer, places, steps, *sizes)
    replaced = jax.vmap(lambda was, instead: as_if(was, goal, instead))(drawn, instead)
    which = jax.random.uniform(which_key, places.shape) < hyper.hindsight_share
    return jax.tree.map(
        lambda new, old: jnp.where(which.reshape(which.shape + (1,) * (old.ndim - 1)), new, old), replaced, drawn
    )
