"""Curiosity around an agent: what comes out is an agent too. ICAC is `curious` around CACLA+Var."""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
from flax import struct

from icac_jax.agents.base import Agent, Report, Transition
from icac_jax.curiosity import intrinsic
from icac_jax.curiosity.base import Map
from icac_jax.curiosity.intrinsic import CuriosityState
from icac_jax.curiosity.options import CuriositySpec
from icac_jax.curiosity.reward import TERMS, Term


class CuriousState(struct.PyTreeNode):
    """What a curious agent remembers.

    Attributes:
      agent: state of the agent inside.
      curiosity: the map and the predictors.
    """

    agent: Any
    curiosity: CuriosityState


def curious(agent: Agent, spec: CuriositySpec, map: Map | None = None, terms: Mapping[str, Term] = TERMS) -> Agent:
    """An agent that gets the intrinsic reward with each transition, as its `bonus` (Alg. 2 lines 8-11).

    The agent decides what it makes of the bonus: on-policy learners add it to the reward (Eq. 11), replaying learners
    store it. The traced numbers of the whole are one record with the fields of both, such as `agents.icac.Hyper`.

    Args:
      agent: any agent.
      spec: static choices of curiosity, sizes included.
      map: the map; the one that `spec` describes by default.
      terms: of the reward, by name; each is a column of the records, beside their sum `intrinsic_reward`.
    """
    used = map or intrinsic.map_of(spec)

    def start(key: jax.Array, hyper: Any) -> CuriousState:
        curiosity = intrinsic.init(spec, jax.random.split(key)[1], hyper, used)
        return CuriousState(agent=agent.init(key, hyper), curiosity=curiosity)

    def step(
        state: CuriousState, transition: Transition, key: jax.Array, hyper: Any, enabled: jax.typing.ArrayLike
    ) -> tuple[CuriousState, Report]:
        sensed, next_sensed = (x[: spec.map_size] for x in (transition.observation, transition.next_observation))
        curiosity, wonder = intrinsic.update(
            spec, state.curiosity, sensed, transition.action, next_sensed, hyper, enabled, used, terms
        )
        learned, report = agent.update(state.agent, transition._replace(bonus=wonder.reward), key, hyper, enabled)
        return CuriousState(agent=learned, curiosity=curiosity), Report(
            sums=report.sums | {"intrinsic_reward": wonder.reward} | wonder.terms,
            last=report.last | used.counts(curiosity.map),
            finite=report.finite & jnp.isfinite(wonder.prediction_error + wonder.reward),
        )

    def check(hyper: Any) -> None:
        agent.check(hyper)
        hyper.check_window(spec)

    layers = agent.layers
    return Agent(
        init=start,
        act=lambda state, observation, key, hyper: agent.act(state.agent, observation, key, hyper),
        update=step,
        greedy=lambda state, observation, hyper: agent.greedy(state.agent, observation, hyper),
        check=check,
        layers=None if layers is None else lambda state: layers(state.agent),
        map=used,
    )
