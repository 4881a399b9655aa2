"""Small worlds whose answers are known on paper, and any learner made for one of them."""

import dataclasses

import jax
import jax.numpy as jnp

from icac_jax.agents import registry
from icac_jax.envs.base import Environment, TimeStep


def learner(algo, env, **options):
    """The learner of that name for a world, and its numbers; it takes those of the options that it has."""
    found = registry.find(algo)

    def mine(record):
        return {field.name: options[field.name] for field in dataclasses.fields(record) if field.name in options}

    sizes = {"observation_size": env.observation_size, "state_size": env.state_size, "action_size": env.action_size}
    names = {field.name for field in dataclasses.fields(found.static)}
    spec = found.static(**mine(found.static) | {name: size for name, size in sizes.items() if name in names})
    return registry.build(algo, spec, env), found.traced(**mine(found.traced))


def bandit(reward):
    """One step an episode: see x in [-1, 1], act, get reward(x, a). A new object at each call, and so a new trace."""

    def init(key, params):
        x = jax.random.uniform(key, (1,), minval=-1.0, maxval=1.0)
        return x, x

    def step(state, action, params):
        return state, TimeStep(state, reward(state[0], action[0]), jnp.array(True), jnp.array(False))

    return Environment(init, step, observation_size=1, action_size=1, state_size=1)


def line(length=10):
    """Walk along a line of 2-D states to its right end; `params` is the step's size. Ends after 20 steps."""

    def init(key, params):
        x = jax.random.uniform(key, (), minval=-1.0, maxval=0.0)
        return (x, jnp.zeros((), jnp.int32)), jnp.stack([x, 0.5 * x])

    def step(state, action, params):
        x = jnp.clip(state[0] + params * action[0] / length, -1.0, 1.0)
        time = state[1] + 1
        reached = x > 0.9
        reward = jnp.where(reached, 10.0, 0.0)
        return (x, time), TimeStep(jnp.stack([x, 0.5 * x]), reward, reached, ~reached & (time >= 20))

    return Environment(init, step, observation_size=2, action_size=1, state_size=2)
