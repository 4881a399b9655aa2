"""The figure of a study of readings: ICAC's lead over CACLA+Var, and both algorithms' steps, reading by reading."""

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from icac_jax.paper.readings import Readings
from icac_jax.reports import titles
from icac_jax.reports.figures import STYLE, blank, look_of
from icac_jax.reports.verdicts import STEPS_TOLERANCE


def draw(readings: Readings) -> Figure:
    """Left how many readings have which lead, right the steps of both algorithms under each reading."""
    first, second = "cacla_var", "icac"
    with matplotlib.rc_context(STYLE):
        figure = blank(9.0, 3.8)
        left, right = figure.subplots(1, 2, width_ratios=[1.2, 1.0])
        edge = max(10.0, np.ceil(np.abs(readings.lead).max()))
        left.hist(readings.lead, bins=np.arange(-edge, edge + 1), color=look_of(second).colour)
        left.axvspan(-STEPS_TOLERANCE, STEPS_TOLERANCE, color="0.88", zorder=0, label="no difference in a figure")
        left.axvline(
            readings.paper[first] - readings.paper[second], color="black", linestyle="--", label="the paper's lead"
        )
        left.set_xlabel(f"lead of {titles.RUNS[second]} over {titles.RUNS[first]}, steps")
        left.set_ylabel("readings")
        top = left.get_ylim()[1]
        left.set_ylim(0, 1.25 * top)
        left.legend(loc="upper left", frameon=False)
        x, y = readings.steps[first], readings.steps[second]
        ends = [0.0, 1.04 * max(x.max(), y.max())]
        right.plot(ends, ends, color="0.6", linewidth=1)
        right.plot(x, y, ".", color=look_of(second).colour, markersize=3, alpha=0.5, label="a reading")
        right.plot(
            *([readings.paper[first]], [readings.paper[second]]),
            marker="o",
            markersize=8,
            markerfacecolor="white",
            markeredgecolor="black",
            linestyle="none",
            label="the paper",
        )
        right.set(xlim=ends, ylim=ends, aspect="equal")
        right.set_xlabel(f"steps of {titles.RUNS[first]}")
        right.set_ylabel(f"steps of {titles.RUNS[second]}")
        right.legend(loc="upper left", frameon=False)
    return figure
