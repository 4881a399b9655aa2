"""Rivals and controls of Eq. 10 on the paper's map and predictors: terms of rewards that are not the paper's."""

from typing import Any

import jax
import jax.numpy as jnp

from icac_jax.curiosity.options import CuriositySpec
from icac_jax.curiosity.reward import Seen


def normalised_progress(spec: CuriositySpec, seen: Seen, hyper: Any) -> jax.Array:
    """|<e_t> - <e_{t-T}>| over the larger of the two: progress as a share of the error, in [0, 1]. Own."""
    now, before = seen.predicted.average, seen.predicted.average_before
    larger = jnp.maximum(now, before)
    return jnp.where(larger > 0, jnp.abs(now - before) / jnp.where(larger > 0, larger, 1.0), 0.0)


def signed_progress(spec: CuriositySpec, seen: Seen, hyper: Any) -> jax.Array:
    """<e_{t-T}> - <e_t>: a predictor that gets worse costs something (Oudeyer, Kaplan, Hafner 2007, Eq. 4)."""
    return seen.predicted.average_before - seen.predicted.average


def counts(spec: CuriositySpec, seen: Seen, hyper: Any) -> jax.Array:
    """1 / sqrt(n) for the n-th visit of a node (Strehl and Littman 2008, MBIE-EB; Bellemare et al. 2016, Sec. 4).

    A node is visited where it is responsible for the state; visits are counted from its creation on.
    """
    return jax.lax.rsqrt(seen.predicted.queries.astype(seen.mapped.distance.dtype))


def forward_error(spec: CuriositySpec, seen: Seen, hyper: Any) -> jax.Array:
    """1/2 e^2 of one forward model for the whole space (Pathak et al. 2017, Eq. 6).

    Its features are the state itself: learnt ones leave out what actions cannot change, and here they change all of it.
    """
    return 0.5 * seen.predicted.prediction_error**2


def constant(spec: CuriositySpec, seen: Seen, hyper: Any) -> jax.Array:
    """1 for every step, a control: what a bonus does by its size alone, with `curiosity` as that size."""
    return jnp.ones_like(seen.mapped.distance)


def nothing(spec: CuriositySpec, seen: Seen, hyper: Any) -> jax.Array:
    """0 for every step, a control: map and predictors learn and are not heard."""
    return jnp.zeros_like(seen.mapped.distance)
