"""A map, a bank of predictors and the intrinsic reward they give (Sec. III, Eq. 8-10).

Independent of any learner: it can reward any agent's transitions. `agents.curious` puts it around an agent.
"""

import functools
from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.curiosity import maps, predictors
from icac_jax.curiosity.base import Map, MapInfo
from icac_jax.curiosity.options import CuriosityHyper, CuriositySpec
from icac_jax.curiosity.predictors import BankState, Query
from icac_jax.curiosity.reward import TERMS, Seen, Term
from icac_jax.fields import check_array
from icac_jax.networks import Network
from icac_jax.precision import usual


class CuriosityState(struct.PyTreeNode):
    """The map and the multi-predictor network.

    Attributes:
      map: the map of experience, of whatever kind.
      bank: one predictor per node, or a single one with `CuriositySpec.predictors` "single" (N = 1).
      step: [] int32, transitions seen.
      last_created: [] int32, step at which the latest node was created.
    """

    map: Any
    bank: BankState
    step: jax.Array
    last_created: jax.Array


class CuriosityInfo(NamedTuple):
    """The intrinsic reward and its terms, all [] and all weights applied.

    Attributes:
      reward: r^int (Eq. 10).
      terms: its terms by name.
      prediction_error: e^prd of the node asked (Eq. 8).
      node: int32, slot of the responsible node.
      created: bool, a node was created.
    """

    reward: jax.Array
    terms: dict[str, jax.Array]
    prediction_error: jax.Array
    node: jax.Array
    created: jax.Array


def predictor_network(spec: CuriositySpec) -> Network:
    """State [D] and action [A] to the next state [D] (Sec. III.A)."""
    hidden = (spec.hidden_units,) * spec.hidden_layers
    return Network((spec.map_size + spec.action_size, *hidden, spec.map_size), spec.predictor_output)


def map_of(spec: CuriositySpec) -> Map:
    """The map that the choices describe."""
    return maps.build(spec)


@usual
def init(spec: CuriositySpec, key: jax.Array, hyper: CuriosityHyper, map: Map | None = None) -> CuriosityState:
    """A fresh map and a fresh bank.

    Args:
      spec: static choices.
      key: randomness of first nodes and predictors.
      hyper: traced numbers; the first nodes' range and the scale of initial weights are used.
      map: the map; the one that `spec` describes by default.
    """
    map = map or map_of(spec)
    map_key, bank_key = jax.random.split(key)
    return CuriosityState(
        map=map.init(map_key, hyper),
        bank=predictors.init(
            predictor_network(spec),
            bank_key,
            map.capacity if spec.predictors == "local" else 1,
            spec.window,
            hyper.predictor_weight_scale,
        ),
        step=jnp.zeros((), jnp.int32),
        last_created=jnp.zeros((), jnp.int32),
    )


@usual
def update(
    spec: CuriositySpec,
    state: CuriosityState,
    sensed: jax.Array,
    action: jax.Array,
    next_sensed: jax.Array,
    hyper: CuriosityHyper,
    enabled: jax.typing.ArrayLike = True,
    map: Map | None = None,
    terms: Mapping[str, Term] = TERMS,
) -> tuple[CuriosityState, CuriosityInfo]:
    """Learns from one transition and rewards it (Alg. 2 lines 8-9).

    Args:
      spec: static choices.
      state: the map and the predictors.
      sensed: [D] s_t, in [-1, 1]; D is `CuriositySpec.map_size`.
      action: [A] a_t, in units of the action bound.
      next_sensed: [D] s_{t+1}.
      hyper: traced numbers.
      enabled: when False nothing is written (a frozen lane).
      map: the map; the one that `spec` describes by default.
      terms: of the reward, by name.

    Returns:
      The map and the predictors, and the intrinsic reward with its terms.

    Raises:
      ConfigError: an array has another shape or type than the choices say.
    """
    check_array("sensed", sensed, (spec.map_size,))
    check_array("action", action, (spec.action_size,))
    check_array("next_sensed", next_sensed, (spec.map_size,))
    map = map or map_of(spec)
    enabled = jnp.asarray(enabled)
    new_map, mapped = map.update(state.map, sensed, hyper, enabled)
    bank, asked, fresh = _asked(spec, state.bank, mapped)
    query = Query(asked, fresh, jnp.concatenate([sensed, action]), next_sensed)
    bank, predicted = predictors.update(predictor_network(spec), spec, bank, query, hyper, enabled)
    last_created = jnp.where(mapped.created, state.step, state.last_created)

    seen = Seen(mapped, predicted, state.step, last_created)
    values = {name: term(spec, seen, hyper) for name, term in terms.items()}
    first, *others = values.values()
    new_state = CuriosityState(map=new_map, bank=bank, step=state.step + enabled, last_created=last_created)
    info = CuriosityInfo(
        reward=functools.reduce(jnp.add, others, first),  # Eq. 10
        terms=values,
        prediction_error=predicted.prediction_error,
        node=mapped.node,
        created=mapped.created,
    )
    return new_state, info


def _asked(spec: CuriositySpec, bank: BankState, mapped: MapInfo) -> tuple[BankState, jax.Array, jax.Array]:
    """The bank, the slot of the predictor that is asked and trained, and whether that predictor starts anew."""
    if spec.predictors == "single":
        return bank, jnp.zeros_like(mapped.node), jnp.zeros_like(mapped.created)
    if mapped.started is not None:
        return _started(bank, mapped.started, mapped.started), mapped.node, jnp.zeros_like(mapped.created)
    if spec.prediction_node == "created":
        return bank, mapped.node, mapped.created
    # The created node gets its fresh predictor and an empty window, but n is asked.
    write = jnp.where(mapped.created, mapped.node, bank.queries.shape[0])
    return _started(bank, write, mapped.node), mapped.nearest, jnp.zeros_like(mapped.created)


def _started(bank: BankState, write: jax.Array, slot: jax.Array) -> BankState:
    """A fresh predictor and an empty window for `slot`, at `write`: the same slot, or beyond the end for nobody."""
    return bank.replace(
        params=bank.params.at[write].set(bank.fresh[slot], mode="drop"),
        queries=bank.queries.at[write].set(0, mode="drop"),
    )
