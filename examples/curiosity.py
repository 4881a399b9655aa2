"""The map and its predictors as intrinsic reward for somebody else's agent, with and without, side by side.

The world: a maze of three corridors, moves of a tenth of its half-width, a reward in the far corner only; a random walk
does not get there within an episode. The agent: actor-critic with eligibility traces, a softmax policy and a value over
81 features; it knows nothing of maps. `curiosity.update` gives each of its transitions a reward.

Usage: python examples/curiosity.py [STEPS] [SEEDS]
"""

import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp

from icac_jax import CuriosityHyper, CuriositySpec, CuriosityState, curiosity

MOVES = 0.1 * jnp.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
HORIZON = 200
GOAL_REWARD = 100.0

SPEC = CuriositySpec(observation_size=2, state_size=2, action_size=2, map_capacity=256)
# Learning progress alone: with the perception error as well, this agent explores less than a random walk.
CURIOUS = CuriosityHyper(
    e_max=0.2, mu=20, T=10, predictor_rate=0.1, learning_progress_weight=10.0, perception_error_weight=0.0
).traced()

GAMMA, TRACE = 0.99, 0.9
CRITIC_RATE, ACTOR_RATE, ENTROPY_WEIGHT = 0.5, 0.03, 0.03
GRID = jnp.stack(jnp.meshgrid(*2 * [jnp.linspace(-1, 1, 9)]), -1).reshape(-1, 2)


class Agent(NamedTuple):
    """Value [81] and preferences [81, 4] over the features, and their traces."""

    value: jax.Array
    policy: jax.Array
    value_trace: jax.Array
    policy_trace: jax.Array


class Walk(NamedTuple):
    """Everything that one seed carries from step to step."""

    place: jax.Array
    clock: jax.Array
    agent: Agent
    curious: CuriosityState


def move(place: jax.Array, action: jax.Array) -> jax.Array:
    """One step in the maze: two walls, one open at the right, one at the left."""
    new = jnp.clip(place + MOVES[action], -1.0, 1.0)
    hits_first = ((place[1] + 0.34) * (new[1] + 0.34) <= 0) & (new[0] < 0.6)
    hits_second = ((place[1] - 0.34) * (new[1] - 0.34) <= 0) & (new[0] > -0.6)
    return jnp.where(hits_first | hits_second, place, new)


def start(key: jax.Array) -> jax.Array:
    """Somewhere in the lower left corner."""
    return -0.9 + jax.random.uniform(key, (2,), minval=-0.05, maxval=0.05)


def features(place: jax.Array) -> jax.Array:
    """[81] how near each point of the grid is."""
    near = jnp.exp(-jnp.sum((place - GRID) ** 2, axis=-1) / (2 * 0.15**2))
    return near / near.sum()


def learn(agent: Agent, seen: jax.Array, action: jax.Array, reward: jax.Array, next_value: jax.Array) -> Agent:
    """One step of actor-critic with eligibility traces and an entropy bonus."""
    chances = jax.nn.softmax(seen @ agent.policy)
    surprise = jnp.log(chances) - jnp.sum(chances * jnp.log(chances))
    td_error = reward + GAMMA * next_value - seen @ agent.value
    value_trace = GAMMA * TRACE * agent.value_trace + seen
    policy_trace = GAMMA * TRACE * agent.policy_trace + jnp.outer(seen, jax.nn.one_hot(action, 4) - chances)
    entropy_gradient = jnp.outer(seen, -chances * surprise)
    return Agent(
        value=agent.value + CRITIC_RATE * td_error * value_trace,
        policy=agent.policy + ACTOR_RATE * (td_error * policy_trace + ENTROPY_WEIGHT * entropy_gradient),
        value_trace=value_trace,
        policy_trace=policy_trace,
    )


def walk(seed: jax.Array, weight: jax.Array, steps: int) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Trains one agent; returns where episodes ended, where the goal was reached, both [steps], and the map's nodes."""
    key = jax.random.key(seed)

    def step(walk: Walk, time: jax.Array) -> tuple[Walk, tuple[jax.Array, jax.Array]]:
        action_key, start_key = jax.random.split(jax.random.fold_in(key, time))
        seen = features(walk.place)
        action = jax.random.categorical(action_key, seen @ walk.agent.policy)
        place = move(walk.place, action)
        reached = jnp.all(place > 0.75)

        # The only line that curiosity needs.
        known, wonder = curiosity.update(SPEC, walk.curious, walk.place, MOVES[action] / 0.1, place, CURIOUS)

        reward = GOAL_REWARD * reached + weight * wonder.reward
        next_value = jnp.where(reached, 0.0, features(place) @ walk.agent.value)
        agent = learn(walk.agent, seen, action, reward, next_value)
        over = reached | (walk.clock + 1 >= HORIZON)
        agent = agent._replace(
            value_trace=jnp.where(over, 0.0, agent.value_trace), policy_trace=jnp.where(over, 0.0, agent.policy_trace)
        )
        place = jnp.where(over, start(start_key), place)
        return Walk(place, jnp.where(over, 0, walk.clock + 1), agent, known), (over, reached)

    nothing = Agent(jnp.zeros(81), jnp.zeros((81, 4)), jnp.zeros(81), jnp.zeros((81, 4)))
    first = Walk(start(key), jnp.zeros((), int), nothing, curiosity.init(SPEC, key, CURIOUS))
    last, (over, reached) = jax.lax.scan(step, first, jnp.arange(steps))
    return over, reached, last.curious.map.live.sum()


def main(steps: int = 100_000, seeds: int = 8) -> tuple[jax.Array, jax.Array]:
    """Trains all agents in one program and prints how they do, without curiosity and with.

    Returns:
      Share of episodes that reach the goal [2, seeds, fifths of the time], and nodes of the map at the end [2, seeds].
    """
    weights = jnp.repeat(jnp.array([0.0, 1.0]), seeds)
    program = jax.jit(jax.vmap(walk, (0, 0, None)), static_argnums=2)
    over, reached, nodes = program(jnp.tile(jnp.arange(seeds), 2), weights, steps - steps % 5)
    over, reached = (flags.reshape(2, seeds, 5, -1).sum(-1) for flags in (over, reached))
    success, nodes = reached / jnp.maximum(over, 1), nodes.reshape(2, seeds)
    print(f"episodes that reach the goal, by fifths of {steps:,} steps, {seeds} seeds; places that the map knows")
    for row, name in enumerate(("without curiosity", "with curiosity")):
        shares = "  ".join(f"{share:5.1%}" for share in success[row].mean(axis=0))
        print(f"{name:18} {shares}   {nodes[row].mean():.0f} nodes")
    return success, nodes


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
