"""The figures of a sweep, chosen by the shape of its grid.

One numeric option: the metric against its values, a line for each combination of the others. Two: heat maps. Otherwise,
and for draws and searches: slices (the metric against each option, averaged over the others) and how much of the
differences between cells each option explains. With few cells their learning curves; always the best cells. With
halving the rungs and the best cells. Style as in `reports.figures`.
"""

import math

from icac_jax.reports.figures import Drawing
from icac_jax.sweeps.effects import importance, slices
from icac_jax.sweeps.grid import Grid
from icac_jax.sweeps.learning_curves import MOST_LINES, MOST_PANELS, curves_fit, learning_curves
from icac_jax.sweeps.ranking import cells, progress, rungs
from icac_jax.sweeps.value_figures import against_value, heat_maps


def all_of(grid: Grid) -> list[Drawing]:
    """Every figure that a study allows; the first ones say most."""
    drawings: list[Drawing] = []
    if len(grid.rows) < 2:
        return [learning_curves(grid)]
    if grid.chosen.halving:  # cells that trained for different times tell nothing about an option together
        return [rungs(grid), cells(grid)]
    numeric = [axis for axis in grid.axes if axis.values is not None and len(axis.labels) > 1 and not axis.drawn]
    words = [axis for axis in grid.axes if axis.values is None]
    combinations = math.prod(len(axis.labels) for axis in words)
    listed = not any(axis.drawn for axis in grid.axes)
    if grid.chosen.search:
        drawings.append(progress(grid))
    if listed and len(numeric) == 1 and combinations <= MOST_LINES:
        drawings.append(against_value(grid, numeric[0], words))
    elif listed and len(numeric) == 2 and combinations <= MOST_PANELS:
        drawings.append(heat_maps(grid, numeric, words))
    elif not listed or len(grid.axes) > 1:
        drawings.append(slices(grid))
    if len(grid.axes) > 2 or (not listed and len(grid.axes) > 1):
        drawings.append(importance(grid))
    drawings.append(cells(grid))
    if curves_fit(grid):
        drawings.append(learning_curves(grid))
    return drawings
