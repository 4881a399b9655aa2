"""Policies without exploration on a fixed set of start and goal pairs. S policies, N pairs."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax import greedy
from icac_jax.envs import oracle
from icac_jax.fields import stacked
from icac_jax.greedy import GreedyEpisode
from icac_jax.runs import build
from icac_jax.settings.options import Settings


def player(
    settings: Settings, pairs: int, seed: int, seeds: Sequence[int] | None = None
) -> Callable[[Any], GreedyEpisode]:
    """A function that plays one greedy episode of each policy on each pair; compiled at its first call.

    Args:
      settings: of the run.
      pairs: N; pair k is the same for every policy, every number of pairs and every run of the same task.
      seed: of the pairs.
      seeds: [S] of the policies, for the goals of tasks in which each seed has its own; 0 to S - 1 by default.

    Returns:
      From states of learners with leaves [S, ...] to episodes with leaves [S, N, ...] on the host.
    """
    agent, env = build.agent(settings), build.environment(settings)
    hyper = settings.hyper.traced()
    keys = jax.vmap(functools.partial(jax.random.fold_in, jax.random.key(seed)))(jnp.arange(pairs))

    def one(state: Any, params: Any, key: jax.Array) -> GreedyEpisode:
        return greedy.greedy_episode(agent, env, state, key, hyper, params, settings.params.horizon)

    # On one device: so many lanes at once are spread over the cores by the compiler itself, and two devices that do so
    # at the same time can wait for each other's threads for ever.
    over_pairs = jax.jit(jax.vmap(jax.vmap(one, (None, None, 0)), (0, 0, None)))
    device = jax.local_devices()[0]

    def play(states: Any) -> GreedyEpisode:
        number = len(jax.tree.leaves(states)[0])
        params = stacked([build.task(settings, k) for k in (range(number) if seeds is None else seeds)])
        return jax.device_get(over_pairs(*jax.device_put((states, params, keys), device)))

    return play


def final_distance(settings: Settings, played: GreedyEpisode) -> np.ndarray:
    """Distance in m from the tip to the goal at the end of each episode, [S, N]."""
    tips = oracle.tips(settings.arm, played.end.joints.reshape(-1, settings.arm.joints))
    return np.linalg.norm(tips.reshape(played.end.goal.shape) - played.end.goal, axis=-1)
