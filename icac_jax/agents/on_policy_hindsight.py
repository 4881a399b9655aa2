"""Hindsight for learners without a replay buffer: more updates per step, as if the goal had been what was reached.

A transition of a few steps ago and the goal that has just been reached are what an on-policy learner can take, because
its policy has hardly changed since.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.agents import hindsight, imitation, replay
from icac_jax.agents.base import Agent, Report, Transition
from icac_jax.agents.cacla_options import CaclaSpec
from icac_jax.agents.replay import Experience, Replay
from icac_jax.envs.base import Environment


class HindsightState(struct.PyTreeNode):
    """What the wrapped agent remembers, and the latest transitions.

    Attributes:
      agent: state of the agent inside.
      replay: the transitions.
      steps: [] int32, transitions of the episode under way.
    """

    agent: Any
    replay: Replay
    steps: jax.Array


@functools.cache
def around(agent: Agent, spec: CaclaSpec, goal_size: int) -> Agent:
    """An agent that learns after each step from `CaclaSpec.hindsight_updates` transitions with another goal as well.

    Each is one of the last `hindsight_horizon` transitions of the episode, all as likely; its goal becomes the one just
    achieved, its reward what that would have brought. Its bonus stays.

    Args:
      agent: any agent; what it reports is of the true transition.
      spec: static choices, sizes included.
      goal_size: entries of a goal.
    """

    def start(key: jax.Array, hyper: Any) -> HindsightState:
        sizes = spec.observation_size, spec.action_size, goal_size
        return HindsightState(
            agent.init(key, hyper), replay.init(spec.hindsight_horizon, *sizes), jnp.zeros((), jnp.int32)
        )

    def step(
        state: HindsightState, transition: Transition, key: jax.Array, hyper: Any, enabled: jax.typing.ArrayLike
    ) -> tuple[HindsightState, Report]:
        goal = transition.goal
        assert goal is not None  # `with_hindsight` refuses environments without
        learned, report = agent.update(state.agent, transition, key, hyper, enabled)
        over = transition.terminated | transition.truncated
        buffer = replay.add(state.replay, Experience.of(transition), over, enabled)
        back = jnp.minimum(state.steps + 1, spec.hindsight_horizon)

        def again(carry: tuple[Any, jax.Array], key: jax.Array) -> tuple[tuple[Any, jax.Array], None]:
            learned, finite = carry
            place_key, update_key = jax.random.split(key)
            place = (buffer.count - 1 - jax.random.randint(place_key, (), 0, back)) % spec.hindsight_horizon
            was = replay.read(buffer, place, spec.observation_size, spec.action_size)
            as_if = hindsight.as_if(was, goal, goal.achieved)
            seen = Transition(
                observation=as_if.observation,
                action=as_if.action,
                reward=as_if.reward,
                next_observation=as_if.next_observation,
                terminated=as_if.terminated > 0,
                truncated=jnp.zeros((), bool),
                bonus=as_if.bonus,
            )
            learned, more = agent.update(learned, seen, update_key, hyper, enabled)
            return (learned, finite & more.finite), None

        keys = jax.random.split(jax.random.fold_in(key, 1), spec.hindsight_updates)
        (learned, finite), _ = jax.lax.scan(again, (learned, report.finite), keys)
        steps = jnp.where(enabled, jnp.where(over, 0, state.steps + 1), state.steps)
        return HindsightState(learned, buffer, steps), report._replace(finite=finite)

    layers = agent.layers
    return agent._replace(
        init=start,
        act=lambda state, observation, key, hyper: agent.act(state.agent, observation, key, hyper),
        update=step,
        greedy=lambda state, observation, hyper: agent.greedy(state.agent, observation, hyper),
        layers=None if layers is None else lambda state: layers(state.agent),
        imitate=imitation.inside(agent.imitate),
    )


def with_hindsight(agent: Agent, spec: CaclaSpec, env: Environment) -> Agent:
    """The agent as it is, or with hindsight around it where `CaclaSpec.hindsight` says so.

    Raises:
      ConfigError: hindsight is wanted and the environment has no goals.
    """
    size = hindsight.goal_size(spec.hindsight, env)
    return around(agent, spec, size) if size else agent
