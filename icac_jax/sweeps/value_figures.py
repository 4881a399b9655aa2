"""The metrics against the values of one option, or over those of two, which are listed numbers."""

from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from icac_jax.reports.figures import STYLE, Drawing, blank, title_of
from icac_jax.sweeps import axes as sweep_axes
from icac_jax.sweeps.axes import Axis
from icac_jax.sweeps.grid import Grid, Metric, combinations, estimate, metrics, places
from icac_jax.sweeps.panels import draw_estimates, draw_oracle, legend, look_of, metric_axis, value_axis
from icac_jax.sweeps.study import OBJECTIVES

_REFERENCE = "#777777"


def _reference_places(grid: Grid, axis: Axis) -> list[float]:
    """Where the values of [reference] lie on an axis."""
    words = {sweep_axes.short(value) for value in grid.chosen.reference.values()}
    if set(axis.title.split(" = ")) <= set(grid.chosen.reference):
        return [place for place, label in zip(places(axis), axis.labels, strict=True) if label in words]
    return []


def against_value(grid: Grid, numeric: Axis, words: Sequence[Axis]) -> Drawing:
    """Each metric against the values of one option, a line for each combination of the others."""
    shown = metrics(grid)
    lines = combinations(words) if words else [("", np.ones(len(grid.rows), bool))]
    with matplotlib.rc_context(STYLE):
        figure = blank(3.3 * len(shown) + 0.4, 3.5)
        panels = list(np.atleast_1d(figure.subplots(1, len(shown))))
        x = places(numeric)
        for panel, metric in zip(panels, shown, strict=True):
            for place in _reference_places(grid, numeric):
                panel.axvline(place, color=_REFERENCE, linewidth=1.1, linestyle=(0, (2, 2)), label="reference")
            for number, (label, mine) in enumerate(lines):
                at = np.flatnonzero(mine)
                at = at[np.argsort(numeric.places[at])]
                found = [estimate(grid.rows[cell], metric) for cell in at]
                if all(np.isnan(one.value) for one in found):
                    continue
                draw_estimates(panel, x[numeric.places[at]], found, look_of(label, number), title_of(label))
            if metric.name == "steps":
                draw_oracle(panel, grid)
            metric_axis(panel, metric)
            value_axis(panel, numeric)
        legend(figure, panels)
    by = f", by {' and '.join(axis.title for axis in words)}" if words else ""
    caption = f"Last tenth of the episodes against {numeric.title}{by}: interquartile means over seeds, 95 % intervals"
    return Drawing("values", caption, figure, broad=True)


def heat_maps(grid: Grid, numeric: Sequence[Axis], words: Sequence[Axis]) -> Drawing:
    """Success and steps over two options, with their numbers; a row of maps for each combination of the others."""
    shown = metrics(grid)[:2]
    across, up = sorted(numeric, key=lambda axis: -len(axis.labels))
    rows = combinations(words) if words else [("", np.ones(len(grid.rows), bool))]
    with matplotlib.rc_context(STYLE | {"axes.grid": False}):
        size = (max(3.4, 0.75 * len(across.labels) + 1.9), 0.5 * len(up.labels) + 1.3)
        figure = blank(size[0] * len(shown), size[1] * len(rows))
        panels = figure.subplots(len(rows), len(shown), squeeze=False)
        for place, metric in enumerate(shown):
            tables_of = []
            for _, mine in rows:
                values = np.full((len(up.labels), len(across.labels)), np.nan)
                for cell in np.flatnonzero(mine):
                    values[up.places[cell], across.places[cell]] = estimate(grid.rows[cell], metric).value
                tables_of.append(values)
            known = np.concatenate([values.ravel() for values in tables_of])
            ends = (np.nanmin(known), np.nanmax(known)) if np.any(np.isfinite(known)) else (0.0, 1.0)
            for (label, _), values, panel in zip(rows, tables_of, panels[:, place], strict=True):
                _heat_map(panel, values, metric, across, up, ends)
                panel.set_title(", ".join(text for text in (metric.title, label) if text))
                _mark_reference(grid, panel, across, up)
    caption = (
        f"Last tenth of the episodes by {across.title} and {up.title}: interquartile means over seeds, dark is better"
    )
    if grid.chosen.reference:
        caption += "; framed: the reference"
    return Drawing("heat_map", caption, figure, broad=True)


def _heat_map(
    panel: Axes, values: np.ndarray, metric: Metric, across: Axis, up: Axis, ends: tuple[float, float]
) -> None:
    better = OBJECTIVES[metric.name]
    panel.imshow(
        values, cmap="YlGnBu" if better else "YlGnBu_r", vmin=ends[0], vmax=ends[1], aspect="auto", origin="lower"
    )
    for (row, column), value in np.ndenumerate(values):
        share = (value - ends[0]) / (ends[1] - ends[0]) if ends[1] > ends[0] else 0.0
        dark = (share if better else 1 - share) > 0.55
        panel.text(column, row, metric.text(value), ha="center", va="center", color="white" if dark else "black")
    panel.set_xticks(range(len(across.labels)), across.labels)
    panel.set_yticks(range(len(up.labels)), up.labels)
    panel.set_xlabel(across.title)
    panel.set_ylabel(up.title)
    panel.tick_params(length=0)
    for side in panel.spines.values():
        side.set_visible(False)


def _mark_reference(grid: Grid, panel: Axes, across: Axis, up: Axis) -> None:
    names = [set(axis.title.split(" = ")) for axis in (across, up)]
    if grid.chosen.reference and all(name <= set(grid.chosen.reference) for name in names):
        at = [
            axis.labels.index(sweep_axes.short(grid.chosen.reference[min(name)]))
            for axis, name in zip((across, up), names, strict=True)
        ]
        frame = Rectangle((at[0] - 0.5, at[1] - 0.5), 1, 1, fill=False, edgecolor="#D55E00", linewidth=2.2)
        panel.add_patch(frame)
