"""Learning curves: means over seeds of blocks of episodes, with 95 % bootstrap intervals over seeds.

S is the number of seeds, E the number of episodes per seed, B the number of blocks.
"""

import numpy as np
from matplotlib.axes import Axes

from icac_jax.reports import results, statistics
from icac_jax.reports.figures import Look, look_of, title_of
from icac_jax.reports.results import Result

# "The average over 20 episodes is shown for readability" (Fig. 6), over 300 (Fig. 9).
BLOCK = {"planar2": 20, "nico4": 300}
_BLOCK = 20
# In shorter runs than the paper's, blocks are smaller, so that a curve has at least so many points.
_LEAST_POINTS = 10
_ORACLE = "#222222"
# Beyond so many seeds their lines would cover each other: bands show how many lie where.
_MOST_LINES = 40
_BANDS = ((5, 95, 0.22), (25, 75, 0.3))  # percentiles of the seeds, opacity


def block_length(result: Result) -> int:
    """Episodes that are averaged into one point of a curve."""
    return max(1, min(BLOCK.get(result.settings.arm.name, _BLOCK), result.settings.run.episodes // _LEAST_POINTS))


def blocks(result: Result, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means over consecutive blocks of episodes: their last episodes, counted from one, [B], and the means [S, B].

    Args:
      result: whose episodes they are.
      values: [S, E], NaN where a seed has none; an incomplete last block is left out.
    """
    length = block_length(result)
    number = values.shape[1] // length
    cut = values[:, : number * length].reshape(len(values), number, length)
    return np.arange(1, number + 1) * length, results.mean_of_known(cut, axis=2)


def draw_curve(
    axes: Axes,
    result: Result,
    values: np.ndarray,
    title: str | None = None,
    look: Look | None = None,
    interval: bool = True,
) -> None:
    """Draws the mean over seeds of blocks of `values` [S, E] and its interval.

    Args:
      axes: where.
      result: whose episodes they are.
      values: [S, E], NaN where a seed has none.
      title: in the legend; by default the run's.
      look: by default the run's.
      interval: whether to draw it.
    """
    look = look or look_of(result.name)
    episodes, means = blocks(result, values)
    band = statistics.band(means)
    if interval:
        axes.fill_between(episodes, band.low, band.high, color=look.colour, alpha=0.18, linewidth=0)
    every = max(1, len(episodes) // 8)
    axes.plot(
        *(episodes, band.value),
        color=look.colour,
        linestyle=look.line,
        marker=look.marker,
        markevery=(every - 1, every),
        label=title or title_of(result.name),
    )


def draw_seeds(axes: Axes, result: Result, values: np.ndarray, colour: str) -> None:
    """Draws a thin line per seed, or of many seeds where the middle half and nine tenths of them lie.

    Args:
      axes: where.
      result: whose episodes they are.
      values: [S, E], NaN where a seed has none.
      colour: of lines and bands.
    """
    episodes, means = blocks(result, values)
    if len(means) <= _MOST_LINES:
        axes.plot(episodes, means.T, color=colour, linewidth=0.6, alpha=0.6)
        return
    known = means[:, ~np.all(np.isnan(means), axis=0)]
    for low, high, alpha in _BANDS:
        edges = np.nanpercentile(known, [low, high], axis=0)
        axes.fill_between(episodes[: known.shape[1]], *edges, color=colour, alpha=alpha, linewidth=0)


def draw_oracle(axes: Axes, steps: float) -> None:
    """Draws the least number of steps on average as a horizontal line."""
    axes.axhline(steps, color=_ORACLE, linewidth=1.1, linestyle=(0, (8, 3)), label=f"oracle, {steps:.1f}")
