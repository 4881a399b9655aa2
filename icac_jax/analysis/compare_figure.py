"""The figure of a comparison: learning curves, performance profile, differences, probability of improvement."""

import io

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from icac_jax.analysis.compare import Comparison, Row
from icac_jax.console import shown
from icac_jax.reports import figures, results, statistics, titles
from icac_jax.reports.curves import block_length, draw_curve
from icac_jax.reports.figures import Look, title_of
from icac_jax.reports.statistics import Estimate
from icac_jax.reports.verdicts import LARGER_IS_BETTER

# More lines than this cannot be told apart: the reference and the best others are drawn.
MOST_DRAWN = 12
# With more, intervals around lines only cover each other; the lower panels have them for all.
_MOST_BANDS = 5
_LONGEST = 44  # characters of a name
_COLUMNS = {"success_rate": "reached"}
_PLACES = 101  # of a performance profile
_DOTS_PER_INCH = 160
_NEUTRAL = "#777777"


def chosen(comparison: Comparison) -> list[Row]:
    """The rows that are drawn: all, or the reference and the best by the interquartile mean, in their order."""
    rows = comparison.rows
    sign = -1 if LARGER_IS_BETTER[comparison.metric] else 1
    ranked = sorted(range(1, len(rows)), key=lambda place: sign * rows[place].iqm.value)
    return [rows[place] for place in sorted([0, *ranked[: MOST_DRAWN - 1]])]


def _name(row: Row) -> str:
    return title_of(shown(row.result.name, _LONGEST))


def _curves(axes: Axes, rows: list[Row], looks: list[Look], metric: str) -> None:
    for row, look in zip(rows, looks, strict=True):
        values = results.outcomes(row.result)[_COLUMNS.get(metric, metric)]
        draw_curve(axes, row.result, values, _name(row), look, interval=len(rows) <= _MOST_BANDS)
    length = block_length(rows[0].result)
    axes.set_xlabel(f"episode (means of {length})" if length > 1 else "episode")
    axes.set_ylabel(titles.METRICS[metric])
    axes.set_xlim(0, max(row.result.settings.run.episodes for row in rows))
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    axes.set_title("Learning curves: mean over seeds")


def _profile(axes: Axes, rows: list[Row], looks: list[Look], metric: str) -> None:
    larger = LARGER_IS_BETTER[metric]
    known = np.concatenate([row.figures[~np.isnan(row.figures)] for row in rows])
    margin = 0.03 * (np.ptp(known) or max(abs(known[0]), 1.0))
    limits = np.linspace(known.min() - margin, known.max() + margin, _PLACES)
    for row, look in zip(rows, looks, strict=True):
        band = statistics.performance_profile(row.figures, limits, larger)
        if len(rows) <= _MOST_BANDS:
            axes.fill_between(limits, band.low, band.high, color=look.colour, alpha=0.15, linewidth=0, step="mid")
        axes.plot(limits, band.value, color=look.colour, linestyle=look.line, drawstyle="steps-mid")
    figures.percent_axis(axes, 1.02)
    axes.set_xlim(limits[0], limits[-1])
    axes.set_xlabel(f"{titles.METRICS[metric]} in the last tenth, x")
    axes.set_ylabel(f"seeds {'above' if larger else 'below'} x")
    axes.set_title("Performance profile")


def _forest(axes: Axes, rows: list[Row], looks: list[Look], estimates: list[Estimate], neutral: float) -> None:
    """A line per run, from top to bottom in their order: estimate and interval, beside what would be no difference."""
    axes.axvline(neutral, color=_NEUTRAL, linewidth=1.1, linestyle=(0, (4, 3)))
    for place, (estimate, look) in enumerate(zip(estimates, looks, strict=True)):
        axes.plot([estimate.low, estimate.high], [place, place], color=look.colour, linewidth=2.4, alpha=0.75)
        axes.plot([estimate.value], [place], look.marker, color=look.colour, markersize=6.5)
    axes.set_yticks(range(len(rows)), [_name(row) for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.grid(axis="x")


def draw(comparison: Comparison) -> Figure:
    """The figure of a comparison, four panels."""
    rows = chosen(comparison)
    looks, metric = figures.looks_by_order(len(rows)), comparison.metric
    with matplotlib.rc_context(figures.STYLE):
        figure = figures.blank(11.0, 6.6 + 0.22 * max(0, len(rows) - 4))
        upper, lower = figure.subplots(2, 2)
        _curves(upper[0], rows, looks, metric)
        _profile(upper[1], rows, looks, metric)
        pairs = [(row, look, row.against) for row, look in zip(rows, looks, strict=True) if row.against]
        others, their = [row for row, _, _ in pairs], [look for _, look, _ in pairs]
        _forest(lower[0], others, their, [against.difference for _, _, against in pairs], 0.0)
        paired = [against.paired for _, _, against in pairs]
        way = "paired by seed" if all(paired) else "by seed where paired" if any(paired) else "seeds not paired"
        better = "larger" if LARGER_IS_BETTER[metric] else "smaller"
        lower[0].set_title(f"Difference to {_name(rows[0]).strip()} ({way}; {better} is better)")
        lower[0].set_xlabel(f"difference in {titles.METRICS[metric]}")
        _forest(lower[1], others, their, [against.improvement for _, _, against in pairs], 0.5)
        lower[1].set_xlim(-0.02, 1.02)
        lower[1].set_title(f"Probability of doing better than {_name(rows[0]).strip()}")
        lower[1].set_xlabel("probability of improvement")
        lower[1].sharey(lower[0])
        lower[1].tick_params(labelleft=False)
        if metric == "success_rate":
            figures.percent_axis(upper[0], 1.02)
            for axes in (upper[1], lower[0]):
                axes.xaxis.set_major_formatter(PercentFormatter(1))
        handles, labels = upper[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=min(len(rows), max(1, 120 // _width(labels))))
        if len(rows) < len(comparison.rows):
            note = f"the reference and the best {len(rows) - 1} of {len(comparison.rows) - 1} others"
            figure.supxlabel(note, fontsize=9, color=_NEUTRAL)
        return figure


def _width(labels: list[str]) -> int:
    return 8 + max(map(len, labels))


def png(comparison: Comparison) -> bytes:
    """The figure as a PNG file."""
    buffer = io.BytesIO()
    with figures.writing():
        draw(comparison).savefig(buffer, format="png", dpi=_DOTS_PER_INCH, metadata={"Software": None})
    return buffer.getvalue()
