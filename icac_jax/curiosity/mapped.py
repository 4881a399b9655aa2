"""Signals on a map and its predictors: the intrinsic reward of `intrinsic`, and the same one paid in disorder."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from icac_jax.curiosity import intrinsic, predictors
from icac_jax.curiosity.base import Map, Paid, Signal, Slots, Step
from icac_jax.curiosity.intrinsic import CuriosityState
from icac_jax.curiosity.options import CuriositySpec
from icac_jax.curiosity.reward import TERMS, Term
from icac_jax.fast import threefry

# From so many latest bonuses of the lane `shuffled` draws.
REMEMBERED = 1000


def signal(spec: CuriositySpec, map: Map | None = None, terms: Mapping[str, Term] = TERMS) -> Signal:
    """A map, predictors and a reward that is a sum of terms.

    Args:
      spec: static choices, sizes included.
      map: the map; the one that `spec` describes by default.
      terms: of the reward, by name.
    """
    used = map or intrinsic.map_of(spec)

    def update(
        state: CuriosityState, step: Step, key: jax.Array, hyper: Any, enabled: jax.typing.ArrayLike
    ) -> tuple[CuriosityState, Paid]:
        new_state, wonder = intrinsic.update(spec, state, *step, hyper, enabled, used, terms)
        finite = jnp.isfinite(wonder.prediction_error + wonder.reward)
        return new_state, Paid(bonus=wonder.reward, terms=wonder.terms, finite=finite)

    return Signal(
        init=lambda key, hyper: intrinsic.init(spec, key, hyper, used),
        update=update,
        counts=lambda state: used.counts(state.map),
        map=used,
        slots=used.slots and _slots(used.slots, spec),
    )


def _slots(of_map: Slots, spec: CuriositySpec) -> Slots:
    """Fewer slots of the map are fewer predictors too, where each node has its own."""

    def cut(state: CuriosityState, slots: int) -> CuriosityState:
        bank = predictors.cut(state.bank, slots) if spec.predictors == "local" else state.bank
        return state.replace(map=of_map.cut(state.map, slots), bank=bank)

    return Slots(of_map.capacity, cut, lambda state: of_map.overflow(state.map))


class ShuffledState(CuriosityState):
    """The map, the predictors, and what was paid of late.

    Attributes:
      recent: [REMEMBERED] bonuses of the latest steps, in a ring.
    """

    recent: jax.Array


def shuffled(spec: CuriositySpec, map: Map | None = None, terms: Mapping[str, Term] = TERMS) -> Signal:
    """A control: each step is paid a bonus that one of the lane's last 1,000 steps earned, drawn at random.

    So bonuses are as large and as varied as those of the signal itself, and say nothing of the state. Arguments as for
    `signal`.
    """
    inside = signal(spec, map, terms)

    def init(key: jax.Array, hyper: Any) -> ShuffledState:
        whole = inside.init(key, hyper)
        return ShuffledState(**vars(whole), recent=jnp.zeros(REMEMBERED))

    def update(
        state: ShuffledState, step: Step, key: jax.Array, hyper: Any, enabled: jax.typing.ArrayLike
    ) -> tuple[ShuffledState, Paid]:
        plain, earned = inside.update(state, step, key, hyper, enabled)
        place = jnp.where(jnp.asarray(enabled), state.step % REMEMBERED, REMEMBERED)
        recent = state.recent.at[place].set(earned.bonus, mode="drop")
        drawn = threefry.below(threefry.fold_in(key, jnp.array(1)), jnp.minimum(state.step + 1, REMEMBERED))
        return ShuffledState(**vars(plain), recent=recent), Paid(bonus=recent[drawn], terms={}, finite=earned.finite)

    return inside._replace(init=init, update=update)
