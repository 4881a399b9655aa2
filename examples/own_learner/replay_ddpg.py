"""A learner from outside the package: DDPG (Lillicrap et al. 2016) with a replay buffer in each lane's state.

Everything here is for one lane; icac_jax vmaps it over seeds and settings, keeps its state in checkpoints, and takes
the options from the two records below.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import optax
from flax import struct

from icac_jax import Agent, Learner, Report, Transition, networks
from icac_jax.agents.base import Layers
from icac_jax.fields import Numbers, param
from icac_jax.networks import Network


@dataclasses.dataclass(frozen=True)
class Spec:
    """What is fixed when the program is compiled."""

    observation_size: int = param(4, "entries of an observation", source="environment", low=1, derived=True)
    action_size: int = param(2, "entries of an action", source="environment", low=1, derived=True)
    hidden_units: int = param(32, "width of the hidden layer", source="own", low=1, high=1024)
    buffer: int = param(4096, "transitions kept per lane", source="own", low=2, high=10**6)
    batch: int = param(64, "transitions per update", source="own", low=1, high=4096)


class Hyper(Numbers):
    """Numbers that may differ from lane to lane within one compile."""

    gamma: float = param(0.95, "discount factor", source="own", low=0.0, high=1.0, open_high=True)
    tau: float = param(0.01, "rate of the target networks", source="Alg. 1", low=0.0, high=1.0, open_low=True)
    sigma: float = param(0.3, "deviation of the exploration", unit="action bound", source="own", low=0.0)
    rate: float = param(1e-3, "learning rate", source="own", low=0.0, open_low=True)
    reward_scale: float = param(0.02, "factor on the reward", source="own", low=0.0, open_low=True)


class State(struct.PyTreeNode):
    """What a lane remembers: P parameters of each network, B transitions."""

    actor: jax.Array
    critic: jax.Array
    actor_target: jax.Array
    critic_target: jax.Array
    actor_rule: optax.OptState
    critic_rule: optax.OptState
    buffer: tuple[jax.Array, ...]
    count: jax.Array


@functools.cache
def agent(spec: Spec) -> Agent:
    """The learner with these choices."""
    policy = Network((spec.observation_size, spec.hidden_units, spec.action_size), "tanh")
    quality = Network((spec.observation_size + spec.action_size, spec.hidden_units, 1))
    rule = optax.scale_by_adam()

    def value(critic, observation, action):
        return networks.apply(quality, critic, jnp.concatenate([observation, action]))[0]

    def init(key, hyper):
        actor_key, critic_key = jax.random.split(key)
        actor, critic = networks.init(policy, actor_key, 0.3), networks.init(quality, critic_key, 0.3)
        rows = (spec.observation_size, spec.action_size, None, spec.observation_size, None)
        buffer = tuple(jnp.zeros((spec.buffer,) if size is None else (spec.buffer, size)) for size in rows)
        count = jnp.zeros((), jnp.int32)
        return State(actor, critic, actor, critic, rule.init(actor), rule.init(critic), buffer, count)

    def act(state, observation, key, hyper):
        noise = hyper.sigma * jax.random.normal(key, (spec.action_size,))
        return jnp.clip(networks.apply(policy, state.actor, observation) + noise, -1.0, 1.0)

    def update(state: State, seen: Transition, key, hyper, enabled):
        # A write beyond the end is dropped: a frozen lane keeps its buffer without a copy of it.
        place = jnp.where(enabled, state.count % spec.buffer, spec.buffer)
        reward = hyper.reward_scale * seen.reward + seen.bonus
        row = (seen.observation, seen.action, reward, seen.next_observation, seen.terminated.astype(float))
        buffer = tuple(kept.at[place].set(new, mode="drop") for kept, new in zip(state.buffer, row, strict=True))
        drawn = jax.random.randint(key, (spec.batch,), 0, jnp.minimum(state.count + 1, spec.buffer))
        observation, action, reward, following, ended = (kept[drawn] for kept in buffer)

        def critic_loss(critic):
            next_action = jax.vmap(lambda o: networks.apply(policy, state.actor_target, o))(following)
            ahead = jax.vmap(value, (None, 0, 0))(state.critic_target, following, next_action)
            target = reward + hyper.gamma * (1.0 - ended) * ahead
            return jnp.mean((jax.vmap(value, (None, 0, 0))(critic, observation, action) - target) ** 2)

        def actor_loss(actor):
            return -jnp.mean(jax.vmap(lambda o: value(state.critic, o, networks.apply(policy, actor, o)))(observation))

        loss, gradient = jax.value_and_grad(critic_loss)(state.critic)
        step, critic_rule = rule.update(gradient, state.critic_rule)
        critic = state.critic - hyper.rate * step
        step, actor_rule = rule.update(jax.grad(actor_loss)(state.actor), state.actor_rule)
        actor = state.actor - hyper.rate * step
        learned = State(
            actor=actor,
            critic=critic,
            actor_target=state.actor_target + hyper.tau * (actor - state.actor_target),
            critic_target=state.critic_target + hyper.tau * (critic - state.critic_target),
            actor_rule=actor_rule,
            critic_rule=critic_rule,
            buffer=(),
            count=state.count + 1,
        )
        learned = jax.tree.map(lambda new, old: jnp.where(enabled, new, old), learned, state.replace(buffer=()))
        return learned.replace(buffer=buffer), Report({"critic_loss": loss}, {}, jnp.isfinite(loss))

    def layers(state):
        weights, biases = zip(*networks.layers(policy, state.actor), strict=True)
        return Layers(weights, biases, "tanh", "tanh")

    return Agent(init, act, update, lambda state, o, hyper: networks.apply(policy, state.actor, o), layers=layers)


LEARNER = Learner("DDPG with replay", Spec, Hyper, lambda spec, env: agent(spec))
