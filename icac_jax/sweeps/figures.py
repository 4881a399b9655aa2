"""The figures of a sweep, chosen by the shape of its grid.

One numeric option: the metric against its values, a line for each combination of the others. Two: heat maps. Otherwise,
and for draws and searches: slices (the metric against each option, averaged over the others) and how much of the
differences between cells each option explains. With few cells their learning curves; always the best cells. Style as in
`icac_jax.paper.figures`; C is the number of cells, S the number of seeds.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator, PercentFormatter

from icac_jax.paper import figures
from icac_jax.paper.figures import Drawing, Look
from icac_jax.reports import results, statistics
from icac_jax.reports.results import Result
from icac_jax.reports.statistics import Estimate
from icac_jax.sweeps import axes as sweep_axes
from icac_jax.sweeps import tables
from icac_jax.sweeps.axes import Axis
from icac_jax.sweeps.study import OBJECTIVES, Study

_MOST_LINES = 8
_MOST_PANELS = 6
_MOST_BEST = 15
_MOST_LISTED = 40
# In this order in a legend, before all others.
_FIRST = ["best by steps", "within noise of it", "others"]
# Beyond this ratio of the largest to the least value an axis is logarithmic.
_WIDE = 8.0
# Drawn values are put into so many groups of equal size.
_GROUPS = 4
_REFERENCE = "#777777"
_LOOKS = [figures.LOOKS[name] for name in ("icac", "cacla", "cacla_var", "icac-single_predictor")]
_LOOKS += [figures.LOOKS["icac-learning_progress"], figures.LOOKS["icac-perception_error"], Look("#555555", "-", "x")]


class Grid(NamedTuple):
    """A trained study as the figures take it.

    Attributes:
      chosen: the study.
      rows: its table of cells, in order.
      results: the episodes of each cell, in the same order.
      axes: what varies.
    """

    chosen: Study
    rows: list[dict[str, Any]]
    results: list[Result]
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
    """Success and steps, and the size of the map where there is one."""
    horizon = grid.results[0].settings.params.horizon
    found = [Metric("success_rate", "success", True), Metric("steps", f"steps (a failure is {horizon})", False)]
    if any(row["live_nodes"] is not None for row in grid.rows):
        found.append(Metric("live_nodes", "nodes of the map", False))
    return found


def all_of(grid: Grid) -> list[Drawing]:
    """Every figure that a study allows; the first ones say most."""
    drawings: list[Drawing] = []
    if len(grid.rows) < 2:
        return [learning_curves(grid)]
    numeric = [axis for axis in grid.axes if axis.values is not None and len(axis.labels) > 1 and not axis.drawn]
    words = [axis for axis in grid.axes if axis.values is None]
    combinations = math.prod(len(axis.labels) for axis in words)
    listed = not any(axis.drawn for axis in grid.axes)
    if grid.chosen.search:
        drawings.append(progress(grid))
    if listed and len(numeric) == 1 and combinations <= _MOST_LINES:
        drawings.append(against_value(grid, numeric[0], words))
    elif listed and len(numeric) == 2 and combinations <= _MOST_PANELS:
        drawings.append(heat_maps(grid, numeric, words))
    elif not listed or len(grid.axes) > 1:
        drawings.append(slices(grid))
    if len(grid.axes) > 2 or (not listed and len(grid.axes) > 1):
        drawings.append(importance(grid))
    drawings.append(cells(grid))
    if curves_fit(grid):
        drawings.append(learning_curves(grid))
    return drawings


def _known(value: float | None) -> float:
    return np.nan if value is None else value


def _estimate(row: dict[str, Any], metric: Metric) -> Estimate:
    if metric.name == "live_nodes":
        value = _known(row["live_nodes"])
        return Estimate(value, value, value)
    return Estimate(*(_known(row[f"{metric.name}_{part}"]) for part in ("iqm", "low", "high")))


def _finish(axes: Axes, metric: Metric) -> None:
    """The metric on the vertical axis."""
    axes.set_ylabel(metric.title)
    if metric.percent:
        axes.set_ylim(0, 1.03)
        axes.yaxis.set_major_formatter(PercentFormatter(1))
    else:
        axes.set_ylim(0, max(axes.get_ylim()[1], 1.06 * axes.dataLim.y1 if np.isfinite(axes.dataLim.y1) else 1.0))


def _value_axis(axes: Axes, axis: Axis) -> None:
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


def _places(axis: Axis) -> np.ndarray:
    """[V] where the values lie on the horizontal axis."""
    return np.arange(len(axis.labels), dtype=float) if axis.values is None else np.array(axis.values)


def _combinations(words: Sequence[Axis]) -> list[tuple[str, np.ndarray]]:
    """Each combination of values in words: its name and which cells have it, [C] bool."""
    found = []
    for chosen in itertools.product(*(range(len(axis.labels)) for axis in words)):
        mine = np.all([axis.places == place for axis, place in zip(words, chosen, strict=True)], axis=0)
        pairs = [(axis, axis.labels[place]) for axis, place in zip(words, chosen, strict=True)]
        labels = [label if axis.values is None else f"{axis.title} {label}" for axis, label in pairs]
        found.append((", ".join(labels), mine))
    return found


def _look(label: str, place: int) -> Look:
    return figures.LOOKS.get(label) or _LOOKS[place % len(_LOOKS)]


def _reference_places(grid: Grid, axis: Axis) -> list[float]:
    """Where the values of [reference] lie on an axis."""
    words = {sweep_axes.short(value) for value in grid.chosen.reference.values()}
    if set(axis.title.split(" = ")) <= set(grid.chosen.reference):
        return [place for place, label in zip(_places(axis), axis.labels, strict=True) if label in words]
    return []


def against_value(grid: Grid, numeric: Axis, words: Sequence[Axis]) -> Drawing:
    """Each metric against the values of one option, a line for each combination of the others."""
    shown = metrics(grid)
    lines = _combinations(words) if words else [("", np.ones(len(grid.rows), bool))]
    with matplotlib.rc_context(figures.STYLE):
        figure = figures.blank(3.3 * len(shown) + 0.4, 3.5)
        panels = list(np.atleast_1d(figure.subplots(1, len(shown))))
        x = _places(numeric)
        for panel, metric in zip(panels, shown, strict=True):
            for place in _reference_places(grid, numeric):
                panel.axvline(place, color=_REFERENCE, linewidth=1.1, linestyle=(0, (2, 2)), label="reference")
            for number, (label, mine) in enumerate(lines):
                at = np.flatnonzero(mine)
                at = at[np.argsort(numeric.places[at])]
                found = [_estimate(grid.rows[cell], metric) for cell in at]
                value, low, high = (np.array([getattr(one, part) for one in found]) for part in Estimate._fields)
                if np.all(np.isnan(value)):
                    continue
                look = _look(label, number)
                panel.errorbar(
                    *(x[numeric.places[at]], value, np.clip([value - low, high - value], 0, None)),
                    color=look.colour,
                    linestyle=look.line,
                    marker=look.marker,
                    capsize=2.5,
                    elinewidth=1.0,
                    label=figures.title_of(label) or None,
                )
            if metric.name == "steps":
                _oracle(panel, grid)
            _finish(panel, metric)
            _value_axis(panel, numeric)
        _legend(figure, panels)
    by = f", by {' and '.join(axis.title for axis in words)}" if words else ""
    caption = f"Last tenth of the episodes against {numeric.title}{by}: interquartile means over seeds, 95 % intervals"
    return Drawing("values", caption, figure, broad=True)


def _oracle(panel: Axes, grid: Grid) -> None:
    least = {row["oracle_steps"] for row in grid.rows}
    if len(least) == 1 and None not in least:
        (value,) = least
        panel.axhline(value, color="#222222", linewidth=1.1, linestyle=(0, (8, 3)), label=f"oracle, {value:.1f}")


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend for all panels, each label once, in as many columns as fit."""
    found: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    if found:
        labels = sorted(found, key=lambda label: _FIRST.index(label) if label in _FIRST else len(_FIRST))
        fits = int(figure.get_figwidth() / (0.075 * max(map(len, labels)) + 0.5))
        rows = -(-len(labels) // max(fits, 1))
        columns = -(-len(labels) // rows)
        figure.legend([found[label] for label in labels], labels, loc="outside upper center", ncols=columns)


def heat_maps(grid: Grid, numeric: Sequence[Axis], words: Sequence[Axis]) -> Drawing:
    """Success and steps over two options, with their numbers; a row of maps for each combination of the others."""
    shown = metrics(grid)[:2]
    across, up = sorted(numeric, key=lambda axis: -len(axis.labels))
    rows = _combinations(words) if words else [("", np.ones(len(grid.rows), bool))]
    with matplotlib.rc_context(figures.STYLE | {"axes.grid": False}):
        size = (max(3.4, 0.75 * len(across.labels) + 1.9), 0.5 * len(up.labels) + 1.3)
        figure = figures.blank(size[0] * len(shown), size[1] * len(rows))
        panels = figure.subplots(len(rows), len(shown), squeeze=False)
        for place, metric in enumerate(shown):
            tables_of = []
            for _, mine in rows:
                values = np.full((len(up.labels), len(across.labels)), np.nan)
                for cell in np.flatnonzero(mine):
                    values[up.places[cell], across.places[cell]] = _estimate(grid.rows[cell], metric).value
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


def _pooled(grid: Grid, metric: str, mine: np.ndarray) -> Estimate:
    """The metric averaged over some cells: mean over seeds of each seed's mean over these cells, with its interval."""
    values = [grid.rows[cell]["by_seed"][metric] for cell in np.flatnonzero(mine)]
    if len({len(one) for one in values}) > 1:
        values = [[_known(grid.rows[cell][metric])] for cell in np.flatnonzero(mine)]
    return statistics.estimate(results.mean_of_known(np.array(values, float), axis=0), "mean")


def groups_of(axis: Axis) -> list[tuple[float, np.ndarray]]:
    """Cells with the same value of an option, or, where it was drawn, with neighbouring ones: place and [C] bool."""
    if not axis.drawn or axis.values is None:
        return [(place, axis.places == number) for number, place in enumerate(_places(axis))]
    values = np.array(axis.values)[axis.places]
    parts = np.array_split(np.argsort(values, kind="stable"), min(_GROUPS, len(values)))
    return [(float(np.median(values[part])), np.isin(np.arange(len(values)), part)) for part in parts]


def slices(grid: Grid) -> Drawing:
    """Success and steps against each option, averaged over the other ones; drawn cells are dots, in groups."""
    varied = [axis for axis in grid.axes if len(axis.labels) > 1]
    shown = metrics(grid)[:2]
    columns = min(4, len(varied))
    blocks = -(-len(varied) // columns)
    with matplotlib.rc_context(figures.STYLE):
        figure = figures.blank(2.4 * columns + 0.6, 2.3 * blocks * len(shown) + 0.2)
        panels = figure.subplots(blocks * len(shown), columns, squeeze=False, sharey=False)
        for panel in panels.flat:
            panel.set_visible(False)
        for number, axis in enumerate(varied):
            block, column = divmod(number, columns)
            for place, metric in enumerate(shown):
                panel = panels[block * len(shown) + place, column]
                panel.set_visible(True)
                if axis.drawn:
                    x = _places(axis)[axis.places]
                    y = [_known(row[metric.name]) for row in grid.rows]
                    panel.plot(x, y, ".", color="#888888", markersize=4, alpha=0.7)
                found = [(x, _pooled(grid, metric.name, mine)) for x, mine in groups_of(axis)]
                value, low, high = (np.array([getattr(one, part) for _, one in found]) for part in Estimate._fields)
                panel.errorbar(
                    *([x for x, _ in found], value, np.clip([value - low, high - value], 0, None)),
                    color=_LOOKS[0].colour,
                    marker="o",
                    linestyle="none" if axis.values is None else "-",
                    capsize=2.5,
                    elinewidth=1.0,
                )
                _finish(panel, metric)
                _value_axis(panel, axis)
                if column:
                    panel.set_ylabel("")
        for metric, place in zip(shown, range(len(shown)), strict=True):
            _same_scale([panels[block * len(shown) + place] for block in range(blocks)], metric)
    caption = (
        "Last tenth of the episodes against each option, averaged over the others: means over seeds, 95 % intervals"
    )
    if any(axis.drawn for axis in grid.axes):
        caption += f"; a dot is a cell, drawn values are averaged in {_GROUPS} groups"
    return Drawing("slices", caption, figure, broad=True)


def _same_scale(rows: Sequence[Sequence[Axes]], metric: Metric) -> None:
    if not metric.percent:
        top = max(panel.get_ylim()[1] for row in rows for panel in row if panel.get_visible())
        for row in rows:
            for panel in row:
                panel.set_ylim(0, top)


def explained(grid: Grid, metric: str) -> list[tuple[str, float, float]]:
    """How much of the variance between cells the main effect of each option explains.

    The variance of the means of its groups (functional ANOVA with group means) over that of all cells.

    Returns:
      For each option that varies: its title, its share, and the share to be expected if it had no effect at all.
    """
    y = np.array([_known(row[metric]) for row in grid.rows])
    known = ~np.isnan(y)
    total = np.sum((y[known] - y[known].mean()) ** 2) if known.any() else 0.0
    found = []
    for axis in grid.axes:
        groups = [mine & known for _, mine in groups_of(axis)]
        groups = [mine for mine in groups if mine.any()]
        if len(groups) < 2:
            continue
        between = sum(mine.sum() * (y[mine].mean() - y[known].mean()) ** 2 for mine in groups)
        share = float(between / total) if total > 0 else 0.0
        found.append((axis.title, share, (len(groups) - 1) / (known.sum() - 1)))
    return found


def importance(grid: Grid) -> Drawing:
    """The share of the differences between cells that each option explains by itself."""
    shown = metrics(grid)[:2]
    with matplotlib.rc_context(figures.STYLE | {"axes.grid.axis": "x"}):
        found = {metric.name: explained(grid, metric.name) for metric in shown}
        order = sorted(found["steps"], key=lambda one: one[1])
        titles = [title for title, _, _ in order]
        figure = figures.blank(8.6, 0.42 * len(titles) + 1.3)
        panels = figure.subplots(1, len(shown), sharey=True)
        for panel, metric in zip(panels, shown, strict=True):
            shares = {title: (share, chance) for title, share, chance in found[metric.name]}
            for place, title in enumerate(titles):
                share, chance = shares.get(title, (0.0, 0.0))
                panel.barh(place, share, height=0.62, color=_LOOKS[0].colour)
                marks = dict(color="#D55E00", linewidth=2, label="expected without any effect" if place == 0 else None)
                panel.plot([chance, chance], [place - 0.38, place + 0.38], **marks)
                panel.text(max(share, chance) + 0.015, place, f"{share:.0%}", va="center")
            panel.set_yticks(range(len(titles)), titles)
            panel.set_xlim(0, 1.12)
            panel.xaxis.set_major_formatter(PercentFormatter(1))
            panel.set_xticks([0, 0.25, 0.5, 0.75, 1])
            panel.set_xlabel(f"variance of {metric.title.partition(' (')[0]} explained")
        _legend(figure, panels)
    caption = "Share of the variance between cells that each option explains by itself"
    return Drawing("importance", caption, figure, broad=True)


def cells(grid: Grid) -> Drawing:
    """Cells with their intervals: all of a short list in its order, or the best by steps."""
    few = len(grid.rows) <= _MOST_LISTED and not grid.chosen.search and all(axis.values is None for axis in grid.axes)
    rows = grid.rows if few else tables.ranked(grid.rows)[:_MOST_BEST]
    best = tables.ranked(grid.rows)[0]
    equal = {one["cell"] for one in tables.within_noise(best, rows)}
    shown = metrics(grid)[:2]
    with matplotlib.rc_context(figures.STYLE | {"axes.grid.axis": "x"}):
        longest = max(len(one["name"]) for one in rows)
        figure = figures.blank(5.6 + 0.075 * min(longest, 90), 0.27 * len(rows) + 1.2)
        panels = figure.subplots(1, len(shown), sharey=True)
        for panel, metric in zip(panels, shown, strict=True):
            for place, row in enumerate(rows):
                found = _estimate(row, metric)
                colour = _LOOKS[0].colour if row is best else "#56B4E9" if row["cell"] in equal else "#888888"
                title = "best by steps" if row is best else "within noise of it" if row["cell"] in equal else "others"
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
            else:
                panel.set_xlim(left=0)
        _legend(figure, panels)
    which = "All" if len(rows) == len(grid.rows) else f"The best {len(rows)} of {len(grid.rows)}"
    return Drawing("cells", f"{which} cells: interquartile means over seeds, 95 % intervals", figure, broad=True)


def progress(grid: Grid) -> Drawing:
    """What a search found: the metric of each cell in the order in which they were tried, and the best so far."""
    search = grid.chosen.search
    assert search is not None
    y = np.array([_known(row[search.metric]) for row in grid.rows])
    best = np.fmax.accumulate(y) if OBJECTIVES[search.metric] else np.fmin.accumulate(y)
    with matplotlib.rc_context(figures.STYLE):
        figure = figures.blank()
        axes = figure.add_subplot()
        x = np.arange(1, len(y) + 1)
        axes.plot(x, y, "o", color="#888888", markersize=3.5, label="a cell")
        axes.step(x, best, where="post", color=_LOOKS[0].colour, label="best so far")
        titles = {metric.name: metric for metric in metrics(grid)}
        _finish(axes, titles.get(search.metric, Metric(search.metric, search.metric.replace("_", " "), False)))
        if search.metric == "steps":
            _oracle(axes, grid)
        axes.set_xlabel("cells tried")
        axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
        _legend(figure, [axes])
    return Drawing("search", "The search: each cell tried, and the best so far", figure)


def _curve_axes(grid: Grid) -> tuple[Axis | None, list[Axis]]:
    """Whose values are lines, and whose combinations are panels."""
    varied = [axis for axis in grid.axes if len(axis.labels) > 1]
    if not varied:
        return None, []
    fitting = [axis for axis in varied if len(axis.labels) <= _MOST_LINES] or varied
    numeric = [axis for axis in fitting if axis.values is not None]
    lines = (numeric or fitting)[-1]
    return lines, [axis for axis in varied if axis is not lines]


def curves_fit(grid: Grid) -> bool:
    """Whether learning curves of all cells can be told apart."""
    lines, panels = _curve_axes(grid)
    if lines is None:
        return True
    number = math.prod(len(axis.labels) for axis in panels)
    return len(lines.labels) <= _MOST_LINES and number <= _MOST_PANELS and not any(axis.drawn for axis in grid.axes)


def learning_curves(grid: Grid) -> Drawing:
    """Success and steps of every cell while it learns: a line a value of one option, a column for each other one."""
    lines, others = _curve_axes(grid)
    panels = _combinations(others) if others else [("", np.ones(len(grid.rows), bool))]
    with matplotlib.rc_context(figures.STYLE | {"lines.linewidth": 1.3, "lines.markersize": 4}):
        columns = min(3, len(panels))
        blocks = -(-len(panels) // columns)
        # One panel a metric goes side by side, several have a row each.
        shape = (1, 2) if len(panels) == 1 else (2 * blocks, columns)
        figure = figures.blank(
            7.4 if shape[0] == 1 else 3.1 * columns + 0.4, 2.2 * shape[0] + (1.0 if shape[0] == 1 else 0.5)
        )
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
                for cell in np.flatnonzero(mine):
                    at = int(lines.places[cell]) if lines is not None else 0
                    values = results.outcomes(grid.results[cell])[name]
                    figures.draw_curve(
                        panel, grid.results[cell], values, _line_title(grid, lines, at), _line_look(lines, at)
                    )
                _finish(panel, Metric(name, title, name == "reached"))
                panel.set_xlim(left=0)
                panel.xaxis.set_major_locator(MaxNLocator(4, integer=True))
                if place == 0 or shape[0] == 1:
                    panel.set_title(figures.title_of(label))
                if place == 1 or shape[0] == 1:
                    panel.set_xlabel("episode")
                if column:
                    panel.set_ylabel("")
        _same_scale([by_metric[1]], Metric("steps", "steps", False))
        _legend(figure, list(drawn.flat))
    length = figures.block_length(grid.results[0])
    caption = f"Learning curves of the cells: means over seeds and {length} episodes, 95 % intervals over seeds"
    return Drawing("curves", caption, figure, broad=True)


def _line_title(grid: Grid, lines: Axis | None, place: int) -> str:
    if lines is None:
        return grid.rows[0]["name"]
    label = lines.labels[place]
    return figures.title_of(label) if lines.values is None else f"{lines.title} {label}"


def _line_look(lines: Axis | None, place: int) -> Look:
    """Numbers run through a scale of colours, words have one each."""
    if lines is None or lines.values is None:
        return _look(lines.labels[place] if lines is not None else "icac", place)
    share = place / max(len(lines.labels) - 1, 1)
    colour = to_hex(matplotlib.colormaps["viridis"](0.9 * share))
    return Look(colour, "-", "osD^vPX*"[place % 8])
