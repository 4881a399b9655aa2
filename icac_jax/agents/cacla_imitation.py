"""How an actor-critic of flat networks starts from demonstrations: regression and temporal differences."""

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
import optax

from icac_jax import networks
from icac_jax.agents import imitation
from icac_jax.agents.imitation import Demonstrations
from icac_jax.networks import Network
from icac_jax.precision import usual

# (critic [P], reward [], next observation [O], terminated [] bool) -> what the critic is to say [].
Target = Callable[[jax.Array, jax.Array, jax.Array, jax.Array], jax.Array]


@usual
def fitted(
    nets: tuple[Network, Network],
    params: tuple[jax.Array, jax.Array],
    target: Target,
    demonstrations: Demonstrations,
    key: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Parameters of actor and critic after `demonstrations.updates` batches (own).

    The actor descends |a - Ac(s)|^2 / 2, Eq. 5 for every demonstrated action: behaviour cloning (Pomerleau 1991). The
    critic descends Eq. 3, so that it comes to value what the demonstrator does. Both by Adam, which starts anew.

    Args:
      nets: of actor and critic.
      params: of actor [Pa] and critic [Pc], fresh ones.
      target: of the critic; taken as a constant (semi-gradient).
      demonstrations: what is shown.
      key: which transitions are drawn.
    """
    rule = optax.scale_by_adam()

    def body(number: jax.Array, carry: tuple[Any, Any]) -> tuple[Any, Any]:
        params, states = carry
        seen = imitation.batch(demonstrations, jax.random.fold_in(key, number))
        wanted = jax.vmap(target, (None, 0, 0, 0))(params[1], seen.reward, seen.next_observation, seen.terminated > 0)
        moved = []
        for net, old, state, outputs in zip(nets, params, states, (seen.action, wanted[:, None]), strict=True):
            each = jax.vmap(networks.descent, (None, None, 0, 0))(net, old, seen.observation, outputs)
            step, state = rule.update(jnp.mean(each, axis=0), state)
            moved.append((old + demonstrations.rate * cast(jax.Array, step), state))
        (actor, actor_state), (critic, critic_state) = moved
        return (actor, critic), (actor_state, critic_state)

    start = params, (rule.init(params[0]), rule.init(params[1]))
    return jax.lax.fori_loop(0, demonstrations.updates, body, start)[0]
