"""Learning curves of all cells of a sweep, where few enough can be told apart."""

import math

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.ticker import MaxNLocator

from icac_jax.reports import results
from icac_jax.reports.curves import block_length, draw_curve
from icac_jax.reports.figures import STYLE, Drawing, Look, blank, title_of
from icac_jax.sweeps.axes import Axis
from icac_jax.sweeps.grid import Grid, Metric, combinations
from icac_jax.sweeps.panels import legend, look_of, metric_axis, same_scale

MOST_LINES = 8
MOST_PANELS = 6


def _curve_axes(grid: Grid) -> tuple[Axis | None, list[Axis]]:
    """Whose values are lines, and whose combinations are panels."""
    varied = [axis for axis in grid.axes if len(axis.labels) > 1]
    if not varied:
        return None, []
    fitting = [axis for axis in varied if len(axis.labels) <= MOST_LINES] or varied
    numeric = [axis for axis in fitting if axis.values is not None]
    lines = (numeric or fitting)[-1]
    return lines, [axis for axis in varied if axis is not lines]


def curves_fit(grid: Grid) -> bool:
    """Whether learning curves of all cells can be told apart."""
    lines, panels = _curve_axes(grid)
    if lines is None:
        return True
    number = math.prod(len(axis.labels) for axis in panels)
    return len(lines.labels) <= MOST_LINES and number <= MOST_PANELS and not any(axis.drawn for axis in grid.axes)


def learning_curves(grid: Grid) -> Drawing:
    """Success and steps of every cell while it learns: one line per value of one option, one column per other one."""
    lines, others = _curve_axes(grid)
    panels = combinations(others) if others else [("", np.ones(len(grid.rows), bool))]
    with matplotlib.rc_context(STYLE | {"lines.linewidth": 1.3, "lines.markersize": 4}):
        columns = min(3, len(panels))
        blocks = -(-len(panels) // columns)
        # One panel per metric: side by side. Several: one row per metric.
        shape = (1, 2) if len(panels) == 1 else (2 * blocks, columns)
        figure = blank(7.4 if shape[0] == 1 else 3.1 * columns + 0.4, 2.2 * shape[0] + (1.0 if shape[0] == 1 else 0.5))
        drawn = figure.subplots(*shape, squeeze=False)
        by_metric: list[list[Axes]] = [[], []]
        for panel in drawn.flat:
            panel.set_visible(False)
        for number, (label, mine) in enumerate(panels):
            block, column = divmod(number, columns)
            for place, (name, title) in enumerate((("reached", "success"), ("steps", "steps"))):
                panel = drawn[0, place] if shape[0] == 1 else drawn[2 * block + place, column]
                by_metric[place].append(panel)
                panel.set_visible(True)
                for cell in np.flatnonzero(mine).tolist():
                    at = int(lines.places[cell]) if lines is not None else 0
                    result = grid.results[cell]
                    values = results.outcomes(result)[name]
                    draw_curve(panel, result, values, _line_title(grid, lines, at), _line_look(lines, at))
                metric_axis(panel, Metric(name, title, name == "reached"))
                panel.set_xlim(left=0)
                panel.xaxis.set_major_locator(MaxNLocator(4, integer=True))
                if place == 0 or shape[0] == 1:
                    panel.set_title(title_of(label))
                if place == 1 or shape[0] == 1:
                    panel.set_xlabel("episode")
                if column:
                    panel.set_ylabel("")
        same_scale([by_metric[1]], Metric("steps", "steps", False))
        legend(figure, list(drawn.flat))
    length = block_length(grid.results[0])
    caption = f"Learning curves of the cells: means over seeds and {length} episodes, 95 % intervals over seeds"
    return Drawing("curves", caption, figure, broad=True)


def _line_title(grid: Grid, lines: Axis | None, place: int) -> str:
    if lines is None:
        return grid.rows[0]["name"]
    label = lines.labels[place]
    return title_of(label) if lines.values is None else f"{lines.title} {label}"


def _line_look(lines: Axis | None, place: int) -> Look:
    """Numbers run through a scale of colours, words have one each."""
    if lines is None or lines.values is None:
        return look_of(lines.labels[place] if lines is not None else "icac", place)
    share = place / max(len(lines.labels) - 1, 1)
    colour = to_hex(matplotlib.colormaps["viridis"](0.9 * share))
    return Look(colour, "-", "osD^vPX*"[place % 8])
