"""What draws and searches take their values from."""

import math
from typing import Any, NamedTuple

import numpy as np

from icac_jax.settings.options import all_options


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
