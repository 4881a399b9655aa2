"""Parts that the figures of a sweep share: axes of metrics and of options, looks of lines, legends."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from icac_jax.reports import curves
from icac_jax.reports.figures import LOOKS, Look, legend_columns, percent_axis
from icac_jax.reports.statistics import Estimate
from icac_jax.reports.titles import METRICS
from icac_jax.sweeps.axes import Axis
from icac_jax.sweeps.grid import Grid, Metric

# In this order in a legend, before all others.
_FIRST = [*(f"best by {title}" for title in METRICS.values()), "within noise of it", "others"]
# Beyond this ratio of the largest to the least value an axis is logarithmic.
_WIDE = 8.0
# Of lines that are no algorithm or run of the paper, in this order.
_LOOKS = [LOOKS[name] for name in ("icac", "cacla", "cacla_var", "icac-single_predictor")]
_LOOKS += [LOOKS["icac-learning_progress"], LOOKS["icac-perception_error"], Look("#555555", "-", "x")]
COLOUR = _LOOKS[0].colour  # where one is enough


def metric_axis(axes: Axes, metric: Metric) -> None:
    """The metric on the vertical axis."""
    axes.set_ylabel(metric.title)
    if metric.percent:
        percent_axis(axes, 1.03)
    elif metric.name != "extrinsic_reward":  # which may be negative
        axes.set_ylim(0, max(axes.get_ylim()[1], 1.06 * axes.dataLim.y1 if np.isfinite(axes.dataLim.y1) else 1.0))


def value_axis(axes: Axes, axis: Axis) -> None:
    """The values of an option on the horizontal axis: where they lie if numbers, side by side if words."""
    axes.set_xlabel(axis.title)
    if axis.values is None:
        axes.set_xticks(range(len(axis.labels)), axis.labels)
        axes.set_xlim(-0.5, len(axis.labels) - 0.5)
        if max(map(len, axis.labels)) * len(axis.labels) > 24:
            axes.tick_params(axis="x", rotation=25)
            for label in axes.get_xticklabels():
                label.set_horizontalalignment("right")
        return
    values = np.array(axis.values)
    if values[0] > 0 and values[-1] / values[0] >= _WIDE:
        axes.set_xscale("log")
        axes.xaxis.set_minor_locator(NullLocator())
    if axis.drawn:
        if axes.get_xscale() == "linear":
            axes.xaxis.set_major_locator(MaxNLocator(4))
        else:
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 3) if values[-1] / values[0] < 1000 else (1,)))
            axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        return
    axes.set_xticks(values, axis.labels)
    shown = np.log(values) if axes.get_xscale() == "log" else values
    if len(values) > 1 and np.diff(shown).min() < 0.03 * len(max(axis.labels, key=len)) * np.ptp(shown):
        axes.tick_params(axis="x", rotation=45)


def draw_estimates(
    panel: Axes, x: Sequence[float] | np.ndarray, found: Sequence[Estimate], look: Look, label: str = ""
) -> None:
    """Draws estimates with their intervals.

    Args:
      panel: where.
      x: place of each on the horizontal axis.
      found: the estimates.
      look: of line, markers and intervals.
      label: in the legend; none by default.
    """
    value, low, high = np.array(found).T
    panel.errorbar(
        *(x, value, np.clip([value - low, high - value], 0, None)),
        color=look.colour,
        linestyle=look.line,
        marker=look.marker,
        capsize=2.5,
        elinewidth=1.0,
        label=label or None,
    )


def look_of(label: str, place: int) -> Look:
    """How the line of a value in words is drawn: algorithms as everywhere, others by their place."""
    return LOOKS.get(label) or _LOOKS[place % len(_LOOKS)]


def draw_oracle(panel: Axes, grid: Grid) -> None:
    """The least number of steps on average, where it is the same for all cells."""
    least = {row["oracle_steps"] for row in grid.rows}
    if len(least) == 1 and None not in least:
        (value,) = least
        curves.draw_oracle(panel, value)


def legend(figure: Figure, panels: Sequence[Axes], beside: bool = False) -> None:
    """One legend for all panels, each label once: above them in as many columns as fit, or beside them in one."""
    found: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    if found:
        labels = sorted(found, key=lambda label: _FIRST.index(label) if label in _FIRST else len(_FIRST))
        if beside:
            figure.legend([found[label] for label in labels], labels, loc="outside right center")
            return
        columns = legend_columns(figure, labels)
        figure.legend([found[label] for label in labels], labels, loc="outside upper center", ncols=columns)


def same_scale(rows: Sequence[Sequence[Axes]], metric: Metric) -> None:
    """Gives panels of a metric the same vertical axis; a share has the same one everywhere."""
    if not metric.percent:
        ends = [panel.get_ylim() for row in rows for panel in row if panel.get_visible()]
        bottom = min(0.0, *(low for low, _ in ends)) if metric.name == "extrinsic_reward" else 0.0
        for row in rows:
            for panel in row:
                panel.set_ylim(bottom, max(high for _, high in ends))
