"""Random network distillation (Burda et al. 2019): the error of learning what a random network says of a state.

The error falls where the learner has been and stays large where it has not. The networks are as small as the
predictors. Bonuses are divided by their running root mean square; Burda et al. divide by a running deviation of returns
(Sec. 2.4), for the same reason: a scale that does not drift. States are in [-1, 1] and are not normalised again.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax import networks
from icac_jax.curiosity.base import Paid, Signal, Step
from icac_jax.curiosity.options import CuriositySpec
from icac_jax.networks import Network
from icac_jax.precision import usual


class RndState(struct.PyTreeNode):
    """The two networks and the running scale.

    Attributes:
      target: [P] parameters of the random network, which stay as they are.
      predictor: [P] parameters of the network that learns what the other one says.
      square: [] mean of the squared errors so far.
      steps: [] int32, transitions seen.
    """

    target: jax.Array
    predictor: jax.Array
    square: jax.Array
    steps: jax.Array


def network(spec: CuriositySpec) -> Network:
    """State [D] to as many features as a hidden layer has units."""
    hidden = (spec.hidden_units,) * spec.hidden_layers
    return Network((spec.map_size, *hidden, spec.hidden_units))


@usual
def init(spec: CuriositySpec, key: jax.Array, hyper: Any) -> RndState:
    """Two random networks; the target's parameters are larger, so that its outputs differ from place to place."""
    target_key, predictor_key = jax.random.split(key)
    net = network(spec)
    return RndState(
        target=networks.init(net, target_key, hyper.rnd_target_scale),
        predictor=networks.init(net, predictor_key, hyper.predictor_weight_scale),
        square=jnp.zeros(()),
        steps=jnp.zeros((), jnp.int32),
    )


@usual
def update(
    spec: CuriositySpec, state: RndState, step: Step, hyper: Any, enabled: jax.typing.ArrayLike = True
) -> tuple[RndState, Paid]:
    """Pays the error at the next state, over its running root mean square, and learns from it.

    Args:
      spec: static choices.
      state: the networks.
      step: the transition; its next state is what counts.
      hyper: `predictor_rate`.
      enabled: when False nothing is written (a frozen lane).
    """
    net = network(spec)
    wanted = networks.apply(net, state.target, step.next_sensed)
    error = jnp.mean((networks.apply(net, state.predictor, step.next_sensed) - wanted) ** 2)
    descent = networks.descent(net, state.predictor, step.next_sensed, wanted)
    square = state.square + (error**2 - state.square) / (state.steps + 1)
    learnt = RndState(
        target=state.target,
        predictor=state.predictor + hyper.predictor_rate * descent,
        square=square,
        steps=state.steps + 1,
    )
    new_state = jax.tree.map(lambda new, old: jnp.where(enabled, new, old), learnt, state)
    scale = jnp.sqrt(square)
    bonus = jnp.where(scale > 0, error / jnp.where(scale > 0, scale, 1.0), 0.0)
    return new_state, Paid(bonus=bonus, terms={}, finite=jnp.isfinite(bonus))


def signal(spec: CuriositySpec) -> Signal:
    """Random network distillation as a signal.

    Args:
      spec: static choices, sizes included; those of the map play no part.
    """
    return Signal(
        init=lambda key, hyper: init(spec, key, hyper),
        update=lambda state, step, key, hyper, enabled: update(spec, state, step, hyper, enabled),
    )
