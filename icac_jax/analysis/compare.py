"""Runs compared with each other by one metric: intervals, differences, probability of improvement.

A run's figure is one per seed: the mean of a metric over the last tenth of its episodes. Definitions are those of
Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice". S is the number of seeds.
"""

import csv
import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icac_jax.analysis import subjects
from icac_jax.console import shown
from icac_jax.errors import ConfigError
from icac_jax.reports import results, statistics, titles
from icac_jax.reports.results import Result
from icac_jax.reports.statistics import Estimate
from icac_jax.reports.tables import Table
from icac_jax.reports.verdicts import LARGER_IS_BETTER

# How a figure and a difference are written.
FORMS = {"success_rate": ".1%", "steps": ".2f", "steps_when_reached": ".2f", "extrinsic_reward": ".1f"}
_LONGEST = 40  # characters of a name in a title


class Against(NamedTuple):
    """A run beside the reference, which is the first of a comparison.

    Attributes:
      paired: whether the difference is taken seed by seed.
      difference: mean of the run less that of the reference.
      improvement: probability that a random seed of the run does better than one of the reference; equals count half.
    """

    paired: bool
    difference: Estimate
    improvement: Estimate


class Row(NamedTuple):
    """A run in a comparison.

    Attributes:
      result: the run.
      figures: [S] the metric in the last tenth of each seed's episodes, NaN where a seed has none.
      iqm: interquartile mean over seeds.
      mean: mean over seeds.
      against: beside the reference; None for the reference itself.
    """

    result: Result
    figures: np.ndarray
    iqm: Estimate
    mean: Estimate
    against: Against | None


class Comparison(NamedTuple):
    """Runs by one metric.

    Attributes:
      metric: one of `results.METRICS`.
      rows: of the runs, the reference first, in the order in which they were given.
    """

    metric: str
    rows: list[Row]


def compare(found: Sequence[Result], metric: str = "success_rate") -> Comparison:
    """Compares runs with the first one.

    Args:
      found: at least two.
      metric: one of `results.METRICS`.

    Raises:
      ConfigError: there is no such metric, or no seed of a run has a figure for it.
    """
    if metric not in results.METRICS:
        raise ConfigError(f"metric: must be one of {', '.join(results.METRICS)}, got {metric!r}")
    rows: list[Row] = []
    for result in found:
        figures = results.last_tenth(result)[metric]
        if np.isnan(figures).all():
            raise ConfigError(
                f"metric: {result.name} has no {titles.METRICS[metric]} in the last tenth of its episodes"
            )
        iqm, mean = (statistics.estimate(figures, statistic) for statistic in ("iqm", "mean"))
        against = _against(result, figures, rows[0], metric) if rows else None
        rows.append(Row(result, figures, iqm, mean, against))
    return Comparison(metric, rows)


def _against(result: Result, figures: np.ndarray, reference: Row, metric: str) -> Against:
    paired = subjects.are_paired(result, reference.result)
    if paired:
        both = min(len(figures), len(reference.figures))  # seed k of the one is seed k of the other
        difference = statistics.paired_difference(figures[:both], reference.figures[:both])
    else:
        difference = statistics.difference(figures, reference.figures)
    sign = 1 if LARGER_IS_BETTER[metric] else -1
    mine, theirs = (sign * values[~np.isnan(values)] for values in (figures, reference.figures))
    return Against(paired, difference, statistics.probability_of_improvement(mine, theirs))


def table(comparison: Comparison) -> Table:
    """A row per run: seeds, interquartile mean, and what sets it apart from the first."""
    form, metric = FORMS[comparison.metric], titles.METRICS[comparison.metric]
    first = comparison.rows[0].result.name
    lines = []
    for row in comparison.rows:
        beside = ("reference", "", "")
        if row.against:
            way = "by seed" if row.against.paired else "not paired"
            beside = (row.against.difference.text(f"+{form}"), way, row.against.improvement.text(".2f"))
        settings = row.result.settings
        lines.append((row.result.name, settings.algo, str(settings.run.seeds), row.iqm.text(form), *beside))
    title = (
        f"{metric} in the last tenth: interquartile mean; mean difference to {shown(first, _LONGEST)}; "
        "probability of doing better [95 % interval]"
    )
    header = ("run", "learner", "seeds", metric, "difference", "paired", "P(better)")
    return Table(title, header, lines)


def as_rows(comparison: Comparison) -> list[dict[str, Any]]:
    """A row per run with every number; None where there is none."""
    rows = []
    for row in comparison.rows:
        run, against = row.result.settings.run, row.against
        facts: dict[str, Any] = {"run": row.result.name, "folder": str(row.result.folder), "learner": run.algo}
        facts |= {"seeds": run.seeds, "episodes": run.episodes, "metric": comparison.metric}
        named = {"iqm": row.iqm, "mean": row.mean}
        named |= {"difference": against and against.difference, "p_better": against and against.improvement}
        for name, estimate in named.items():
            ends = (None, None, None) if estimate is None else (statistics.finite(value) for value in estimate)
            facts |= dict(zip((name, f"{name}_low", f"{name}_high"), ends, strict=True))
        rows.append(facts | {"paired": against and against.paired})
    return rows


def as_csv(comparison: Comparison) -> str:
    """`as_rows` as a CSV file; what there is not is empty."""
    rows = as_rows(comparison)
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
