"""The environment and the agent that the settings of a run describe."""

import jax
import numpy as np

from icac_jax.agents import coverage, imitation, registry
from icac_jax.agents.base import Agent
from icac_jax.envs import camera, drawing, from_gymnax, goals, reach
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.base import Environment
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError
from icac_jax.runs import cache
from icac_jax.settings import encoder_files
from icac_jax.settings.options import Settings
from icac_jax.settings.run_options import CameraOptions

# Largest difference of a pixel between machines: far more than rounding, far less than another arm.
_SAME_PICTURE = 0.01


def environment(settings: Settings) -> Environment:
    """The environment of a run; equal settings give the same object, and so one compile."""
    if settings.is_world:
        return from_gymnax.make(settings.run.arm)
    env = reach.make(settings.arm, settings.run.physics, settings.run.sub_steps, cache=cache.current())
    return _seen(settings.arm, env, settings.camera) if settings.camera.encoder else env


# By arm, world and checksum: wherever a copy of an encoder lies, it gives the same object.
_SEEN: dict[tuple[ArmSpec, Environment, str], Environment] = {}


def _seen(arm: ArmSpec, env: Environment, options: CameraOptions) -> Environment:
    """The environment as the camera of a run shows it.

    Raises:
      ConfigError: the encoder cannot be read, or was made for an arm that looks otherwise.
    """
    embedding, key = encoder_files.read(options, arm), (arm, env, options.encoder_sha256)
    if key not in _SEEN:
        eye = drawing.camera(arm, embedding.options.picture_size)
        there = embedding.weights["arm"]["example"]
        if there.shape != eye.shape or np.max(np.abs(there - jax.jit(eye.arm)(camera.example(arm)))) > _SAME_PICTURE:
            raise ConfigError(
                f"encoder: must be of this {arm.name}, {options.encoder} was made for another of that name"
            )
        _SEEN[key] = camera.seen(env, eye, embedding)
    return _SEEN[key]


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
