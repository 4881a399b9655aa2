"""The mathematics of DDPG (Lillicrap et al. 2016): what one batch changes in a lane's networks.

`Refinements` are what TD3 does otherwise; `agents.td3` has them.
"""

import functools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from flax import linen as nn
from flax import struct

from icac_jax.agents.ddpg_options import DdpgSpec
from icac_jax.fast.when import when

Params = Any


class Mlp(nn.Module):
    """Hidden layers of rectified units and a linear or tanh output; inputs [..., before] to outputs [..., last].

    Attributes:
      sizes: widths of the layers after the input.
      output: activation of the last one.
    """

    sizes: tuple[int, ...]
    output: Literal["linear", "tanh"] = "linear"

    @nn.compact
    def __call__(self, inputs: jax.Array) -> jax.Array:
        """Applies the network."""
        # Weights uniform in +-1 / sqrt(before) (Lillicrap 2016, Sec. 7), in the last layer too; biases zero.
        layer = functools.partial(
            nn.Dense,
            param_dtype=jnp.result_type(float),
            kernel_init=nn.initializers.variance_scaling(1 / 3, "fan_in", "uniform"),
        )
        values = inputs
        for width in self.sizes[:-1]:
            values = nn.relu(layer(width)(values))
        values = layer(self.sizes[-1])(values)
        return nn.tanh(values) if self.output == "tanh" else values


class Learned(struct.PyTreeNode):
    """What a batch changes.

    Attributes:
      actor: parameters of the policy.
      critics: parameters of the action values, leaves [K, ...] for K critics.
      actor_target: the policy of the targets.
      critics_target: the action values of the targets.
      actor_rule: optax state of the actor.
      critics_rule: optax state of the critics.
      updates: [] int32, batches learnt from.
    """

    actor: Params
    critics: Params
    actor_target: Params
    critics_target: Params
    actor_rule: optax.OptState
    critics_rule: optax.OptState
    updates: jax.Array


class Batch(NamedTuple):
    """What an update learns from.

    Attributes:
      observation: [B, O].
      action: [B, A].
      reward: [B] scaled, with the bonus.
      next_observation: [B, O].
      terminated: [B] 1 or 0.
      noise: [B, A] of the standard normal distribution, for whoever smooths the target.
    """

    observation: jax.Array
    action: jax.Array
    reward: jax.Array
    next_observation: jax.Array
    terminated: jax.Array
    noise: jax.Array


class Refinements(NamedTuple):
    """What may be done otherwise than DDPG does it.

    Attributes:
      critics: how many; the target takes the least of their values.
      smoothed: (action [B, A] of the target policy, noise [B, A], hyper) -> the action [B, A] that the target values.
      delay: (hyper) -> [] critic updates per update of the actor and of the target networks.
    """

    critics: int
    smoothed: Callable[[jax.Array, jax.Array, Any], jax.Array]
    delay: Callable[[Any], jax.typing.ArrayLike]


DDPG = Refinements(critics=1, smoothed=lambda action, noise, hyper: action, delay=lambda hyper: 1)


def apply(network: Mlp, params: Params, inputs: jax.Array) -> jax.Array:
    """Outputs [..., last] of a network with these parameters for inputs [..., before]."""
    return cast(jax.Array, network.apply(params, inputs))


def policy_network(spec: DdpgSpec) -> Mlp:
    """Observation [O] to action [A] in [-1, 1]."""
    return Mlp((spec.hidden_units,) * spec.hidden_layers + (spec.action_size,), "tanh")


def preactivations(spec: DdpgSpec) -> Mlp:
    """The same network before its last tanh: observation [O] to any numbers [A]."""
    return policy_network(spec).clone(output="linear")


def critic_network(spec: DdpgSpec) -> Mlp:
    """Observation and action side by side [O + A] to their value [1]."""
    return Mlp((spec.hidden_units,) * spec.hidden_layers + (1,))


def value(spec: DdpgSpec, critics: Params, observation: jax.Array, action: jax.Array) -> jax.Array:
    """Action values [K, B] of K critics with parameters [K, ...] for observations [B, O] and actions [B, A]."""
    network = critic_network(spec)
    both = jnp.concatenate([observation, action], axis=-1)
    return jax.vmap(lambda critic: apply(network, critic, both))(critics)[..., 0]


def _descend(
    gradient: Params, rule_state: optax.OptState, params: Params, rate: jax.typing.ArrayLike
) -> tuple[Params, optax.OptState]:
    """Parameters and Adam's state after one step of the rate, which is traced, down the gradient."""
    steps, rule_state = optax.scale_by_adam().update(gradient, rule_state)
    return jax.tree.map(lambda old, step: old - rate * step, params, steps), rule_state


def targets(
    spec: DdpgSpec,
    refined: Refinements,
    learned: Learned,
    batch: Batch,
    rewards: tuple[jax.typing.ArrayLike, jax.typing.ArrayLike],
    hyper: Any,
) -> jax.Array:
    """What the critics are to say [B]: y = r + gamma Q'(s', mu'(s')) (Lillicrap 2016, Alg. 1).

    An episode that ended because time was up goes on; one that reached its goal does not.

    Args:
      spec: static choices.
      refined: DDPG's own, or TD3's.
      learned: the networks.
      batch: the transitions.
      rewards: least and largest reward [] of a step, by which `DdpgSpec.clip_target` bounds the targets: no return is
        beyond that of such a step, alone or for ever.
      hyper: traced numbers.
    """
    action = refined.smoothed(
        apply(policy_network(spec), learned.actor_target, batch.next_observation), batch.noise, hyper
    )
    ahead = jnp.min(value(spec, learned.critics_target, batch.next_observation, action), axis=0)
    target = batch.reward + hyper.gamma * (1.0 - batch.terminated) * ahead
    if not spec.clip_target:
        return target
    least, most = (jnp.asarray(reward) for reward in rewards)
    for_ever = 1.0 / (1.0 - hyper.gamma)
    return jnp.clip(target, jnp.minimum(least, least * for_ever), jnp.maximum(most, most * for_ever))


def learn(
    spec: DdpgSpec,
    refined: Refinements,
    learned: Learned,
    batch: Batch,
    rewards: tuple[jax.typing.ArrayLike, jax.typing.ArrayLike],
    hyper: Any,
) -> tuple[Learned, jax.Array]:
    """One update of the critics, and of the actor and the targets when it is their turn (Lillicrap 2016, Alg. 1).

    Arguments and result as in `learn_critics`.
    """
    learned, loss = learn_critics(spec, refined, learned, batch, rewards, hyper)

    def with_actor(learned: Learned, observation: jax.Array, hyper: Any) -> Learned:
        def actor_loss(actor: Params) -> jax.Array:
            before = apply(preactivations(spec), actor, observation)
            first = jax.tree.map(lambda leaf: leaf[:1], learned.critics)
            loss = -jnp.mean(value(spec, first, observation, nn.tanh(before)))
            # Where the tanh is flat the gradient vanishes: a policy that got there stays (Andrychowicz 2017, App. A).
            penalty = hyper.preactivation_penalty
            return loss if penalty is None else loss + penalty * jnp.mean(before**2)

        gradient = jax.grad(actor_loss)(learned.actor)
        actor, actor_rule = _descend(gradient, learned.actor_rule, learned.actor, hyper.actor_rate)
        return followed(learned.replace(actor=actor, actor_rule=actor_rule), hyper.tau)

    its_turn = jnp.asarray(learned.updates % refined.delay(hyper) == 0)
    return when(its_turn, with_actor, learned, batch.observation, hyper), loss


def learn_critics(
    spec: DdpgSpec,
    refined: Refinements,
    learned: Learned,
    batch: Batch,
    rewards: tuple[jax.typing.ArrayLike, jax.typing.ArrayLike],
    hyper: Any,
) -> tuple[Learned, jax.Array]:
    """One update of the critics; arguments as in `targets`.

    Returns:
      What was learnt, and the critics' loss [] before the update.
    """
    target = targets(spec, refined, learned, batch, rewards, hyper)

    def critics_loss(critics: Params) -> jax.Array:
        errors = value(spec, critics, batch.observation, batch.action) - target
        return jnp.sum(jnp.mean(errors**2, axis=-1))

    loss, gradient = jax.value_and_grad(critics_loss)(learned.critics)
    critics, critics_rule = _descend(gradient, learned.critics_rule, learned.critics, hyper.critic_rate)
    return learned.replace(critics=critics, critics_rule=critics_rule, updates=learned.updates + 1), loss


def clone(
    spec: DdpgSpec,
    learned: Learned,
    rule_state: optax.OptState,
    observation: jax.Array,
    action: jax.Array,
    rate: jax.typing.ArrayLike,
) -> tuple[Learned, optax.OptState]:
    """One update of the actor towards actions [B, A] at observations [B, O]: behaviour cloning (Pomerleau 1991).

    Args:
      spec: static choices.
      learned: the networks.
      rule_state: optax state of the cloning, which is none of the actor's own.
      observation: [B, O].
      action: [B, A].
      rate: learning rate.
    """

    def loss(actor: Params) -> jax.Array:
        return jnp.mean((apply(policy_network(spec), actor, observation) - action) ** 2)

    actor, rule_state = _descend(jax.grad(loss)(learned.actor), rule_state, learned.actor, rate)
    return learned.replace(actor=actor), rule_state


def followed(learned: Learned, tau: jax.typing.ArrayLike) -> Learned:
    """The target networks a share `tau` nearer to those that they follow."""

    def follow(target: jax.Array, source: jax.Array) -> jax.Array:
        return target + tau * (source - target)

    return learned.replace(
        actor_target=jax.tree.map(follow, learned.actor_target, learned.actor),
        critics_target=jax.tree.map(follow, learned.critics_target, learned.critics),
    )


def flops(spec: DdpgSpec, refined: Refinements) -> int:
    """Floating-point operations of one step's updates, the actor learning in each of them.

    Two per weight and row of the batch forward, four backward: of the critics at their targets and at what was done,
    of the actor at the next observation and at its own, and of the critic that the actor's gradient goes through.
    """
    hidden = spec.hidden_units * (spec.observation_size + (spec.hidden_layers - 1) * spec.hidden_units)
    actor = hidden + spec.hidden_units * spec.action_size
    critic = hidden + spec.hidden_units * (spec.action_size + 1)
    per_row = refined.critics * (2 + 6) * critic + (2 + 6) * actor + 6 * critic
    return spec.updates_per_step * spec.batch_size * per_row
