"""The learner: one step of Algorithm 2 for one lane, with `algo` one of cacla, cacla_var, icac."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.agents import cacla
from icac_jax.agents.cacla import CaclaState
from icac_jax.curiosity import curious
from icac_jax.curiosity.curious import CuriosityState
from icac_jax.fields import Hyper, Spec


class AgentState(struct.PyTreeNode):
    """Everything a learner remembers.

    Attributes:
      cacla: the actor-critic.
      curiosity: the multi-predictor network, or None unless `algo` is icac.
    """

    cacla: CaclaState
    curiosity: CuriosityState | None


class Transition(NamedTuple):
    """One step of experience.

    Attributes:
      observation: [O] s_t, each entry in [-1, 1]; the first `state_size` entries are the agent's own state.
      action: [A] a_t as executed, in units of the action bound.
      reward: [] extrinsic reward.
      next_observation: [O] s_{t+1}, before any reset.
      terminated: [] bool, the goal was reached (not a time-out).
    """

    observation: jax.Array
    action: jax.Array
    reward: jax.Array
    next_observation: jax.Array
    terminated: jax.Array


class StepInfo(NamedTuple):
    """What one update did, all [].

    Attributes:
      td_error: delta_t.
      actor_updates: int32.
      intrinsic_reward: r^int (0 without curiosity).
      learning_progress: its first term.
      perception_error: its second term.
      prediction_error: e^prd.
      live_nodes: int32, nodes in the map after the step.
    """

    td_error: jax.Array
    actor_updates: jax.Array
    intrinsic_reward: jax.Array
    learning_progress: jax.Array
    perception_error: jax.Array
    prediction_error: jax.Array
    live_nodes: jax.Array


def init(spec: Spec, key: jax.Array, hyper: Hyper) -> AgentState:
    """A learner that knows nothing (Alg. 2 lines 1-2).

    Args:
      spec: static choices.
      key: randomness of all initial weights.
      hyper: traced numbers.
    """
    cacla_key, curiosity_key = jax.random.split(key)
    return AgentState(
        cacla=cacla.init(spec, cacla_key, hyper),
        curiosity=curious.init(spec, curiosity_key, hyper) if spec.algo == "icac" else None,
    )


def act(spec: Spec, state: AgentState, observation: jax.Array, key: jax.Array, hyper: Hyper) -> jax.Array:
    """An explored action [A] in units of the action bound (Alg. 2 line 6)."""
    return cacla.act(spec, state.cacla, observation, key, hyper)


def update(
    spec: Spec,
    state: AgentState,
    transition: Transition,
    hyper: Hyper,
    enabled: jax.typing.ArrayLike = True,
) -> tuple[AgentState, StepInfo]:
    """Learns from one transition (Alg. 2 lines 8-17).

    Args:
      spec: static choices.
      state: the learner.
      transition: one step of experience.
      hyper: traced numbers.
      enabled: when False the state comes back unchanged (a frozen lane).
    """
    reward = hyper.reward_scale * transition.reward
    zero = jnp.zeros_like(reward)
    intrinsic = progress = perception = prediction = zero
    live_nodes = jnp.zeros((), jnp.int32)
    curiosity = state.curiosity
    if curiosity is not None:
        curiosity, wonder = curious.update(
            spec,
            curiosity,
            transition.observation[: spec.map_size],
            transition.action,
            transition.next_observation[: spec.map_size],
            hyper,
            enabled,
        )
        intrinsic, progress, perception = wonder.reward, wonder.learning_progress, wonder.perception_error
        prediction = wonder.prediction_error
        live_nodes = jnp.sum(curiosity.map.live, dtype=jnp.int32)

    learned, info = cacla.update(
        spec,
        state.cacla,
        transition.observation,
        transition.action,
        intrinsic + reward,  # Eq. 11
        transition.next_observation,
        transition.terminated,
        hyper,
        enabled,
    )
    return AgentState(cacla=learned, curiosity=curiosity), StepInfo(
        td_error=info.td_error,
        actor_updates=info.actor_updates,
        intrinsic_reward=intrinsic,
        learning_progress=progress,
        perception_error=perception,
        prediction_error=prediction,
        live_nodes=live_nodes,
    )
