"""The environment and the agent that the settings of a run describe."""

from icac_jax.agents import coverage, registry
from icac_jax.agents.base import Agent
from icac_jax.envs import reach
from icac_jax.envs.base import Environment
from icac_jax.runs import cache
from icac_jax.settings.options import Settings


def environment(settings: Settings) -> Environment:
    """The environment of a run; equal settings give the same object, and so one compile."""
    return reach.make(settings.arm, settings.run.physics, settings.run.sub_steps, cache=cache.current())


def agent(settings: Settings) -> Agent:
    """The agent of a run, for its environment; equal settings give the same object."""
    env = environment(settings)
    learner, bins = registry.build(settings.algo, settings.spec, env), settings.run.coverage_bins
    return coverage.counted(learner, bins, env.state_size) if bins else learner
