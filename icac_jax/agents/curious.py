"""Curiosity around an agent: what comes out is an agent too. ICAC is `curious` around CACLA+Var."""

from collections.abc import Mapping
from typing import Any

import jax
from flax import struct

from icac_jax.agents import imitation
from icac_jax.agents.base import Agent, Report, Transition
from icac_jax.curiosity import mapped, signals
from icac_jax.curiosity.base import Map, Signal, Step
from icac_jax.curiosity.options import CuriositySpec
from icac_jax.curiosity.reward import Term


class CuriousState(struct.PyTreeNode):
    """What a curious agent remembers.

    Attributes:
      agent: state of the agent inside.
      curiosity: state of the signal: for most of them the map and the predictors.
    """

    agent: Any
    curiosity: Any


def curious(
    agent: Agent,
    spec: CuriositySpec,
    map: Map | None = None,
    terms: Mapping[str, Term] | None = None,
    signal: Signal | None = None,
) -> Agent:
    """An agent that gets an intrinsic reward with each transition, as its `bonus` (Alg. 2 lines 8-11).

    The agent decides what it makes of the bonus: on-policy learners add it to the reward (Eq. 11), replaying learners
    store it. The traced numbers of the whole are one record with the fields of both, such as `agents.icac.Hyper`; its
    number `curiosity` weighs the bonus.

    Args:
      agent: any agent.
      spec: static choices of curiosity, sizes included; `signal` names what pays.
      map: the map; the one that `spec` describes by default.
      terms: of a reward on the map, by name, instead of the signal that `spec` names; each is a column of the records,
        beside their sum `intrinsic_reward`.
      signal: a signal of one's own instead; then `map` and `terms` play no part.
    """
    if signal is None:
        signal = signals.build(spec, map) if terms is None else mapped.signal(spec, map, terms)
    pays = signal

    def start(key: jax.Array, hyper: Any) -> CuriousState:
        curiosity = pays.init(jax.random.split(key)[1], hyper)
        return CuriousState(agent=agent.init(key, hyper), curiosity=curiosity)

    def step(
        state: CuriousState, transition: Transition, key: jax.Array, hyper: Any, enabled: jax.typing.ArrayLike
    ) -> tuple[CuriousState, Report]:
        sensed, next_sensed = (x[: spec.map_size] for x in (transition.observation, transition.next_observation))
        seen = Step(sensed, transition.action, next_sensed)
        curiosity, paid = pays.update(state.curiosity, seen, key, hyper, enabled)
        bonus, parts = _weighed(hyper.curiosity, paid.bonus, paid.terms)
        learned, report = agent.update(state.agent, transition._replace(bonus=bonus), key, hyper, enabled)
        return CuriousState(agent=learned, curiosity=curiosity), Report(
            sums=report.sums | {"intrinsic_reward": bonus} | parts,
            last=report.last | pays.counts(curiosity),
            finite=report.finite & paid.finite,
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
        imitate=imitation.inside(agent.imitate),
        map=pays.map,
        slots=pays.slots and pays.slots.inside("curiosity"),
        flops=agent.flops,
    )


def _weighed(
    weight: jax.Array | None, bonus: jax.Array, parts: dict[str, jax.Array]
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """The bonus and its parts, times a weight; None is 1."""
    if weight is None:
        return bonus, parts
    return weight * bonus, {name: weight * part for name, part in parts.items()}
