"""The Continuous Actor-Critic Learning Automaton, CACLA and CACLA+Var (Sec. II, Eq. 3-7).

The two differ in one function: how often the actor moves towards an action that turned out better than expected.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import optax
from flax import struct

from icac_jax import networks
from icac_jax.agents import cacla_imitation
from icac_jax.agents.base import Agent, Layers, Report, SeenGoal, Transition
from icac_jax.agents.cacla_options import CaclaHyper, CaclaSpec
from icac_jax.agents.imitation import Demonstrations
from icac_jax.fast import threefry
from icac_jax.fields import check_array
from icac_jax.networks import Network
from icac_jax.precision import usual


class CaclaState(struct.PyTreeNode):
    """What the actor-critic remembers.

    Attributes:
      actor: [Pa] parameters of the actor.
      critic: [Pc] parameters of the critic.
      critic_previous: [Pc] the critic one update ago, or None unless `CaclaSpec.critic_target` is "previous".
      actor_optimizer: optax state of the actor's update rule; empty for sgd.
      critic_optimizer: optax state of the critic's update rule; empty for sgd.
      variance: [] running variance of the TD error (Eq. 6).
    """

    actor: jax.Array
    critic: jax.Array
    critic_previous: jax.Array | None
    actor_optimizer: optax.OptState
    critic_optimizer: optax.OptState
    variance: jax.Array


class CaclaInfo(NamedTuple):
    """What one update did.

    Attributes:
      td_error: [] delta_t before the critic's update.
      actor_updates: [] int32, how often the actor was updated.
    """

    td_error: jax.Array
    actor_updates: jax.Array


def actor_network(spec: CaclaSpec) -> Network:
    """Observation [O] to action mean [A]; linear output, in units of the action bound (Sec. IV)."""
    hidden = (spec.hidden_units,) * spec.hidden_layers
    return Network((spec.observation_size, *hidden, spec.action_size))


def critic_network(spec: CaclaSpec) -> Network:
    """Observation [O] to state value [1]; linear output (Sec. IV)."""
    hidden = (spec.hidden_units,) * spec.hidden_layers
    return Network((spec.observation_size, *hidden, 1))


def optimizer(spec: CaclaSpec) -> optax.GradientTransformation:
    """The update rule without its rate: the rate is traced and multiplies what comes out."""
    rules = {"sgd": optax.identity, "adam": optax.scale_by_adam, "rmsprop": optax.scale_by_rms}
    return rules[spec.optimizer]()


@usual
def init(spec: CaclaSpec, key: jax.Array, hyper: CaclaHyper) -> CaclaState:
    """Random actor and critic, variance at its start (Alg. 2 lines 1-2).

    Args:
      spec: static choices.
      key: randomness of the initial weights.
      hyper: `weight_scale` and `variance_init`.
    """
    actor_key, critic_key = jax.random.split(key)
    actor = networks.init(actor_network(spec), actor_key, hyper.weight_scale)
    critic = networks.init(critic_network(spec), critic_key, hyper.weight_scale)
    rule = optimizer(spec)
    return CaclaState(
        actor=actor,
        critic=critic,
        critic_previous=critic if spec.critic_target == "previous" else None,
        actor_optimizer=rule.init(actor),
        critic_optimizer=rule.init(critic),
        variance=jnp.asarray(hyper.variance_init, float),
    )


@usual
def value(spec: CaclaSpec, state: CaclaState, observation: jax.Array) -> jax.Array:
    """V(s) [] of an observation [O]."""
    return networks.apply(critic_network(spec), state.critic, observation)[0]


@usual
def greedy_action(spec: CaclaSpec, state: CaclaState, observation: jax.Array) -> jax.Array:
    """The actor's own action [A] in [-1, 1], without exploration."""
    check_array("observation", observation, (spec.observation_size,))
    mean = networks.apply(actor_network(spec), state.actor, observation)
    return jnp.clip(mean, -1.0, 1.0)


@usual
def act(spec: CaclaSpec, state: CaclaState, observation: jax.Array, key: jax.Array, hyper: CaclaHyper) -> jax.Array:
    """An explored action [A] in units of the action bound (Eq. 7, or epsilon-greedy of Sec. II).

    Args:
      spec: static choices.
      state: the actor-critic.
      observation: [O] input in [-1, 1].
      key: randomness of this step.
      hyper: `sigma` or `exploration_epsilon`.
    """
    check_array("observation", observation, (spec.observation_size,))
    mean = networks.apply(actor_network(spec), state.actor, observation)
    if spec.exploration == "epsilon_greedy":
        action_key, choice_key = threefry.pair(key)
        random_action = threefry.uniform(action_key, mean.shape, -1.0, 1.0)
        explore = threefry.uniform(choice_key, ()) < hyper.exploration_epsilon
        return jnp.where(explore, random_action, jnp.clip(mean, -1.0, 1.0))
    noise = hyper.sigma * threefry.normal(key, mean.shape)
    if spec.action_clipping != "executed":
        mean = jnp.clip(mean, -1.0, 1.0)
    action = mean + noise
    return action if spec.action_clipping == "output" else jnp.clip(action, -1.0, 1.0)


def _descend(
    rule: optax.GradientTransformation,
    params: jax.Array,
    direction: jax.Array,
    rule_state: optax.OptState,
    rate: jax.typing.ArrayLike,
) -> tuple[jax.Array, optax.OptState]:
    """Parameters [P] and rule state after one step of size `rate` along what the rule makes of `direction` [P]."""
    step, rule_state = rule.update(direction, rule_state)
    return params + rate * cast(jax.Array, step), rule_state


# How often the actor moves, as a number of the TD error's type: (TD error [], variance [], hyper) -> [].
Repeats = Callable[[jax.Array, jax.Array, CaclaHyper], jax.Array]


def once(td_error: jax.Array, variance: jax.Array, hyper: CaclaHyper) -> jax.Array:
    """CACLA: one update (Eq. 4-5)."""
    return jnp.ones((), td_error.dtype)


def by_variance(td_error: jax.Array, variance: jax.Array, hyper: CaclaHyper) -> jax.Array:
    """CACLA+Var: ceil(delta / sqrt(var)) updates, at most `max_actor_updates` (Eq. 6, Alg. 2 lines 15-16).

    With the variance of line 14, delta / sqrt(var) is at most 1 / sqrt(beta).
    """
    return jnp.minimum(jnp.ceil(td_error / jnp.sqrt(variance)), hyper.max_actor_updates)


def update_count(repeats: Repeats, td_error: jax.Array, variance: jax.Array, hyper: CaclaHyper) -> jax.Array:
    """How often the actor moves towards the action: [] int32; 0 unless the TD error is positive (Eq. 4)."""
    return jnp.where(td_error > 0, repeats(td_error, variance, hyper), 0).astype(jnp.int32)


@usual
def update_actor(
    spec: CaclaSpec,
    state: CaclaState,
    observation: jax.Array,
    action: jax.Array,
    count: jax.Array,
    rate: jax.typing.ArrayLike,
) -> tuple[jax.Array, optax.OptState]:
    """Moves the actor `count` times towards the action taken (Eq. 5, Alg. 2 line 16).

    Args:
      spec: static choices.
      state: the actor-critic.
      observation: [O].
      action: [A] target of the actor's output.
      count: [] int32 number of updates.
      rate: learning rate.

    Returns:
      New actor parameters [Pa] and optimizer state.
    """
    net, rule = actor_network(spec), optimizer(spec)

    def body(carry: tuple[jax.Array, jax.Array, optax.OptState]) -> tuple[jax.Array, jax.Array, optax.OptState]:
        done, actor, rule_state = carry
        direction = networks.descent(net, actor, observation, action)
        return done + 1, *_descend(rule, actor, direction, rule_state, rate)

    carry = (jnp.zeros((), jnp.int32), state.actor, state.actor_optimizer)
    _, actor, rule_state = jax.lax.while_loop(lambda carry: carry[0] < count, body, carry)
    return actor, rule_state


def td_target(
    spec: CaclaSpec,
    critic: jax.Array,
    reward: jax.Array,
    next_observation: jax.Array,
    terminated: jax.Array,
    hyper: CaclaHyper,
) -> jax.Array:
    """The target y [] = r + gamma V(s') (Alg. 2 line 11) by a critic [Pc]; arguments as in `update`."""
    bootstrap = jnp.where(terminated, jnp.asarray(hyper.bootstrap_at_goal, float), 1.0)
    next_value = networks.apply(critic_network(spec), critic, next_observation)[0]
    return reward + hyper.gamma * bootstrap * next_value


@usual
def update(
    spec: CaclaSpec,
    state: CaclaState,
    observation: jax.Array,
    action: jax.Array,
    reward: jax.Array,
    next_observation: jax.Array,
    terminated: jax.Array,
    hyper: CaclaHyper,
    enabled: jax.typing.ArrayLike = True,
    repeats: Repeats = by_variance,
) -> tuple[CaclaState, CaclaInfo]:
    """Critic, variance and actor after one transition (Alg. 2 lines 11-17).

    Args:
      spec: static choices.
      state: the actor-critic before the transition.
      observation: [O] s_t.
      action: [A] a_t as executed.
      reward: [] r_t, intrinsic plus extrinsic (Eq. 11).
      next_observation: [O] s_{t+1}, before any reset.
      terminated: [] bool, the goal was reached; a time-out does not count.
      hyper: traced numbers.
      enabled: when False the state comes back unchanged (a frozen lane).
      repeats: how often the actor moves: `once` for CACLA, `by_variance` for CACLA+Var.

    Returns:
      The new state and what happened.
    """
    for name, array in (("observation", observation), ("next_observation", next_observation)):
        check_array(name, array, (spec.observation_size,))
    check_array("action", action, (spec.action_size,))
    net, rule = critic_network(spec), optimizer(spec)
    target_params = state.critic if state.critic_previous is None else state.critic_previous
    target = td_target(spec, target_params, reward, next_observation, terminated, hyper)  # line 11
    td_error = target - networks.apply(net, state.critic, observation)[0]  # line 13

    direction = networks.descent(net, state.critic, observation, target[None])
    critic, critic_optimizer = _descend(  # Eq. 3, line 12
        rule, state.critic, direction, state.critic_optimizer, hyper.critic_rate
    )

    variance = (1.0 - hyper.beta) * state.variance + hyper.beta * td_error**2  # Eq. 6, line 14
    counted = variance if spec.variance_order == "updated" else state.variance
    # A frozen lane must not keep the others waiting for its repeated updates.
    count = jnp.where(enabled, update_count(repeats, td_error, counted, hyper), 0)
    actor, actor_optimizer = update_actor(spec, state, observation, action, count, hyper.actor_rate)

    new_state = CaclaState(
        actor=actor,
        critic=critic,
        critic_previous=None if state.critic_previous is None else state.critic,
        actor_optimizer=actor_optimizer,
        critic_optimizer=critic_optimizer,
        variance=variance,
    )
    kept = jax.tree.map(lambda new, old: jnp.where(enabled, new, old), new_state, state)
    return kept, CaclaInfo(td_error=td_error, actor_updates=count)


@functools.cache
def agent(spec: CaclaSpec, repeats: Repeats = by_variance) -> Agent:
    """CACLA (`repeats` is `once`) or CACLA+Var (`by_variance`) as an agent; equal arguments give the same object.

    Args:
      spec: static choices, sizes included.
      repeats: how often the actor moves towards an action that was better than expected.
    """

    def start(key: jax.Array, hyper: Any) -> CaclaState:
        # The second key is for what may be built around the learner: its weights do not depend on that.
        return init(spec, jax.random.split(key)[0], hyper)

    def step(
        state: CaclaState, transition: Transition, key: jax.Array, hyper: Any, enabled: jax.typing.ArrayLike
    ) -> tuple[CaclaState, Report]:
        state, info = update(
            spec,
            state,
            transition.observation,
            transition.action,
            transition.bonus + hyper.reward_scale * transition.reward,  # Eq. 11
            transition.next_observation,
            transition.terminated,
            hyper,
            enabled,
            repeats,
        )
        # One sum tells whether anything stopped being finite: NaN and infinity both survive adding up.
        total = jnp.sum(state.actor) + jnp.sum(state.critic) + state.variance + info.td_error
        return state, Report(sums={}, last={}, finite=jnp.isfinite(total))

    def layers(state: CaclaState) -> Layers:
        net = actor_network(spec)
        weights, biases = zip(*networks.layers(net, state.actor), strict=True)
        return Layers(weights, biases, "tanh", net.output)

    def imitate(
        state: CaclaState, demonstrations: Demonstrations, goal: SeenGoal | None, key: jax.Array, hyper: Any
    ) -> CaclaState:
        def target(critic: jax.Array, reward: jax.Array, after: jax.Array, terminated: jax.Array) -> jax.Array:
            return td_target(spec, critic, hyper.reward_scale * reward, after, terminated, hyper)

        nets = actor_network(spec), critic_network(spec)
        actor, critic = cacla_imitation.fitted(nets, (state.actor, state.critic), target, demonstrations, key)
        previous = None if state.critic_previous is None else critic
        return state.replace(actor=actor, critic=critic, critic_previous=previous)

    return Agent(
        init=start,
        act=lambda state, observation, key, hyper: act(spec, state, observation, key, hyper),
        update=step,
        greedy=lambda state, observation, hyper: greedy_action(spec, state, observation),
        layers=layers,
        imitate=imitate,
    )
