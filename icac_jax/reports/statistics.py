"""Statistics over seeds: interquartile mean, bootstrap intervals, probability of improvement.

A seed is the unit: episodes of one seed are not independent. After Agarwal et al. 2021, "Deep reinforcement learning at
the edge of the statistical precipice". Without scipy.stats, which takes a second to load.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np

from icac_jax import shapes

RESAMPLES = 5000
CONFIDENCE = 0.95


class Estimate(NamedTuple):
    """A figure with its interval.

    Attributes:
      value: the point estimate.
      low: lower end of the 95 % interval.
      high: upper end of the 95 % interval.
    """

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """For tables: value [low, high]."""
        return self.text(".3g")

    def text(self, form: str) -> str:
        """The value with its interval in a format such as ".1%"; a dash where there is none."""
        if not np.isfinite(self.value):
            return "-"
        return f"{self.value:{form}} [{self.low:{form}}, {self.high:{form}}]"

    def as_json(self) -> dict[str, float | None]:
        """As JSON can hold it, by attribute."""
        return {name: finite(value) for name, value in self._asdict().items()}

    @classmethod
    def from_json(cls, facts: dict[str, float | None]) -> Self:
        """The estimate that `as_json` wrote, of the shape `AS_JSON`."""
        return cls(*(np.nan if (value := facts[name]) is None else value for name in cls._fields))


AS_JSON = shapes.record(dict.fromkeys(Estimate._fields, shapes.optional(shapes.number)))
"""Shape of an estimate in a JSON file."""


def finite(value: float) -> float | None:
    """A number as JSON can hold it: None where it is not finite."""
    return float(value) if np.isfinite(value) else None


def iqm(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Interquartile mean: the mean of the middle half along `axis`."""
    ascending = np.moveaxis(np.sort(values, axis=axis), axis, -1)
    return ascending[..., _middle(ascending.shape[-1])].mean(axis=-1)


def mean(values: np.ndarray, axis: int = -1) -> np.ndarray:
    """Mean along `axis`."""
    return np.mean(values, axis=axis)


def explained(values: np.ndarray, groups: Sequence[np.ndarray]) -> tuple[float, float]:
    """How much of the variance of some values their grouping explains, and how much it would by chance.

    Functional ANOVA with group means: the variance of the means of groups over that of all values.

    Args:
      values: [C], none NaN.
      groups: places of the values of each group, or masks [C] bool; none empty, at least two.
    """
    total = np.sum((values - values.mean()) ** 2)
    between = sum(len(values[mine]) * (values[mine].mean() - values.mean()) ** 2 for mine in groups)
    return float(between / total) if total > 0 else 0.0, (len(groups) - 1) / (len(values) - 1)


def estimate(values: np.ndarray, statistic: str = "iqm", seed: int = 0) -> Estimate:
    """A statistic of one figure per seed, with its percentile-bootstrap interval.

    Args:
      values: [S], one figure per seed; NaN where a seed has none.
      statistic: "iqm" or "mean".
      seed: of the resampling.
    """
    values = np.asarray(values, float)
    values = values[~np.isnan(values)]
    if len(values) == 0:
        return Estimate(np.nan, np.nan, np.nan)
    value = values.mean()
    if statistic == "iqm":
        values = np.sort(values)
        value = values[_middle(len(values))].mean()
    drawn = _weights_drawn(len(values), statistic, seed) @ values
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(float(value), float(low), float(high))


def _middle(number: int) -> slice:
    """Which of so many ascending values the interquartile mean is of."""
    return slice(number // 4, number - number // 4)


# A sweep asks for the same resamples once per cell and figure; more than a few numbers of seeds at once are rare, and
# the resamples of hundreds of seeds are large.
@functools.lru_cache(maxsize=4)
def _weights_drawn(number: int, statistic: str, seed: int) -> np.ndarray:
    """[RESAMPLES, number], the weight of each of so many values in the statistic of each resample; read-only.

    For the interquartile mean the values are ascending: which of them make the middle half of a resample then depends
    on their places alone, and all resamples are one product, where to sort each of them took thirty times as long.
    """
    drawn = np.random.default_rng(seed).integers(number, size=(RESAMPLES, number))
    if statistic == "iqm":
        drawn = np.sort(drawn, axis=1)[:, _middle(number)]
    flat = (drawn + number * np.arange(RESAMPLES)[:, None]).ravel()
    weights = np.bincount(flat, minlength=RESAMPLES * number).reshape(RESAMPLES, number) / drawn.shape[1]
    weights.flags.writeable = False
    return weights


@functools.lru_cache(maxsize=2)
def _multiplicities(number: int, seed: int) -> np.ndarray:
    """[RESAMPLES, number], how often each resample of `band` holds each seed; read-only, floats for fast products."""
    times = np.random.default_rng(seed).multinomial(number, np.full(number, 1 / number), size=RESAMPLES).astype(float)
    times.flags.writeable = False
    return times


def probability_of_improvement(better: np.ndarray, worse: np.ndarray, seed: int = 0) -> Estimate:
    """P(X > Y) + P(X = Y) / 2 for a random seed of each algorithm, with its bootstrap interval.

    Args:
      better: [S] figures of the algorithm that is asked about; larger is better.
      worse: [R] figures of the one it is compared with.
      seed: of the resampling.
    """
    difference = np.asarray(better, float)[:, None] - np.asarray(worse, float)
    wins = (difference > 0) + 0.5 * (difference == 0)
    rng = np.random.default_rng(seed)
    # How often each seed is drawn: of hundreds of seeds, all drawn pairs at once would not fit into memory.
    first, second = (_times_drawn(rng, number) for number in wins.shape)
    drawn = np.sum((first @ wins) * second, axis=1) / wins.size
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(float(wins.mean()), float(low), float(high))


def _times_drawn(rng: np.random.Generator, number: int) -> np.ndarray:
    """[RESAMPLES, number], how often each of so many seeds is in each resample."""
    times = np.zeros((RESAMPLES, number))
    np.add.at(times, (np.arange(RESAMPLES)[:, None], rng.integers(number, size=(RESAMPLES, number))), 1)
    return times


class Band(NamedTuple):
    """A curve with its interval at each place.

    Attributes:
      value: [B] the mean over seeds.
      low: [B] lower end of the 95 % interval.
      high: [B] upper end of the 95 % interval.
    """

    value: np.ndarray
    low: np.ndarray
    high: np.ndarray


def band(curves: np.ndarray, seed: int = 0) -> Band:
    """Mean over seeds of one curve per seed, with percentile-bootstrap intervals over seeds at each place.

    Args:
      curves: [S, B], NaN where a seed has no figure; a place where no seed has one is NaN.
      seed: of the resampling.
    """
    curves = np.asarray(curves, float)
    known = ~np.isnan(curves)
    filled = np.where(known, curves, 0.0)
    # How often each seed is drawn: sums over the drawn seeds are then products of matrices.
    times = _multiplicities(len(curves), seed)
    with np.errstate(invalid="ignore", divide="ignore"):
        drawn = (times @ filled) / (times @ known.astype(float))
        value = filled.sum(axis=0) / known.sum(axis=0)
    low, high = np.full_like(value, np.nan), np.full_like(value, np.nan)
    some = known.any(axis=0)
    if some.any():
        ends = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
        low[some], high[some] = np.nanquantile(drawn[:, some], ends, axis=0)
    return Band(value, low, high)


def paired_difference(first: np.ndarray, second: np.ndarray, seed: int = 0) -> Estimate:
    """Mean of first - second over seeds that saw the same starts and goals, with its bootstrap interval.

    Args:
      first: [S] figures of one algorithm, NaN where a seed has none.
      second: [S] figures of the other, the same seeds in the same order.
      seed: of the resampling.
    """
    return estimate(np.asarray(first, float) - np.asarray(second, float), "mean", seed)


def difference(first: np.ndarray, second: np.ndarray, seed: int = 0) -> Estimate:
    """Mean of first less mean of second, where seeds are not paired, with its percentile-bootstrap interval.

    Args:
      first: [S] figures of one algorithm, NaN where a seed has none.
      second: [R] figures of the other.
      seed: of the resampling.
    """
    rng = np.random.default_rng(seed)
    known = [values[~np.isnan(values)] for values in (np.asarray(first, float), np.asarray(second, float))]
    if not all(map(len, known)):
        return Estimate(np.nan, np.nan, np.nan)
    one, two = (values[rng.integers(len(values), size=(RESAMPLES, len(values)))].mean(axis=1) for values in known)
    low, high = np.quantile(one - two, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Estimate(float(known[0].mean() - known[1].mean()), float(low), float(high))


def performance_profile(figures: np.ndarray, limits: np.ndarray, larger: bool = True, seed: int = 0) -> Band:
    """Share of the seeds that do better than each limit: the run-score distribution of Agarwal et al. 2021.

    Args:
      figures: [S] one figure per seed; NaN counts as worse than every limit.
      limits: [B] to be exceeded, or undercut where less is better.
      larger: whether more is better.
      seed: of the resampling.
    """
    figures, limits = np.asarray(figures, float)[:, None], np.asarray(limits, float)
    return band((figures > limits if larger else figures < limits).astype(float), seed)
