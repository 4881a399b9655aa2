"""Curiosity: the map and the predictor bank together give the intrinsic reward (Sec. III, Eq. 8-10).

Independent of the actor-critic: it can reward any agent's transitions.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.curiosity import itm, predictors
from icac_jax.curiosity.itm import ItmState
from icac_jax.curiosity.predictors import BankState
from icac_jax.fields import Hyper, Spec
from icac_jax.networks import Network


class CuriosityState(struct.PyTreeNode):
    """The multi-predictor network.

    Attributes:
      map: the topological map.
      bank: one predictor a node, or a single one with `Spec.predictors` "single" (N = 1).
      step: [] int32, transitions seen.
      last_created: [] int32, step at which the latest node was created.
    """

    map: ItmState
    bank: BankState
    step: jax.Array
    last_created: jax.Array


class CuriosityInfo(NamedTuple):
    """The intrinsic reward and its parts, all [] and all weights applied.

    Attributes:
      reward: r^int (Eq. 10).
      learning_progress: its first term.
      perception_error: its second term.
      prediction_error: e^prd of the node asked (Eq. 8).
      node: int32, slot of the responsible node.
      created: bool, a node was created.
    """

    reward: jax.Array
    learning_progress: jax.Array
    perception_error: jax.Array
    prediction_error: jax.Array
    node: jax.Array
    created: jax.Array


def predictor_network(spec: Spec) -> Network:
    """State [D] and action [A] to the next state [D] (Sec. III.A)."""
    hidden = (spec.hidden_units,) * spec.hidden_layers
    return Network((spec.map_size + spec.action_size, *hidden, spec.map_size), spec.predictor_output)


def init(spec: Spec, key: jax.Array, hyper: Hyper) -> CuriosityState:
    """A map of two nodes and a fresh bank.

    Args:
      spec: static choices.
      key: randomness of first nodes and predictors.
      hyper: traced numbers; the first nodes' range and the scale of initial weights are used.
    """
    map_key, bank_key = jax.random.split(key)
    return CuriosityState(
        map=itm.init(map_key, spec.map_capacity, spec.map_size, hyper.map_init_range),
        bank=predictors.init(
            predictor_network(spec),
            bank_key,
            spec.map_capacity if spec.predictors == "local" else 1,
            spec.window,
            hyper.predictor_weight_scale,
        ),
        step=jnp.zeros((), jnp.int32),
        last_created=jnp.zeros((), jnp.int32),
    )


def update(
    spec: Spec,
    state: CuriosityState,
    sensed: jax.Array,
    action: jax.Array,
    next_sensed: jax.Array,
    hyper: Hyper,
    enabled: jax.typing.ArrayLike = True,
) -> tuple[CuriosityState, CuriosityInfo]:
    """Learns from one transition and rewards it (Alg. 2 lines 8-9).

    Args:
      spec: static choices.
      state: the multi-predictor network.
      sensed: [D] s_t, in [-1, 1]; D is `Spec.map_size`.
      action: [A] a_t, in units of the action bound.
      next_sensed: [D] s_{t+1}.
      hyper: traced numbers.
      enabled: when False nothing is written (a frozen lane).

    Returns:
      The multi-predictor network, and the intrinsic reward with its parts.
    """
    enabled = jnp.asarray(enabled)
    new_map, mapped = itm.update(
        state.map,
        sensed,
        rate=hyper.map_rate,
        e_max=hyper.e_max,
        spacing_removal=spec.spacing_removal,
        enabled=enabled,
    )
    bank, asked, fresh = _asked(spec, state.bank, mapped)
    bank, predicted = predictors.update(
        predictor_network(spec),
        bank,
        asked,
        fresh,
        jnp.concatenate([sensed, action]),
        next_sensed,
        rate=hyper.predictor_rate,
        mu=hyper.mu,
        T=hyper.T,
        error_time=spec.prediction_error_time,
        divide_by=spec.window_mean,
        early=spec.early_learning_progress,
        when=spec.learning_progress_time,
        enabled=enabled,
    )
    last_created = jnp.where(mapped.created, state.step, state.last_created)
    distance = mapped.distance
    if spec.creation_perception_error == "zero":
        distance = jnp.where(mapped.created, 0.0, distance)
    # "After which it can be neglected" (Sec. III.B): both gates are open for ever by default.
    gate = jnp.exp2(-state.step / hyper.perception_half_life)
    gate = jnp.where(state.step - last_created > hyper.perception_patience, 0.0, gate)

    progress = hyper.learning_progress_weight * predicted.learning_progress
    perception = hyper.perception_error_weight * gate * distance
    new_state = CuriosityState(map=new_map, bank=bank, step=state.step + enabled, last_created=last_created)
    info = CuriosityInfo(
        reward=progress + perception,  # Eq. 10
        learning_progress=progress,
        perception_error=perception,
        prediction_error=predicted.prediction_error,
        node=mapped.node,
        created=mapped.created,
    )
    return new_state, info


def _asked(spec: Spec, bank: BankState, mapped: itm.ItmInfo) -> tuple[BankState, jax.Array, jax.Array]:
    """The bank, the slot of the predictor that is asked and trained, and whether that predictor starts anew."""
    if spec.predictors == "single":
        return bank, jnp.zeros_like(mapped.node), jnp.zeros_like(mapped.created)
    if spec.prediction_node == "created":
        return bank, mapped.node, mapped.created
    # The created node gets its fresh predictor and an empty window, but n is asked.
    write = jnp.where(mapped.created, mapped.node, bank.queries.shape[0])
    bank = bank.replace(
        params=bank.params.at[write].set(bank.fresh[mapped.node], mode="drop"),
        queries=bank.queries.at[write].set(0, mode="drop"),
    )
    return bank, mapped.nearest, jnp.zeros_like(mapped.created)
