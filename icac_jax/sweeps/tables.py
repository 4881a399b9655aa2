"""The table of a sweep: one row per cell, its metrics over seeds with intervals."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from icac_jax.reports import results, statistics, titles
from icac_jax.reports.results import Result
from icac_jax.runs import oracles, summary
from icac_jax.sweeps.study import OBJECTIVES, Cell

CELLS = "cells.csv"
# Metrics over the last tenth of the episodes that have an interquartile mean and an interval.
ESTIMATED = results.METRICS
# How each metric that a study can be about is written, and how wide its column is on a terminal.
FORMS = {"success_rate": ".1%", "steps": ".2f", "extrinsic_reward": ".1f"}
_WIDTHS = {"success_rate": 26, "steps": 22, "extrinsic_reward": 30}


def result_of(cell: Cell, episodes: pa.Table, jobs: dict[str, list[Any]]) -> Result:
    """A cell as the figures and statistics of single runs take it.

    Args:
      cell: the cell.
      episodes: its episodes (`records.SCHEMA`).
      jobs: `episodes_done` and `failed` of each seed.
    """
    failed = {str(seed): jobs["episodes_done"][seed] for seed, lost in enumerate(jobs["failed"]) if lost}
    return Result(cell.name, cell.settings, episodes, {"failed_seeds": failed}, Path())


def row(cell: Cell, result: Result, jobs: dict[str, list[Any]]) -> dict[str, Any]:
    """One row of the table, as JSON can hold it.

    Args:
      cell: the cell.
      result: its episodes, by `result_of`.
      jobs: `episodes_done`, `failed` and `steps` of each seed.

    Returns:
      `cell`, `name`, `varied`; for each of `ESTIMATED` its mean over seeds, and with the suffixes `_iqm`, `_low`,
      `_high` the interquartile mean and its 95 % interval; `by_seed`; `steps_over_oracle`, `live_nodes`, `overflow`,
      `failed_lanes`, `lane_steps`, `episodes_done`. Metrics are over the last tenth of the episodes.
    """
    by_seed = results.last_tenth(result)
    figures: dict[str, float | None] = {}
    for name in ESTIMATED:
        known = by_seed[name][~np.isnan(by_seed[name])]
        centre = statistics.estimate(by_seed[name], "iqm")
        figures[name] = statistics.finite(known.mean() if len(known) else np.nan)
        figures |= {
            f"{name}_iqm": statistics.finite(centre.value),
            f"{name}_low": statistics.finite(centre.low),
            f"{name}_high": statistics.finite(centre.high),
        }
    least, steps = oracles.mean_steps(cell.settings), figures["steps"]
    return {
        "cell": cell.number,
        "name": cell.name,
        "varied": cell.varied,
        **figures,
        "oracle_steps": least,
        "steps_over_oracle": steps / least if least and steps is not None else None,
        **summary.of_map(result.table, cell.settings.run.episodes),
        "failed_lanes": sum(jobs["failed"]),
        "lane_steps": sum(jobs["steps"]),
        "episodes_done": sum(jobs["episodes_done"]),
        "by_seed": {name: [statistics.finite(value) for value in by_seed[name]] for name in OBJECTIVES},
    }


def as_csv(rows: list[dict[str, Any]]) -> str:
    """The table as a CSV file: the varied options first, then the figures."""
    varied = list(dict.fromkeys(name for one in rows for name in one["varied"]))
    figures = [name for name in rows[0] if name not in ("cell", "name", "varied", "by_seed", "at_rungs")]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["cell", *varied, *figures])
    for one in rows:
        settings = ["" if one["varied"].get(name) is None else _cell(one["varied"][name]) for name in varied]
        writer.writerow([one["cell"], *settings, *("" if one[name] is None else one[name] for name in figures)])
    return text.getvalue()


def _cell(value: Any) -> Any:
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else value


def as_text(rows: list[dict[str, Any]], most: int, metric: str = "steps") -> str:
    """The table for a person: interquartile means over seeds with intervals, the best cell first.

    Args:
      rows: of the table.
      most: rows shown.
      metric: by which the best one is found, a key of `OBJECTIVES`.
    """
    rows = ranked(rows, metric)
    width = max(len(one["name"]) for one in rows)
    columns = {name: width for name, width in _WIDTHS.items() if name != "extrinsic_reward" or name == metric}
    head = "".join(f"  {f'{titles.METRICS[name]}, IQM [95 %]':>{width}}" for name, width in columns.items())
    lines = [f"{'':{width}}{head}  {'/ oracle':>8}  {'nodes':>6}  overflow  diverged"]
    for one in rows[:most]:
        figures = "".join(f"  {interval(one, name):>{width}}" for name, width in columns.items())
        lines.append(
            f"{one['name']:{width}}{figures}"
            f"  {_number(one['steps_over_oracle'], '.2f'):>8}  {_number(one['live_nodes'], '.1f'):>6}"
            f"  {_number(one['overflow'], 'd'):>8}  {one['failed_lanes']:>8}"
        )
    if len(rows) > most:
        lines.append(f"... and {len(rows) - most} more, all in {CELLS}")
    return "\n".join(lines)


def shown_by(metric: str) -> str:
    """What the figures of a table of cells are, and in which order its rows: for its title.

    Args:
      metric: by which the best one is found.
    """
    return (
        "interquartile mean over seeds [95 % interval], the best first by the interquartile mean of "
        f"{titles.METRICS[metric]}; steps / oracle by the mean"
    )


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def interval(one: dict[str, Any], metric: str) -> str:
    """A metric of a row in words: interquartile mean [low, high]."""
    form = FORMS[metric]
    value, low, high = (_number(one[f"{metric}_{part}"], form) for part in ("iqm", "low", "high"))
    return f"{value} [{low}, {high}]"


def ranked(rows: list[dict[str, Any]], metric: str = "steps") -> list[dict[str, Any]]:
    """Rows from best to worst by what tables show of a metric of `OBJECTIVES`, its interquartile mean over seeds.

    Those without it come last; among equals those with the better mean come first. With halving those of a later rung
    come before all others.
    """
    sign = -1.0 if OBJECTIVES[metric] else 1.0

    def place(one: dict[str, Any]) -> tuple[int, bool, float, float, int]:
        centre, mean = one[f"{metric}_iqm"], one[metric]
        return -one.get("rung", 0), centre is None, sign * (centre or 0.0), sign * (mean or 0.0), one["cell"]

    return sorted(rows, key=place)


def within_noise(best: dict[str, Any], rows: list[dict[str, Any]], metric: str = "steps") -> list[dict[str, Any]]:
    """The other rows that the best one does not beat clearly.

    Seeds are paired: the interval of the mean difference over the seeds does not lie wholly on the side of better. With
    halving only those that trained for as long as the best one are compared with it.
    """
    found = []
    for other in rows:
        if other is best or other[metric] is None or other.get("rung") != best.get("rung"):
            continue
        one, two = (np.array([np.nan if v is None else v for v in r["by_seed"][metric]]) for r in (best, other))
        if len(one) != len(two):
            continue
        difference = statistics.paired_difference(one, two)
        beaten = difference.low > 0 if OBJECTIVES[metric] else difference.high < 0
        if not beaten and np.isfinite(difference.value):
            found.append(other)
    return found
