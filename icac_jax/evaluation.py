"""What a policy does without exploration: one greedy episode, for one lane."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from icac_jax import cacla
from icac_jax.cacla import CaclaState
from icac_jax.config import Spec
from icac_jax.envs.base import Environment


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
    spec: Spec, env: Environment, policy: CaclaState, key: jax.Array, params: Any, steps: int
) -> GreedyEpisode:
    """Runs the actor's own actions from a fresh start until the episode ends.

    Args:
      spec: static choices of the learner.
      env: the world.
      policy: the trained actor-critic.
      key: start and goal; the same key gives every policy the same pair.
      params: traced numbers of the world.
      steps: most steps, at least the world's own horizon.
    """
    start, observation = env.init(key, params)

    def body(carry: tuple, _: None) -> tuple[tuple, None]:
        state, observation, over, reached, taken = carry
        action = cacla.greedy_action(spec, policy, observation)
        stepped, seen = env.step(state, action, params)
        kept = jax.tree.map(
            lambda new, old: jnp.where(over, old, new), (stepped, seen.observation), (state, observation)
        )
        reached = reached | (~over & seen.terminated)
        taken = taken + ~over
        return (*kept, over | seen.terminated | seen.truncated, reached, taken), None

    no = jnp.zeros((), bool)
    carry = (start, observation, no, no, jnp.zeros((), jnp.int32))
    (end, _, _, reached, taken), _ = jax.lax.scan(body, carry, None, length=steps)
    return GreedyEpisode(reached=reached, steps=taken, start=start, end=end)
