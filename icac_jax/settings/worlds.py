"""What a run in a world without an arm, such as one of gymnax, does not have."""

import dataclasses
from collections.abc import Iterable
from typing import Any

from icac_jax.agents.imitation import NONE, ImitationOptions
from icac_jax.envs.goals import GoalOptions
from icac_jax.envs.reach import ReachParams
from icac_jax.fields import ConfigError

_HORIZON = "horizon"  # the one option of a task that every world has
# Demonstrations are the oracle's, or of an arm that their file names.
_RECORDS = ReachParams, GoalOptions, ImitationOptions
_OF_ARMS = {field.name for record in _RECORDS for field in dataclasses.fields(record)} - {_HORIZON}
_OF_ARMS |= {"physics", "sub_steps", "coverage_bins", "encoder"}


def check(name: str, changed: Iterable[str]) -> None:
    """Refuses options that only an arm has.

    Args:
      name: of the world.
      changed: options that are not what they are where nobody says anything.

    Raises:
      ConfigError: one of them is of arms.
    """
    for option in changed:
        if option in _OF_ARMS:
            raise ConfigError(f"{option}: no option of {name}, only of arms")


def check_camera(settings: Any) -> None:
    """Refuses what a learner that sees embeddings of pictures cannot have.

    Args:
      settings: of the run, `Settings`.

    Raises:
      ConfigError: there are demonstrations or cells to be counted, both of joints.
    """
    if not settings.camera.encoder:
        return
    if settings.imitation.demonstrations != NONE:
        raise ConfigError("demonstrations: must be none with encoder, they are of joints and not of pictures")
    if settings.run.coverage_bins:
        raise ConfigError("coverage_bins: must be 0 with encoder, cells are of joints and not of pictures")


def need_joints(settings: Any, name: str, what: str) -> None:
    """Refuses what only a run has whose learner sees the joints; arguments as for `need_arm`.

    Raises:
      ConfigError: the learner sees embeddings of pictures.
    """
    if settings.camera.encoder:
        raise ConfigError(f"{name}: {what} is of joints, and the run's learners see pictures (encoder)")


def need_arm(settings: Any, name: str, what: str) -> None:
    """Refuses what only a run with an arm has.

    Args:
      settings: of the run, `Settings`.
      name: of the option that the line names.
      what: is asked for.

    Raises:
      ConfigError: the run is in a world without an arm.
    """
    if settings.is_world:
        raise ConfigError(f"{name}: {what} needs an arm, and {settings.run.arm} has none")
