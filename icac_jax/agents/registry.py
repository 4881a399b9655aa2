"""The learners by name: a line per learner, and those that installed packages add.

A package adds a learner by an entry point of the group `icac_jax.learners` that names a `Learner`.
"""

import dataclasses
import functools
from collections.abc import Callable
from importlib import metadata
from typing import Any, NamedTuple

from icac_jax.agents import cacla, curious_ddpg, ddpg, icac, td3
from icac_jax.agents.base import Agent
from icac_jax.agents.ddpg_options import DdpgHyper, DdpgSpec
from icac_jax.agents.on_policy_hindsight import with_hindsight
from icac_jax.envs.base import Environment
from icac_jax.fields import ConfigError, close_match

GROUP = "icac_jax.learners"


class Learner(NamedTuple):
    """A learner that runs, files and the command line know by name.

    Attributes:
      help: what it is, in a few words.
      static: dataclass of its static choices, hashable, each field a `fields.param`; sizes are `derived`.
      traced: `fields.Numbers` of its traced numbers, each field a `fields.param`.
      build: (static choices with the environment's sizes, environment) -> `Agent`; equal arguments must give the same
        object.
      check: (static choices, traced numbers) -> None; raises `ConfigError` where they contradict each other.
    """

    help: str
    static: type
    traced: type
    build: Callable[[Any, Environment], Agent]
    check: Callable[[Any, Any], None] = lambda spec, hyper: None


LEARNERS: dict[str, Learner] = {
    "cacla": Learner(
        "CACLA",
        cacla.CaclaSpec,
        cacla.CaclaHyper,
        lambda spec, env: with_hindsight(cacla.agent(spec, cacla.once), spec, env),
    ),
    "cacla_var": Learner(
        "CACLA+Var",
        cacla.CaclaSpec,
        cacla.CaclaHyper,
        lambda spec, env: with_hindsight(cacla.agent(spec, cacla.by_variance), spec, env),
    ),
    "icac": Learner("ICAC, curiosity around CACLA+Var", icac.Spec, icac.Hyper, icac.agent, icac.check),
    "ddpg": Learner("DDPG with replay", DdpgSpec, DdpgHyper, ddpg.build),
    "td3": Learner("TD3 with replay", td3.Spec, td3.Hyper, td3.build),
    "curious_ddpg": Learner(
        "curiosity around DDPG", curious_ddpg.Spec, curious_ddpg.Hyper, curious_ddpg.build, curious_ddpg.check
    ),
    "curious_td3": Learner(
        "curiosity around TD3",
        curious_ddpg.Spec,
        curious_ddpg.Td3Hyper,
        lambda spec, env: curious_ddpg.build(spec, env, td3.TD3),
        curious_ddpg.check,
    ),
}


@functools.cache
def learners() -> dict[str, Learner]:
    """Every learner by name: those of this package, then those that installed packages add.

    Raises:
      ConfigError: an entry point cannot be loaded, is no `Learner`, or takes a name that is taken.
    """
    found = dict(LEARNERS)
    for entry in metadata.entry_points(group=GROUP):
        try:
            learner = entry.load()
        except Exception as error:  # another package's module can fail in any way
            raise ConfigError(f"algo: the learner {entry.name} of {entry.value} cannot be loaded ({error})") from error
        if not isinstance(learner, Learner):
            raise ConfigError(f"algo: the learner {entry.name} must be a Learner, {entry.value} is none")
        if entry.name in found:
            raise ConfigError(f"algo: the learner {entry.name} of {entry.value} must have another name, it is taken")
        found[entry.name] = learner
    return found


def find(name: Any) -> Learner:
    """The learner of that name, whatever a file or a caller gave for one.

    Raises:
      ConfigError: there is none.
    """
    known = learners()
    if not isinstance(name, str) or name not in known:  # a file may say anything
        close = close_match(name, known) if isinstance(name, str) else ""
        raise ConfigError(f"algo: must be one of {', '.join(known)}, got {name!r}{close}")
    return known[name]


_AROUND = {"ddpg": "curious_ddpg", "td3": "curious_td3"}


def curious(name: Any) -> Any:
    """The learner with curiosity around the learner of that name, for the option `curiosity`; the name if it has none.

    ICAC, which is that for CACLA+Var, is asked for by its own name.
    """
    return _AROUND.get(name, name)


def inside(name: str) -> str:
    """The learner that curiosity is around in the learner of that name; the name if there is no curiosity in it."""
    around = {curious: plain for plain, curious in _AROUND.items()} | {"icac": "cacla_var"}
    return around.get(name, name)


def replays(learner: str | Learner) -> bool:
    """Whether a learner, or the one of that name, learns again from transitions that it keeps."""
    found = find(learner) if isinstance(learner, str) else learner
    return any(field.name == "buffer_size" for field in dataclasses.fields(found.static))


def built(learner: Learner, spec: Any, env: Environment) -> Agent:
    """A learner for an environment; equal arguments give the same object, and so one compile.

    Args:
      learner: which.
      spec: its static choices; sizes are taken from the environment.
      env: the world.
    """
    sizes = {
        "observation_size": env.observation_size,
        "state_size": env.state_size,
        "action_size": env.action_size,
    }
    mine = {field.name for field in dataclasses.fields(spec) if field.metadata.get("derived")}
    whole = dataclasses.replace(spec, **{size: sizes[size] for size in sizes if size in mine})
    return learner.build(whole, env)


def build(name: str, spec: Any, env: Environment) -> Agent:
    """The learner of that name for an environment, as `built` gives it."""
    return built(find(name), spec, env)
