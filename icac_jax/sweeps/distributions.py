"""What draws and searches take their values from."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icac_jax.settings.options import all_options

SAMPLERS = ("random", "sobol", "latin_hypercube")
"""How draws are spread: each by itself, or evenly over all distributions together."""


class Distribution(NamedTuple):
    """What a value is drawn from.

    Attributes:
      option: the name of the option.
      low: least value; not used with choices.
      high: largest value; not used with choices.
      log: drawn uniformly in the logarithm.
      choices: the values to choose from, or None.
    """

    option: str
    low: float
    high: float
    log: bool
    choices: tuple[Any, ...] | None

    @property
    def whole(self) -> bool:
        """Whether the option is a whole number."""
        return all_options()[self.option].type is int

    def draw(self, rng: np.random.Generator) -> Any:
        """One value."""
        if self.choices is not None:
            return self.choices[int(rng.integers(len(self.choices)))]
        if self.log:
            value = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
            return min(max(round(value), int(self.low)), int(self.high)) if self.whole else value
        return (
            int(rng.integers(int(self.low), int(self.high) + 1))
            if self.whole
            else float(rng.uniform(self.low, self.high))
        )

    def at(self, share: float) -> Any:
        """The value below which a share in [0, 1) of all draws lies; of choices, the one in that part of the list."""
        if self.choices is not None:
            return self.choices[int(share * len(self.choices))]
        low, high = float(self.low), float(self.high)
        if self.whole:  # as wide a part of the line for each number
            low, high = (low, high + 1) if not self.log else (low - 0.5, high + 0.5)
        value = (
            math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
            if self.log
            else low + share * (high - low)
        )
        if self.whole:
            return min(max(round(value) if self.log else math.floor(value), int(self.low)), int(self.high))
        return min(max(value, self.low), self.high)


def draws(
    distributions: Sequence[Distribution], number: int, seed: int, sampler: str = "random"
) -> list[dict[str, Any]]:
    """Values of several options, drawn together.

    Args:
      distributions: of the options.
      number: of draws.
      seed: of the draws.
      sampler: one of `SAMPLERS`. "sobol" takes the first points of a scrambled Sobol sequence, which are the most even
        where `number` is a power of two; "latin_hypercube" puts one draw into each of `number` parts of every
        distribution.
    """
    if sampler == "random":
        rng = np.random.default_rng(seed)
        return [{one.option: one.draw(rng) for one in distributions} for _ in range(number)]
    from scipy.stats import qmc  # takes a while to load

    if sampler == "sobol":
        points = qmc.Sobol(len(distributions), rng=seed).random_base2(max(number - 1, 0).bit_length())[:number]
    else:
        points = qmc.LatinHypercube(len(distributions), rng=seed).random(number)
    return [
        {one.option: one.at(share) for one, share in zip(distributions, point, strict=True)}
        for point in points.tolist()
    ]


class Search(NamedTuple):
    """A search instead of a list of cells.

    Attributes:
      distributions: what is varied.
      trials: cells tried in all.
      batch: cells tried together, between which the search learns.
      seed: of the search.
      metric: what is improved, a key of `study.OBJECTIVES`.
    """

    distributions: tuple[Distribution, ...]
    trials: int
    batch: int
    seed: int
    metric: str
