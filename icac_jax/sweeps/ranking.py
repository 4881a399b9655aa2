"""Which cells are best: the cells side by side, what a search found on its way, and who went on in halving."""

import matplotlib
import numpy as np
from matplotlib.ticker import MaxNLocator, PercentFormatter

from icac_jax.reports.figures import STYLE, Drawing, blank
from icac_jax.reports.titles import METRICS
from icac_jax.sweeps import tables
from icac_jax.sweeps.grid import Grid, estimate, metrics, or_nan
from icac_jax.sweeps.panels import COLOUR, draw_oracle, legend, metric_axis
from icac_jax.sweeps.study import OBJECTIVES

_MOST_BEST = 15
_MOST_LISTED = 40


def cells(grid: Grid) -> Drawing:
    """Cells with their intervals: all of a short list in its order, or the best by the study's metric."""
    asking = grid.chosen.search or grid.chosen.halving
    few = len(grid.rows) <= _MOST_LISTED and not asking and all(axis.values is None for axis in grid.axes)
    ranked = tables.ranked(grid.rows, grid.chosen.metric)
    best, rows = ranked[0], grid.rows if few else ranked[:_MOST_BEST]
    equal = {one["cell"] for one in tables.within_noise(best, rows, grid.chosen.metric)}
    first = f"best by {METRICS[grid.chosen.metric]}"
    shown = metrics(grid)[:2]
    with matplotlib.rc_context(STYLE | {"axes.grid.axis": "x"}):
        longest = max(len(one["name"]) for one in rows)
        figure = blank(5.6 + 0.075 * min(longest, 90), 0.27 * len(rows) + 1.2)
        panels = figure.subplots(1, len(shown), sharey=True)
        for panel, metric in zip(panels, shown, strict=True):
            for place, row in enumerate(rows):
                found = estimate(row, metric)
                colour = COLOUR if row is best else "#56B4E9" if row["cell"] in equal else "#888888"
                title = first if row is best else "within noise of it" if row["cell"] in equal else "others"
                width = np.clip([[found.value - found.low], [found.high - found.value]], 0, None)
                panel.errorbar(
                    *([found.value], [place]),
                    xerr=width,
                    color=colour,
                    marker="o",
                    linestyle="none",
                    capsize=2.5,
                    label=title,
                )
            panel.set_xlabel(metric.title)
            panel.set_yticks(range(len(rows)), [one["name"] for one in rows])
            panel.set_ylim(len(rows) - 0.4, -0.6)
            if metric.percent:
                panel.set_xlim(0, 1.03)
                panel.xaxis.set_major_formatter(PercentFormatter(1))
            elif metric.name != "extrinsic_reward":  # which may be negative
                panel.set_xlim(left=0)
        legend(figure, panels)
    which = "All" if len(rows) == len(grid.rows) else f"The best {len(rows)} of {len(grid.rows)}"
    return Drawing("cells", f"{which} cells: interquartile means over seeds, 95 % intervals", figure, broad=True)


def progress(grid: Grid) -> Drawing:
    """What a search found: the metric of each cell in the order in which they were tried, and the best so far."""
    search = grid.chosen.search
    assert search is not None
    y = np.array([or_nan(row[search.metric]) for row in grid.rows])
    best = np.fmax.accumulate(y) if OBJECTIVES[search.metric] else np.fmin.accumulate(y)
    with matplotlib.rc_context(STYLE):
        figure = blank()
        axes = figure.add_subplot()
        x = np.arange(1, len(y) + 1)
        axes.plot(x, y, "o", color="#888888", markersize=3.5, label="a cell")
        axes.step(x, best, where="post", color=COLOUR, label="best so far")
        (metric,) = (one for one in metrics(grid) if one.name == search.metric)
        metric_axis(axes, metric)
        if search.metric == "steps":
            draw_oracle(axes, grid)
        axes.set_xlabel("cells tried")
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        legend(figure, [axes])
    return Drawing("search", "The search: the mean over seeds of each cell tried, and the best so far", figure)


def rungs(grid: Grid) -> Drawing:
    """Halving: the metric of each cell at each of its rungs; the cells of the last one have colours."""
    halving = grid.chosen.halving
    assert halving is not None
    ranked = tables.ranked(grid.rows, halving.metric)
    episodes = halving.rungs(max(settings.run.episodes for settings in grid.settings))
    with matplotlib.rc_context(STYLE):
        figure = blank()
        axes = figure.add_subplot()
        for row in reversed(ranked):
            y = [or_nan(value) for value in row["at_rungs"]]
            last, best = len(y) == len(episodes), row is ranked[0]
            colour = COLOUR if best else "#56B4E9" if last else "#888888"
            label = "the best cell" if best else "others of the last rung" if last else "stopped before"
            axes.plot(episodes[: len(y)], y, "o-", color=colour, markersize=3.5, lw=1.8 if best else 0.9, label=label)
        (metric,) = (one for one in metrics(grid) if one.name == halving.metric)
        metric_axis(axes, metric)
        if halving.metric == "steps":
            draw_oracle(axes, grid)
        axes.set_xscale("log")
        axes.set_xticks(episodes, [f"{number:,}" for number in episodes])
        axes.minorticks_off()
        axes.set_xlabel("episodes")
        legend(figure, [axes])
    title = "Halving: interquartile means over seeds of each cell at each of its rungs, last tenth of its episodes"
    return Drawing("halving", title, figure)
