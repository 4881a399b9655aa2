"""One forward model per map node, its window of prediction errors, and the learning progress (Eq. 8-10).

N is the map's capacity, P the parameters of one predictor, W the window's length.
"""

from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax import networks
from icac_jax.curiosity.options import CuriositySpec
from icac_jax.fields import check_array
from icac_jax.networks import Network
from icac_jax.precision import usual


class BankState(struct.PyTreeNode):
    """The predictors of all nodes.

    Attributes:
      params: [N, P] parameters of each node's predictor.
      fresh: [N, P] the random parameters with which a node created in that slot starts.
      errors: [N, W] ring buffer of each node's prediction errors.
      queries: [N] int32, errors recorded since the node was created.
    """

    params: jax.Array
    fresh: jax.Array
    errors: jax.Array
    queries: jax.Array


class BankInfo(NamedTuple):
    """What one query gave.

    Attributes:
      prediction_error: [] e^prd (Eq. 8).
      learning_progress: [] |<e_t> - <e_{t-T}>| of the node (first term of Eq. 10).
      average: [] <e_t> of the node (Eq. 9).
      average_before: [] <e_{t-T}>; the same as `average` where there are too few errors for it.
      queries: [] int32, how often the node has been asked since it was created, this query among them.
    """

    prediction_error: jax.Array
    learning_progress: jax.Array
    average: jax.Array
    average_before: jax.Array
    queries: jax.Array


@usual
def init(net: Network, key: jax.Array, capacity: int, window: int, scale: jax.typing.ArrayLike) -> BankState:
    """Random predictors, no errors yet.

    Args:
      net: the predictor's description.
      key: randomness.
      capacity: N.
      window: W, at least mu + T.
      scale: initial parameters are uniform in +-`scale`.
    """
    fresh = jax.vmap(networks.init, (None, 0, None))(net, jax.random.split(key, capacity), scale)
    return BankState(
        params=fresh,
        fresh=fresh.copy(),
        errors=jnp.zeros((capacity, window)),
        queries=jnp.zeros((capacity,), jnp.int32),
    )


def cut(state: BankState, slots: int) -> BankState:
    """The predictors of the first slots alone."""
    return BankState(state.params[:slots], state.fresh[:slots], state.errors[:slots], state.queries[:slots])


class Query(NamedTuple):
    """What a predictor is asked and trained with.

    Attributes:
      node: [] int32, slot of the responsible node.
      created: [] bool, the node is new: start from fresh parameters and an empty window.
      inputs: [sizes[0]] state and action.
      target: [sizes[-1]] the next state.
    """

    node: jax.Array
    created: jax.Array
    inputs: jax.Array
    target: jax.Array


def mean_error(
    errors: jax.Array,
    queries: jax.Array,
    mu: jax.typing.ArrayLike,
    lag: jax.typing.ArrayLike,
    divide_by: Literal["available", "mu"] = "available",
) -> jax.Array:
    """Average [] of up to `mu` errors as it stood `lag` queries ago (Eq. 9).

    Args:
      errors: [W] ring buffer of one node; query k (from 0) is at k modulo W.
      queries: [] int32, errors recorded so far.
      mu: errors averaged.
      lag: how many queries ago.
      divide_by: number of errors that there are, or always mu (Eq. 9 to the letter).

    Returns:
      The average, 0 when there was no error yet.
    """
    window = errors.shape[0]
    # One division for all places: a CPU has no vectors of those.
    ahead = (queries - 1) % window - jnp.arange(window)
    age = jnp.where(ahead < 0, ahead + window, ahead)
    oldest = jnp.minimum(jnp.minimum(lag + mu, queries), window)
    counted = (age >= lag) & (age < oldest)
    number = oldest - lag if divide_by == "available" else jnp.asarray(mu)
    return jnp.sum(jnp.where(counted, errors, 0.0)) / jnp.maximum(number, 1)


def averages(
    spec: CuriositySpec, errors: jax.Array, queries: jax.Array, hyper: Any
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """<e_t> [], <e_{t-T}> [] and whether there is the latter yet, [] bool, of one node (Eq. 9).

    Before T earlier averages exist there is none, or with `early_learning_progress` "first" it is the first average.
    The error just made is e_{t+1} (Eq. 8), so that to the letter the reward takes the averages as they stood one query
    ago: `learning_progress_time` "previous". Algorithm 2 updates the predictors (line 8) before it computes the reward
    (line 9): "current".

    Args:
      spec: the choices named above, and `window_mean`.
      errors: [W] ring buffer of one node, as in `mean_error`.
      queries: [] int32, errors recorded so far.
      hyper: `mu` and `T`.
    """
    newest = 0 if spec.learning_progress_time == "current" else 1
    oldest = newest + jnp.asarray(hyper.T)
    if spec.early_learning_progress == "first":
        oldest = jnp.maximum(jnp.minimum(oldest, queries - 1), newest)
    now = mean_error(errors, queries, hyper.mu, newest, spec.window_mean)
    then = mean_error(errors, queries, hyper.mu, oldest, spec.window_mean)
    return now, then, queries > oldest


def learning_progress(spec: CuriositySpec, errors: jax.Array, queries: jax.Array, hyper: Any) -> jax.Array:
    """|<e_t> - <e_{t-T}>| [] of one node (first term of Eq. 10, without its weight); arguments as for `averages`."""
    now, then, known = averages(spec, errors, queries, hyper)
    return jnp.where(known, jnp.abs(now - then), 0.0)


@usual
def update(
    net: Network,
    spec: CuriositySpec,
    state: BankState,
    query: Query,
    hyper: Any,
    enabled: jax.typing.ArrayLike = True,
) -> tuple[BankState, BankInfo]:
    """Queries and trains the predictor of one node (Alg. 1 lines 15-17, Eq. 8-10); the others are not touched.

    Args:
      net: the predictor's description.
      spec: `prediction_error_time`, and what `learning_progress` reads.
      state: the bank.
      query: who is asked what.
      hyper: `predictor_rate`, `mu` and `T`.
      enabled: when False nothing is written (a frozen lane).

    Returns:
      The bank and the node's error and learning progress.
    """
    node, created, inputs, target = query
    check_array("inputs", inputs, (net.sizes[0],))
    check_array("target", target, (net.sizes[-1],))
    params = jnp.where(created, state.fresh[node], state.params[node])
    trained = params + hyper.predictor_rate * networks.descent(net, params, inputs, target)
    asked = params if spec.prediction_error_time == "before" else trained
    error = jnp.linalg.norm(networks.apply(net, asked, inputs) - target)  # Eq. 8

    queries = jnp.where(created, 0, state.queries[node])
    position = queries % state.errors.shape[1]
    errors = state.errors[node].at[position].set(error)
    queries = queries + 1
    now, then, known = averages(spec, errors, queries, hyper)

    write = jnp.where(enabled, node, state.queries.shape[0])
    new_state = BankState(
        params=state.params.at[write].set(trained, mode="drop"),
        fresh=state.fresh,
        errors=state.errors.at[write].set(errors, mode="drop"),
        queries=state.queries.at[write].set(queries, mode="drop"),
    )
    return new_state, BankInfo(
        prediction_error=error,
        learning_progress=jnp.where(known, jnp.abs(now - then), 0.0),
        average=now,
        average_before=jnp.where(known, then, now),
        queries=queries,
    )
