"""The main effect of each option: the metrics averaged over the other options, and the variance that it explains."""

from typing import Any

import matplotlib
import numpy as np
from matplotlib.ticker import PercentFormatter

from icac_jax.reports import statistics
from icac_jax.reports.figures import STYLE, Drawing, Look, blank
from icac_jax.sweeps.grid import DRAWN_GROUPS, Grid, groups_of, metrics, or_nan, places, pooled
from icac_jax.sweeps.panels import COLOUR, draw_estimates, legend, metric_axis, same_scale, value_axis

# Cells whose dots can be told apart; of more an SVG would also be megabytes.
_MOST_DOTS = 500


def _dots(cells: int) -> dict[str, Any]:
    """How dots of so many cells are drawn: thousands as a cloud that is dark where many lie, and as one picture."""
    if cells <= _MOST_DOTS:
        return {"markersize": 5, "alpha": 0.7}
    return {"markersize": 3.5, "alpha": max(0.05, 0.7 * _MOST_DOTS / cells), "rasterized": True}


def slices(grid: Grid) -> Drawing:
    """Success and steps against each option, averaged over the other ones; drawn cells are dots, in groups."""
    varied = [axis for axis in grid.axes if len(axis.labels) > 1]
    shown = metrics(grid)[:2]
    columns = min(4, len(varied))
    blocks = -(-len(varied) // columns)
    with matplotlib.rc_context(STYLE):
        figure = blank(2.4 * columns + 0.6, 2.3 * blocks * len(shown) + 0.2)
        panels = figure.subplots(blocks * len(shown), columns, squeeze=False, sharey=False)
        for panel in panels.flat:
            panel.set_visible(False)
        for number, axis in enumerate(varied):
            block, column = divmod(number, columns)
            for place, metric in enumerate(shown):
                panel = panels[block * len(shown) + place, column]
                panel.set_visible(True)
                if axis.drawn:
                    x = places(axis)[axis.places]
                    y = [or_nan(row[metric.name]) for row in grid.rows]
                    panel.plot(x, y, ".", color="#888888", markeredgewidth=0, **_dots(len(y)))
                found = [(x, pooled(grid, metric.name, mine)) for x, mine in groups_of(axis)]
                look = Look(COLOUR, "none" if axis.values is None else "-", "o")
                draw_estimates(panel, [x for x, _ in found], [one for _, one in found], look)
                metric_axis(panel, metric)
                value_axis(panel, axis)
                if column:
                    panel.set_ylabel("")
        for metric, place in zip(shown, range(len(shown)), strict=True):
            same_scale([panels[block * len(shown) + place] for block in range(blocks)], metric)
    caption = (
        "Last tenth of the episodes against each option, averaged over the others: means over seeds, 95 % intervals"
    )
    if any(axis.drawn for axis in grid.axes):
        caption += f"; a dot is a cell, drawn values are averaged in {DRAWN_GROUPS} groups"
    return Drawing("slices", caption, figure, broad=True)


def explained(grid: Grid, metric: str) -> list[tuple[str, float, float]]:
    """How much of the variance between cells the main effect of each option explains.

    The variance of the means of its groups (functional ANOVA with group means) over that of all cells.

    Returns:
      For each option that varies: its title, its share, and the share to be expected if it had no effect at all.
    """
    y = np.array([or_nan(row[metric]) for row in grid.rows])
    known = ~np.isnan(y)
    found = []
    for axis in grid.axes:
        groups = [mine[known] for _, mine in groups_of(axis)]
        groups = [mine for mine in groups if mine.any()]
        if len(groups) > 1:
            found.append((axis.title, *statistics.explained(y[known], groups)))
    return found


def importance(grid: Grid) -> Drawing:
    """The share of the differences between cells that each option explains by itself."""
    shown = metrics(grid)[:2]
    with matplotlib.rc_context(STYLE | {"axes.grid.axis": "x"}):
        found = {metric.name: explained(grid, metric.name) for metric in shown}
        order = sorted(found[grid.chosen.metric], key=lambda one: one[1])
        titles = [title for title, _, _ in order]
        figure = blank(8.6, 0.42 * len(titles) + 1.3)
        panels = figure.subplots(1, len(shown), sharey=True)
        for panel, metric in zip(panels, shown, strict=True):
            shares = {title: (share, chance) for title, share, chance in found[metric.name]}
            for place, title in enumerate(titles):
                share, chance = shares.get(title, (0.0, 0.0))
                panel.barh(place, share, height=0.62, color=COLOUR)
                marks = dict(color="#D55E00", linewidth=2, label="expected without any effect" if place == 0 else None)
                panel.plot([chance, chance], [place - 0.38, place + 0.38], **marks)
                panel.text(max(share, chance) + 0.015, place, f"{share:.0%}", va="center")
            panel.set_yticks(range(len(titles)), titles)
            panel.set_xlim(0, 1.12)
            panel.xaxis.set_major_formatter(PercentFormatter(1))
            panel.set_xticks([0, 0.25, 0.5, 0.75, 1])
            panel.set_xlabel(f"variance of {metric.title.partition(' (')[0]} explained")
        legend(figure, panels)
    caption = "Share of the variance between cells that each option explains by itself"
    return Drawing("importance", caption, figure, broad=True)
