"""Deep deterministic policy gradient (Lillicrap et al. 2016), with a replay buffer in each lane's state.

`Refinements` are what TD3 does otherwise; `agents.td3` has them. Everything is for one lane.
"""

import functools
from collections.abc import Callable
from typing import Any, Literal, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from flax import linen as nn
from flax import struct

from icac_jax.agents import hindsight, replay
from icac_jax.agents.base import Agent, Layers, Report, Transition
from icac_jax.agents.ddpg_options import DdpgHyper, DdpgSpec
from icac_jax.agents.replay import Experience, Replay
from icac_jax.envs.base import Environment
from icac_jax.fast.when import when
from icac_jax.fields import check_array

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


class DdpgState(struct.PyTreeNode):
    """What a lane remembers.

    Attributes:
      learned: networks and their optimisers.
      replay: the transitions.
      least: [] least reward seen, with its bonus.
      most: [] largest reward seen, with its bonus.
    """

    learned: Learned
    replay: Replay
    least: jax.Array
    most: jax.Array


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


def _apply(network: Mlp, params: Params, inputs: jax.Array) -> jax.Array:
    return cast(jax.Array, network.apply(params, inputs))


def policy_network(spec: DdpgSpec) -> Mlp:
    """Observation [O] to action [A] in [-1, 1]."""
    return Mlp((spec.hidden_units,) * spec.hidden_layers + (spec.action_size,), "tanh")


def value(spec: DdpgSpec, critics: Params, observation: jax.Array, action: jax.Array) -> jax.Array:
    """Action values [K, B] of K critics with parameters [K, ...] for observations [B, O] and actions [B, A]."""
    network = Mlp((spec.hidden_units,) * spec.hidden_layers + (1,))
    both = jnp.concatenate([observation, action], axis=-1)
    return jax.vmap(lambda critic: _apply(network, critic, both))(critics)[..., 0]


def init(spec: DdpgSpec, key: jax.Array, goal_size: int, refined: Refinements = DDPG) -> DdpgState:
    """Random networks, their copies as targets, an empty buffer.

    Args:
      spec: static choices.
      key: randomness of the weights.
      goal_size: entries of the goals that hindsight keeps.
      refined: how many critics there are.
    """
    actor_key, critics_key = jax.random.split(key)
    both = jnp.zeros(spec.observation_size + spec.action_size)
    network = Mlp((spec.hidden_units,) * spec.hidden_layers + (1,))
    actor = policy_network(spec).init(actor_key, both[: spec.observation_size])
    critics = jax.vmap(lambda key: network.init(key, both))(jax.random.split(critics_key, refined.critics))
    rule = optax.scale_by_adam()
    return DdpgState(
        learned=Learned(
            actor=actor,
            critics=critics,
            actor_target=actor,
            critics_target=critics,
            actor_rule=rule.init(actor),
            critics_rule=rule.init(critics),
            updates=jnp.zeros((), jnp.int32),
        ),
        replay=replay.init(spec.buffer_size, spec.observation_size, spec.action_size, goal_size),
        least=jnp.array(jnp.inf),
        most=jnp.array(-jnp.inf),
    )


def greedy_action(spec: DdpgSpec, state: DdpgState, observation: jax.Array) -> jax.Array:
    """The policy's action [A] for an observation [O]."""
    check_array("observation", observation, (spec.observation_size,))
    return _apply(policy_network(spec), state.learned.actor, observation)


def act(spec: DdpgSpec, state: DdpgState, observation: jax.Array, key: jax.Array, hyper: DdpgHyper) -> jax.Array:
    """An explored action [A] in [-1, 1]: the policy's with Gaussian noise, or a random one.

    Lillicrap 2016 has noise that is correlated in time; Fujimoto 2018 (Sec. 6.1) finds that plain noise does as well.
    """
    noise_key, action_key, choice_key = jax.random.split(key, 3)
    action = greedy_action(spec, state, observation)
    action = jnp.clip(action + hyper.sigma * jax.random.normal(noise_key, action.shape), -1.0, 1.0)
    random_action = jax.random.uniform(action_key, action.shape, minval=-1.0, maxval=1.0)
    is_random = jax.random.uniform(choice_key) < hyper.random_share
    return jnp.where(is_random | (state.replay.count < hyper.warm_up), random_action, action)


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
        _apply(policy_network(spec), learned.actor_target, batch.next_observation), batch.noise, hyper
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

    Arguments as in `targets`.

    Returns:
      What was learnt, and the critics' loss [] before the update.
    """
    target = targets(spec, refined, learned, batch, rewards, hyper)

    def critics_loss(critics: Params) -> jax.Array:
        errors = value(spec, critics, batch.observation, batch.action) - target
        return jnp.sum(jnp.mean(errors**2, axis=-1))

    loss, gradient = jax.value_and_grad(critics_loss)(learned.critics)
    critics, critics_rule = _descend(gradient, learned.critics_rule, learned.critics, hyper.critic_rate)
    learned = learned.replace(critics=critics, critics_rule=critics_rule, updates=learned.updates + 1)

    def with_actor(learned: Learned, observation: jax.Array, hyper: Any) -> Learned:
        def actor_loss(actor: Params) -> jax.Array:
            action = _apply(policy_network(spec), actor, observation)
            first = jax.tree.map(lambda leaf: leaf[:1], learned.critics)
            return -jnp.mean(value(spec, first, observation, action))

        gradient = jax.grad(actor_loss)(learned.actor)
        actor, actor_rule = _descend(gradient, learned.actor_rule, learned.actor, hyper.actor_rate)

        def follow(target: jax.Array, source: jax.Array) -> jax.Array:
            return target + hyper.tau * (source - target)

        return learned.replace(
            actor=actor,
            actor_rule=actor_rule,
            actor_target=jax.tree.map(follow, learned.actor_target, actor),
            critics_target=jax.tree.map(follow, learned.critics_target, learned.critics),
        )

    its_turn = jnp.asarray(learned.updates % refined.delay(hyper) == 0)
    return when(its_turn, with_actor, learned, batch.observation, hyper), loss


def update(
    spec: DdpgSpec,
    state: DdpgState,
    transition: Transition,
    key: jax.Array,
    hyper: Any,
    enabled: jax.typing.ArrayLike = True,
    refined: Refinements = DDPG,
) -> tuple[DdpgState, Report]:
    """Keeps a transition and learns from batches of what was kept.

    Args:
      spec: static choices.
      state: what the lane remembers.
      transition: the step.
      key: which transitions are drawn, which goals are replaced, the targets' noise.
      hyper: traced numbers.
      enabled: when False the state comes back unchanged (a frozen lane).
      refined: DDPG's own, or TD3's.
    """
    for name, array in (("observation", transition.observation), ("next_observation", transition.next_observation)):
        check_array(name, array, (spec.observation_size,))
    check_array("action", transition.action, (spec.action_size,))
    seen = Experience(
        observation=transition.observation,
        action=transition.action,
        next_observation=transition.next_observation,
        achieved=jnp.zeros(0) if spec.hindsight == "none" else transition.goal.achieved,
        reward=transition.reward,
        bonus=jnp.asarray(transition.bonus),
        terminated=transition.terminated,
    )
    buffer = replay.add(state.replay, seen, transition.terminated | transition.truncated, enabled)
    batches = _batches(spec, buffer, transition, key, hyper)
    least = jnp.minimum(state.least, jnp.min(batches.reward))
    most = jnp.maximum(state.most, jnp.max(batches.reward))
    wanted = enabled & (buffer.count >= hyper.warm_up)
    start = state.learned, jnp.zeros(())
    learned, loss = when(wanted, functools.partial(_learn_all, spec, refined), start, batches, (least, most), hyper)
    new_state = DdpgState(
        learned=learned,
        replay=buffer,
        least=jnp.where(enabled, least, state.least),
        most=jnp.where(enabled, most, state.most),
    )
    return new_state, Report(sums={"critic_loss": loss}, last={}, finite=jnp.isfinite(loss))


def _batches(spec: DdpgSpec, buffer: Replay, transition: Transition, key: jax.Array, hyper: Any) -> Batch:
    """What the updates of a step learn from, leaves [U, B, ...] for U updates."""
    draw_key, goal_key, noise_key = jax.random.split(key, 3)
    number = spec.updates_per_step * spec.batch_size
    places = replay.sample(buffer, draw_key, number)
    drawn = replay.read(buffer, places, spec.observation_size, spec.action_size)
    if spec.hindsight != "none":
        assert transition.goal is not None  # the registry builds no learner with hindsight for another environment
        drawn = hindsight.relabelled(spec.hindsight, buffer, places, drawn, transition.goal, goal_key, hyper)
    batch = Batch(
        observation=drawn.observation,
        action=drawn.action,
        reward=hyper.reward_scale * drawn.reward + hyper.reward_bias + drawn.bonus,
        next_observation=drawn.next_observation,
        terminated=drawn.terminated,
        noise=jax.random.normal(noise_key, drawn.action.shape),
    )
    return jax.tree.map(lambda leaf: leaf.reshape(spec.updates_per_step, spec.batch_size, *leaf.shape[1:]), batch)


def _learn_all(
    spec: DdpgSpec,
    refined: Refinements,
    start: tuple[Learned, jax.Array],
    batches: Batch,
    rewards: tuple[jax.Array, jax.Array],
    hyper: Any,
) -> tuple[Learned, jax.Array]:
    """What was learnt after all batches [U, B, ...], and their mean loss []."""

    def one(learned: Learned, batch: Batch) -> tuple[Learned, jax.Array]:
        return learn(spec, refined, learned, batch, rewards, hyper)

    learned, losses = jax.lax.scan(one, start[0], batches)
    return learned, jnp.mean(losses)


def _layers(state: DdpgState) -> Layers:
    found = state.learned.actor["params"]
    each = [found[f"Dense_{number}"] for number in range(len(found))]
    return Layers(tuple(layer["kernel"].T for layer in each), tuple(layer["bias"] for layer in each), "relu", "tanh")


@functools.cache
def agent(spec: DdpgSpec, goal_size: int = 0, refined: Refinements = DDPG) -> Agent:
    """DDPG, or with its `Refinements` TD3, as an agent; equal arguments give the same object.

    Args:
      spec: static choices, sizes included.
      goal_size: entries of the goals that hindsight keeps.
      refined: DDPG's own, or TD3's.
    """
    return Agent(
        init=lambda key, hyper: init(spec, jax.random.split(key)[0], goal_size, refined),
        act=lambda state, observation, key, hyper: act(spec, state, observation, key, hyper),
        update=lambda state, transition, key, hyper, enabled: update(
            spec, state, transition, key, hyper, enabled, refined
        ),
        greedy=lambda state, observation, hyper: greedy_action(spec, state, observation),
        layers=_layers,
    )


def build(spec: DdpgSpec, env: Environment) -> Agent:
    """DDPG for an environment.

    Raises:
      ConfigError: hindsight is wanted and the environment has no goals.
    """
    return agent(spec, hindsight.goal_size(spec.hindsight, env))
