"""The environment and the agent that the settings of a run describe."""

from icac_jax.agents import coverage, imitation, registry
from icac_jax.agents.base import Agent
from icac_jax.envs import from_gymnax, goals, reach
from icac_jax.envs.base import Environment
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError
from icac_jax.runs import cache
from icac_jax.settings.options import Settings


def environment(settings: Settings) -> Environment:
    """The environment of a run; equal settings give the same object, and so one compile."""
    if settings.is_world:
        return from_gymnax.make(settings.run.arm)
    return reach.make(settings.arm, settings.run.physics, settings.run.sub_steps, cache=cache.current())


def task(settings: Settings, seed: int) -> ReachParams:
    """The task's numbers for one seed of a run, with its goal where each seed has one; Python numbers.

    Raises:
      ConfigError: there is no such goal as is asked for.
    """
    return goals.of_seed(settings.arm, settings.params, settings.goals, settings.run.root_seed, seed)


def agent(settings: Settings) -> Agent:
    """The agent of a run, for its environment; equal settings give the same object.

    Raises:
      ConfigError: it is to start from demonstrations and cannot.
    """
    env = environment(settings)
    learner, bins = registry.build(settings.algo, settings.spec, env), settings.run.coverage_bins
    if settings.imitation.demonstrations != imitation.NONE and learner.imitate is None:
        raise ConfigError(f"demonstrations: must be none with {settings.algo}, which cannot start from any")
    return coverage.counted(learner, bins, env.state_size) if bins else learner
