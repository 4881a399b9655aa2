"""The intrinsic reward: a sum of terms (Eq. 10).

A term is a function of what the step showed. Adding one is a function here and a line in `TERMS`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from icac_jax.curiosity.base import MapInfo
from icac_jax.curiosity.options import CuriositySpec
from icac_jax.curiosity.predictors import BankInfo


class Seen(NamedTuple):
    """What a term of the reward may look at.

    Attributes:
      mapped: what the map did with the state.
      predicted: what the predictor of the responsible node said.
      step: [] int32, transitions seen before this one.
      last_created: [] int32, step at which the latest node was created.
    """

    mapped: MapInfo
    predicted: BankInfo
    step: jax.Array
    last_created: jax.Array


# (choices, what the step showed, traced numbers) -> the term [], its weight applied.
Term = Callable[[CuriositySpec, Seen, Any], jax.Array]


def learning_progress(spec: CuriositySpec, seen: Seen, hyper: Any) -> jax.Array:
    """|<e_t> - <e_{t-T}>|: how much the node's predictor has changed of late (first term of Eq. 10)."""
    return hyper.learning_progress_weight * seen.predicted.learning_progress


def perception_error(spec: CuriositySpec, seen: Seen, hyper: Any) -> jax.Array:
    """|s_t - w_n|: how far the state is from the map (second term of Eq. 10).

    "After which it can be neglected" (Sec. III.B): both gates, a half-life and the time since the last new node, are
    open for ever by default.
    """
    distance = seen.mapped.distance
    if spec.creation_perception_error == "zero":
        distance = jnp.where(seen.mapped.created, 0.0, distance)
    gate = jnp.exp2(-seen.step / hyper.perception_half_life)
    gate = jnp.where(seen.step - seen.last_created > hyper.perception_patience, 0.0, gate)
    return hyper.perception_error_weight * gate * distance


# The terms of Eq. 10 by name; each is a column of the records.
TERMS: dict[str, Term] = {
    "learning_progress": learning_progress,
    "perception_error": perception_error,
}
