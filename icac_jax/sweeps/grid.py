"""A trained study as the figures take it: its cells, their metrics, and which cells belong together.

C is the number of cells, S the number of seeds, V the number of values of an axis.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icac_jax.reports import results, statistics
from icac_jax.reports.results import Result
from icac_jax.reports.statistics import Estimate
from icac_jax.reports.titles import METRICS
from icac_jax.settings.options import Settings
from icac_jax.sweeps.axes import Axis
from icac_jax.sweeps.study import Study

# Drawn values are put into so many groups of equal size.
DRAWN_GROUPS = 4


class Grid(NamedTuple):
    """A trained study as the figures take it.

    Attributes:
      chosen: the study.
      rows: its table of cells, in order.
      results: the episodes of each cell, in the same order.
      settings: of each cell, in the same order.
      axes: what varies.
    """

    chosen: Study
    rows: list[dict[str, Any]]
    results: Sequence[Result]
    settings: list[Settings]
    axes: list[Axis]


class Metric(NamedTuple):
    """A metric as it is written at an axis and in a heat map.

    Attributes:
      name: key of `tables.row`.
      title: in words.
      percent: whether it is a share.
    """

    name: str
    title: str
    percent: bool

    def text(self, value: float) -> str:
        """A value in few characters."""
        return "-" if not np.isfinite(value) else f"{value:.0%}" if self.percent else f"{value:.1f}"


def metrics(grid: Grid) -> list[Metric]:
    """Success and steps, before them the study's own metric if it is another; the size of the map if there is one."""
    horizon = grid.settings[0].params.horizon
    found = [Metric("success_rate", "success", True), Metric("steps", f"steps (a failure is {horizon})", False)]
    if grid.chosen.metric not in [metric.name for metric in found]:
        found.insert(0, Metric(grid.chosen.metric, METRICS[grid.chosen.metric], False))
    if any(row["live_nodes"] is not None for row in grid.rows):
        found.append(Metric("live_nodes", "nodes of the map", False))
    return found


def or_nan(value: float | None) -> float:
    """A number of the table of cells; NaN where it has none."""
    return np.nan if value is None else value


def estimate(row: dict[str, Any], metric: Metric) -> Estimate:
    """A metric of a cell with its interval over seeds; the size of the map has none.

    Args:
      row: of the table of cells (`tables.row`).
      metric: which one.
    """
    if metric.name == "live_nodes":
        value = or_nan(row["live_nodes"])
        return Estimate(value, value, value)
    return Estimate(*(or_nan(row[f"{metric.name}_{part}"]) for part in ("iqm", "low", "high")))


def places(axis: Axis) -> np.ndarray:
    """[V] where the values lie on the horizontal axis."""
    return np.arange(len(axis.labels), dtype=float) if axis.values is None else np.array(axis.values)


def combinations(words: Sequence[Axis]) -> list[tuple[str, np.ndarray]]:
    """Each combination of values in words: its name and which cells have it, [C] bool."""
    found = []
    for chosen in itertools.product(*(range(len(axis.labels)) for axis in words)):
        mine = np.all([axis.places == place for axis, place in zip(words, chosen, strict=True)], axis=0)
        pairs = [(axis, axis.labels[place]) for axis, place in zip(words, chosen, strict=True)]
        labels = [label if axis.values is None else f"{axis.title} {label}" for axis, label in pairs]
        found.append((", ".join(labels), mine))
    return found


def pooled(grid: Grid, metric: str, mine: np.ndarray) -> Estimate:
    """The metric averaged over some cells: mean over seeds of each seed's mean over these cells, with its interval."""
    values = [grid.rows[cell]["by_seed"][metric] for cell in np.flatnonzero(mine)]
    if len({len(one) for one in values}) > 1:
        values = [[or_nan(grid.rows[cell][metric])] for cell in np.flatnonzero(mine)]
    return statistics.estimate(results.mean_of_known(np.array(values, float), axis=0), "mean")


def groups_of(axis: Axis) -> list[tuple[float, np.ndarray]]:
    """Cells with the same value of an option, or, where it was drawn, with neighbouring ones: place and [C] bool."""
    if not axis.drawn or axis.values is None:
        return [(place, axis.places == number) for number, place in enumerate(places(axis))]
    values = np.array(axis.values)[axis.places]
    parts = np.array_split(np.argsort(values, kind="stable"), min(DRAWN_GROUPS, len(values)))
    return [(float(np.median(values[part])), np.isin(np.arange(len(values)), part)) for part in parts]
