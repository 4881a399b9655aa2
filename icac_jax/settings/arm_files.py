"""The arms by the option `arm`: those of the package and arms of one's own, with the presets of each."""

from typing import Any, NamedTuple

from icac_jax.envs import arms, from_gymnax, own_arms, tasks
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.own_arms import whole
from icac_jax.fields import ConfigError
from icac_jax.settings import presets

__all__ = ["Found", "find", "whole"]


class Found(NamedTuple):
    """An arm and what goes with it.

    Attributes:
      name: the option `arm`: a name of the package, the whole path of a TOML or model file, or a world of gymnax.
      arm: its numbers.
      presets: by name, what each changes of the declared defaults.
      tasks: by name, what each sets.
      sha256: of all files of an own arm; empty for an arm of the package.
    """

    name: str
    arm: ArmSpec
    presets: dict[str, dict[str, Any]]
    tasks: dict[str, dict[str, Any]]
    sha256: str


def find(name: str, tip: str = "") -> Found:
    """The arm that the options `arm` and `tip` name.

    Raises:
      ConfigError: there is none, a file of an own arm cannot be read or is not valid, or it takes no tip.
    """
    if own_arms.is_own(name):
        own = own_arms.find(name, tip)
        its_presets = {name: changes | own.defaults for name, changes in presets.OWN.items()}
        return Found(own.path, own.arm, its_presets, own.tasks, own.sha256)
    if from_gymnax.is_named(name) and not tip:
        its_presets = {
            preset: changes | {"horizon": from_gymnax.horizon(name)} for preset, changes in presets.OF_WORLD.items()
        }
        return Found(name, from_gymnax.spec(name), its_presets, {}, "")
    if tip:
        raise ConfigError(f"tip: only for an arm given as a model file, not for {name}")
    return Found(name, arms.get(name), presets.of_arm(name), tasks.TASKS[name], "")
