"""What a policy does without exploration: one greedy episode, with or without its path, for one lane."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from icac_jax.agents.base import Agent
from icac_jax.envs.base import Environment
from icac_jax.precision import usual


class GreedyEpisode(NamedTuple):
    """How an episode without exploration went.

    Attributes:
      reached: [] bool, it ended in the goal zone.
      steps: [] int32, its length; the number of steps allowed where the goal was not reached.
      start: the environment's state at its beginning.
      end: the environment's state at its end.
    """

    reached: jax.Array
    steps: jax.Array
    start: Any
    end: Any


def greedy_episode(
    agent: Agent, env: Environment, state: Any, key: jax.Array, hyper: Any, params: Any, steps: int
) -> GreedyEpisode:
    """Runs the learner's actions without exploration from a fresh start until the episode ends.

    Args:
      agent: the learner.
      env: the world.
      state: what the learner has learnt.
      key: start and goal; the same key gives every policy the same pair.
      hyper: traced numbers of the learner.
      params: traced numbers of the world.
      steps: most steps, at least the world's own horizon.
    """
    return greedy_path(agent, env, state, key, hyper, params, steps)[0]


@usual
def greedy_path(
    agent: Agent, env: Environment, state: Any, key: jax.Array, hyper: Any, params: Any, steps: int
) -> tuple[GreedyEpisode, Any]:
    """A greedy episode with every state on its way; arguments as in `greedy_episode`.

    Returns:
      The episode, and the environment's states after each step, leaves [steps, ...]; from the episode's end on the
      last state is repeated.
    """
    start, observation = env.init(key, params)

    def body(carry: tuple, _: None) -> tuple[tuple, Any]:
        env_state, observation, over, reached, taken = carry
        action = agent.greedy(state, observation, hyper)
        stepped, seen = env.step(env_state, action, params)
        kept = jax.tree.map(
            lambda new, old: jnp.where(over, old, new), (stepped, seen.observation), (env_state, observation)
        )
        reached = reached | (~over & seen.terminated)
        taken = taken + ~over
        return (*kept, over | seen.terminated | seen.truncated, reached, taken), kept[0]

    no = jnp.zeros((), bool)
    carry = (start, observation, no, no, jnp.zeros((), jnp.int32))
    (end, _, _, reached, taken), path = jax.lax.scan(body, carry, None, length=steps)
    return GreedyEpisode(reached=reached, steps=taken, start=start, end=end), path
