"""Deep deterministic policy gradient (Lillicrap et al. 2016), with a replay buffer in each lane's state.

With the refinements of `agents.td3` it is TD3. Everything is for one lane.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from icac_jax.agents import hindsight, replay
from icac_jax.agents.base import Agent, Layers, Report, SeenGoal, Transition
from icac_jax.agents.ddpg_learning import (
    DDPG,
    Batch,
    Learned,
    Params,
    Refinements,
    apply,
    clone,
    critic_network,
    flops,
    followed,
    learn,
    learn_critics,
    policy_network,
)
from icac_jax.agents.ddpg_options import DdpgHyper, DdpgSpec
from icac_jax.agents.imitation import Demonstrations
from icac_jax.agents.replay import Experience, Replay
from icac_jax.envs.base import Environment
from icac_jax.fast.when import when
from icac_jax.fields import check_array
from icac_jax.precision import usual


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


@usual
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
    network = critic_network(spec)
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


@usual
def greedy_action(spec: DdpgSpec, state: DdpgState, observation: jax.Array) -> jax.Array:
    """The action [A] without exploration for an observation [O]."""
    check_array("observation", observation, (spec.observation_size,))
    return apply(policy_network(spec), _greedy_policy(spec, state), observation)


def _greedy_policy(spec: DdpgSpec, state: DdpgState) -> Params:
    return state.learned.actor if spec.greedy_policy == "actor" else state.learned.actor_target


@usual
def act(spec: DdpgSpec, state: DdpgState, observation: jax.Array, key: jax.Array, hyper: DdpgHyper) -> jax.Array:
    """An explored action [A] in [-1, 1]: the policy's with Gaussian noise, or a random one.

    Lillicrap 2016 has noise that is correlated in time; Fujimoto 2018 (Sec. 6.1) finds that plain noise does as well.
    """
    noise_key, action_key, choice_key = jax.random.split(key, 3)
    check_array("observation", observation, (spec.observation_size,))
    action = apply(policy_network(spec), state.learned.actor, observation)
    action = jnp.clip(action + hyper.sigma * jax.random.normal(noise_key, action.shape), -1.0, 1.0)
    random_action = jax.random.uniform(action_key, action.shape, minval=-1.0, maxval=1.0)
    is_random = jax.random.uniform(choice_key) < hyper.random_share
    return jnp.where(is_random | (state.replay.count < hyper.warm_up), random_action, action)


@usual
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
    seen = Experience.of(transition, with_goal=spec.hindsight != "none")
    buffer = replay.add(state.replay, seen, transition.terminated | transition.truncated, enabled)
    batches = _batches(spec, buffer, transition.goal, key, hyper)
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


def _batches(spec: DdpgSpec, buffer: Replay, goal: SeenGoal | None, key: jax.Array, hyper: Any) -> Batch:
    """What the updates of a step learn from, leaves [U, B, ...] for U updates."""
    draw_key, goal_key, noise_key = jax.random.split(key, 3)
    number = spec.updates_per_step * spec.batch_size
    places = replay.sample(buffer, draw_key, number)
    drawn = replay.read(buffer, places, spec.observation_size, spec.action_size)
    if spec.hindsight != "none":
        assert goal is not None  # the registry builds no learner with hindsight for another environment
        drawn = hindsight.relabelled(spec.hindsight, buffer, places, drawn, goal, goal_key, hyper)
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


@usual
def imitate(
    spec: DdpgSpec,
    state: DdpgState,
    demonstrations: Demonstrations,
    goal: SeenGoal | None,
    key: jax.Array,
    hyper: Any,
    refined: Refinements = DDPG,
) -> DdpgState:
    """Demonstrations in the buffer, actor and critics after `demonstrations.updates` batches of them.

    The critics learn as they always do (Hester et al. 2018 pre-train by the learner's own targets); the actor is cloned
    instead of improved, for it would follow critics that know nothing (own). With hindsight the goals of a batch are
    replaced as ever, for the cloned actor too: what was done is how to get to where it led (Ding et al. 2019).

    Args:
      spec: static choices.
      state: a fresh learner.
      demonstrations: what is shown; where the buffer is smaller, its latest transitions.
      goal: how to replace goals.
      key: what `update` draws from its key.
      hyper: traced numbers.
      refined: DDPG's own, or TD3's.
    """
    shown = demonstrations

    def keep(place: jax.Array, buffer: Replay) -> Replay:
        seen = jax.tree.map(lambda leaf: leaf[place], shown.seen)
        return replay.add(buffer, seen if spec.hindsight != "none" else seen.without_goal(), shown.over[place], True)

    buffer = jax.lax.fori_loop(0, shown.count, keep, state.replay)
    single = dataclasses.replace(spec, updates_per_step=1)

    def body(number: jax.Array, carry: tuple) -> tuple:
        learned, cloning, least, most = carry
        one = _batches(single, buffer, goal, jax.random.fold_in(key, number), hyper)
        batch = jax.tree.map(lambda leaf: leaf[0], one)
        least, most = jnp.minimum(least, jnp.min(batch.reward)), jnp.maximum(most, jnp.max(batch.reward))
        learned, _ = learn_critics(spec, refined, learned, batch, (least, most), hyper)
        learned, cloning = clone(spec, learned, cloning, batch.observation, batch.action, shown.rate)
        return followed(learned, hyper.tau), cloning, least, most

    start = state.learned, optax.scale_by_adam().init(state.learned.actor), state.least, state.most
    learned, _, least, most = jax.lax.fori_loop(0, shown.updates, body, start)
    return DdpgState(learned=learned, replay=buffer, least=least, most=most)


def _layers(spec: DdpgSpec, state: DdpgState) -> Layers:
    found = _greedy_policy(spec, state)["params"]
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
        layers=functools.partial(_layers, spec),
        flops=flops(spec, refined),
        imitate=lambda state, shown, goal, key, hyper: imitate(spec, state, shown, goal, key, hyper, refined),
    )


def build(spec: DdpgSpec, env: Environment) -> Agent:
    """DDPG for an environment.

    Raises:
      ConfigError: hindsight is wanted and the environment has no goals.
    """
    return agent(spec, hindsight.goal_size(spec.hindsight, env))
