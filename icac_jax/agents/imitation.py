"""Imitation: a learner that starts from demonstrations, and what can be chosen about it.

Before training the actor is fitted to the demonstrated actions (behaviour cloning), the critic to the demonstrated
rewards by the learner's own temporal differences, and a replay buffer is filled (Vecerik et al. 2017; Hester et al.
2018). What these papers do with demonstrations later on (priorities, a cloning loss as in Nair et al. 2018) is not
done: training goes on as it always does. T is the number of transitions, L that of lanes.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.agents.base import Agent, SeenGoal
from icac_jax.agents.replay import Experience
from icac_jax.envs.base import Environment
from icac_jax.fields import ConfigError, check_record, param
from icac_jax.precision import usual

NONE, ORACLE = "none", "oracle"
# Episodes of the oracle where nobody says how many.
_OF_THE_ORACLE = 20
# Of the key of a lane's noise, beside the numbers of its steps: what imitation draws from.
_STREAM = 2**32 - 1
# Transitions of an update of learners that have no batches of their own.
BATCH = 64


@dataclasses.dataclass(frozen=True)
class ImitationOptions:
    """What a learner starts from."""

    demonstrations: str = param(NONE, "what to start from: none, oracle, or a file of them", source="Sec. V")
    demonstrations_sha256: str = param("", "checksum of that file, filled in by itself", source="own")
    demonstrated_episodes: int = param(
        -1, "episodes taken; -1: all of a file, 20 of the oracle", source="own", low=-1, high=10**6
    )
    demonstration_noise: float = param(
        0.0, "deviation of the oracle's noise", unit="action bound", source="own", low=0.0, high=10.0
    )
    pretraining_updates: int = param(
        2000, "updates of actor and critic before training", source="trials", low=0, high=10**6
    )
    pretraining_rate: float = param(0.01, "learning rate of that (Adam)", source="trials", low=0.0, open_low=True)

    @property
    def from_file(self) -> bool:
        """Whether demonstrations come from a file."""
        return self.demonstrations not in (NONE, ORACLE)

    @property
    def of_oracle(self) -> int:
        """How many episodes the oracle has to play, for each learner."""
        if self.demonstrations != ORACLE:
            return 0
        return _OF_THE_ORACLE if self.demonstrated_episodes < 0 else self.demonstrated_episodes


def check(options: ImitationOptions, walls: bool) -> None:
    """Checks what demonstrations are asked for.

    Args:
      options: about them.
      walls: whether the task has walls.

    Raises:
      ConfigError: with one line that names the field and what is allowed.
    """
    check_record(options)
    if options.demonstrations == ORACLE:
        if walls:
            raise ConfigError("demonstrations: must not be oracle where there are walls, it plans without them")
        return
    if options.demonstration_noise:
        raise ConfigError("demonstration_noise: only with demonstrations oracle, a file has its own")
    for field in dataclasses.fields(options):
        if options.demonstrations == NONE and getattr(options, field.name) != field.default:
            raise ConfigError(f"{field.name}: only with demonstrations")


class Demonstrations(struct.PyTreeNode):
    """What a lane is shown before it trains.

    Attributes:
      seen: transitions, leaves [T, ...], of which the first `count` are some; bonuses are 0.
      over: [T] bool, the last of its episode.
      count: [] int32; 0 leaves the learner as it is.
      updates: [] int32, how often actor and critic are updated.
      rate: [] learning rate of the actor, and of a critic that has no optimiser of its own.
    """

    seen: Experience
    over: jax.Array
    count: jax.Array
    updates: jax.Array
    rate: jax.Array


# (state, demonstrations, goal or None, key, hyper) -> state: what `Agent.imitate` is.
Imitate = Callable[..., Any]


def batch(demonstrations: Demonstrations, key: jax.Array) -> Experience:
    """Transitions drawn uniformly, with replacement: leaves [BATCH, ...]."""
    places = jax.random.randint(key, (BATCH,), 0, jnp.maximum(demonstrations.count, 1))
    return jax.tree.map(lambda leaf: leaf[places], demonstrations.seen)


def inside(imitate: Imitate | None) -> Imitate | None:
    """What `Agent.imitate` is of an agent around another one, whose state has that one's as `agent`.

    Args:
      imitate: of the agent inside; None where it cannot.
    """
    if imitate is None:
        return None
    return lambda state, *rest: state.replace(agent=imitate(state.agent, *rest))


@functools.partial(jax.jit, static_argnames=("agent", "env"))
@usual
def imitated(
    agent: Agent,
    env: Environment,
    states: Any,
    demonstrations: Demonstrations,
    noise_keys: jax.Array,
    hyper: Any,
    params: Any,
) -> Any:
    """Learners [L, ...] that were shown demonstrations; one that is shown none comes back unchanged.

    Args:
      agent: the learner; it must have `imitate`.
      env: its world.
      states: fresh learners, leaves [L, ...].
      demonstrations: leaves [L, ...].
      noise_keys: [L] of their lanes.
      hyper: leaves [L].
      params: leaves [L, ...].
    """
    imitate = agent.imitate
    assert imitate is not None  # `runs.build` refuses to ask one that cannot

    def one(state: Any, shown: Demonstrations, key: jax.Array, hyper: Any, params: Any) -> Any:
        goal = None
        if env.goal is not None:
            nothing = jnp.zeros(env.goal.size)
            goal = SeenGoal(nothing, nothing, env.goal.outcome(params), env.goal.relabel)
        taught = imitate(state, shown, goal, jax.random.fold_in(key, _STREAM), hyper)
        return jax.tree.map(lambda new, old: jnp.where(shown.count > 0, new, old), taught, state)

    return jax.vmap(one)(states, demonstrations, noise_keys, hyper, params)
