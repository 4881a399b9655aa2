"""What may pay for exploration, by name: the paper's reward, its parts, its rivals and its controls.

A signal more is a function, a line here and its name in `options.SignalName`.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

from icac_jax.curiosity import mapped, rivals, rnd
from icac_jax.curiosity.base import Map, Signal
from icac_jax.curiosity.options import CuriositySpec
from icac_jax.curiosity.reward import TERMS, Term


class Kind(NamedTuple):
    """A kind of signal.

    Attributes:
      title: what figures and tables call it.
      build: (static choices, the map or None for the one that they describe) -> `Signal`.
    """

    title: str
    build: Callable[[CuriositySpec, Map | None], Signal]


def _sum(**terms: Term) -> Callable[[CuriositySpec, Map | None], Signal]:
    return lambda spec, map: mapped.signal(spec, map, terms)


def _icm(spec: CuriositySpec, map: Map | None) -> Signal:
    one_model = dataclasses.replace(spec, predictors="single")
    return mapped.signal(one_model, map, {"forward_error": rivals.forward_error})


SIGNALS: dict[str, Kind] = {
    "icac": Kind("ICAC (Eq. 10)", _sum(**TERMS)),
    "learning_progress": Kind("learning progress", _sum(learning_progress=TERMS["learning_progress"])),
    "perception_error": Kind("perception error", _sum(perception_error=TERMS["perception_error"])),
    "normalised_progress": Kind("normalised progress", _sum(normalised_progress=rivals.normalised_progress)),
    "signed_progress": Kind("signed progress", _sum(signed_progress=rivals.signed_progress)),
    "counts": Kind("visit counts", _sum(visit_bonus=rivals.counts)),
    "rnd": Kind("RND", lambda spec, map: rnd.signal(spec)),
    "icm": Kind("forward error (ICM)", _icm),
    "none": Kind("no bonus", _sum(nothing=rivals.nothing)),
    "constant": Kind("constant bonus", _sum(constant=rivals.constant)),
    "shuffled": Kind("shuffled bonus", mapped.shuffled),
}

# Those that know nothing of what the learner has seen.
CONTROLS = ("none", "constant", "shuffled")


def build(spec: CuriositySpec, map: Map | None = None) -> Signal:
    """The signal that the choices name.

    Args:
      spec: static choices, sizes included.
      map: the map; the one that `spec` describes by default.
    """
    return SIGNALS[spec.signal].build(spec, map)
