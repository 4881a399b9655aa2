"""ICAC in a world of your own: two pure functions, `init` and `step`, and three sizes.

The world: a boat on a square lake with a current. It starts anywhere, rows at most a tenth of the lake's half-width a
step, and gets a reward in the harbour only.

Usage: python examples/own_environment.py [EPISODES] [SEEDS]
"""

import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp

import icac_jax
from icac_jax import Environment, Hyper, Spec, TimeStep, cacla, icac

HORIZON = 60


class Lake(NamedTuple):
    """The world's numbers: traced, so each lane may have its own."""

    stroke: jax.Array  # [] largest move a step
    current: jax.Array  # [2] move a step without rowing


class Boat(NamedTuple):
    """The world's state."""

    place: jax.Array  # [2] in [-1, 1]
    time: jax.Array  # []


def init(key: jax.Array, lake: Lake) -> tuple[Boat, jax.Array]:
    """Starts an episode; returns the state and what the learner sees of it, [2] in [-1, 1]."""
    place = jax.random.uniform(key, (2,), minval=-1.0, maxval=1.0)
    return Boat(place, jnp.zeros((), jnp.int32)), place


def step(boat: Boat, action: jax.Array, lake: Lake) -> tuple[Boat, TimeStep]:
    """Rows by the action [2] in [-1, 1]; never resets by itself."""
    place = jnp.clip(boat.place + lake.stroke * action + lake.current, -1.0, 1.0)
    reached = jnp.linalg.norm(place - jnp.array([0.5, 0.5])) < 0.3
    time = boat.time + 1
    reward = jnp.where(reached, 10.0, 0.0)
    return Boat(place, time), TimeStep(place, reward, reached, ~reached & (time >= HORIZON))


def main(episodes: int = 600, seeds: int = 10) -> dict[str, jax.Array]:
    """Trains with and without curiosity and prints success; returns it for first and last fifth [2, seeds]."""
    world = Environment(init, step, observation_size=2, action_size=2, state_size=2)
    learning = {"sigma": 0.7, "gamma": 0.97, "bootstrap_at_goal": False, "actor_rate": 0.05, "critic_rate": 0.05}
    # The reward here is a fifth of the paper's 50, so curiosity weighs less too.
    weights = {"perception_error_weight": 0.1, "learning_progress_weight": 0.1}
    learners = {
        "cacla_var": (cacla.agent(cacla.CaclaSpec(observation_size=2, action_size=2)), cacla.CaclaHyper(**learning)),
        "icac": (
            icac.agent(Spec(observation_size=2, state_size=2, action_size=2)),
            Hyper(e_max=0.5, **learning, **weights),
        ),
    }
    lake = icac_jax.broadcast(Lake(stroke=jnp.array(0.1), current=jnp.array([0.0, -0.05])), seeds)
    fifth, result = max(episodes // 5, 1), {}
    print(f"{'algorithm':10}{'first fifth':>13}{'last fifth':>12}{'worst seed':>12}")
    for algo, (agent, numbers) in learners.items():
        hyper = icac_jax.broadcast(numbers.traced(), seeds)
        lanes = icac_jax.init_lanes(agent, world, jax.random.key(0), jnp.arange(seeds), hyper, lake)
        wanted = jnp.full(seeds, episodes)
        lanes, log = icac_jax.run_chunk(agent, world, lanes, hyper, lake, wanted, length=HORIZON * episodes)
        parts = (log.episode < fifth, log.episode >= episodes - fifth)
        success = [(log.done & log.reached & part).sum(0) / (log.done & part).sum(0) for part in parts]
        print(f"{algo:10}{success[0].mean():13.1%}{success[1].mean():12.1%}{success[1].min():12.1%}")
        result[algo] = jnp.stack(success)
    return result


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
