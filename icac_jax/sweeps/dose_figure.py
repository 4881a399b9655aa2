"""How many seeds find their goal with more of a signal: by its weight, or by how fine the map is that it pays on."""

from collections.abc import Iterable, Sequence

import matplotlib
from matplotlib.axes import Axes

from icac_jax.curiosity.signals import SIGNALS
from icac_jax.reports.figures import STYLE, Drawing, blank, percent_axis
from icac_jax.sweeps import axes
from icac_jax.sweeps.discovery import NO_BONUS, NUMBERS, STEP_COST, Cell
from icac_jax.sweeps.panels import draw_estimates, legend, look_of

# Fewer points are no curve.
_LEAST = 3
# Factors on a logarithmic axis: between the points of two signals with one dose, between two doses that are written.
_BESIDE, _WRITTEN = 1.03, 1.5
_TITLES = {"curiosity": "weight of the signal", "e_max": "resolution of the map, e_max"}


def by_number(cells: Sequence[Cell], name: str) -> Drawing | None:
    """A panel per task, a line per signal that has three values of a number or more; None where there is none.

    Controls without a dose are lines across: no bonus, and the step cost with which most seeds found their goal.

    Args:
      cells: of a study of discovery.
      name: the number, one of `discovery.NUMBERS`.
    """
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    lines = {task: _lines(cells, task, name) for task in tasks}
    tasks = [task for task in tasks if lines[task]]
    if not tasks:
        return None
    titles = list(dict.fromkeys(title for task in tasks for title in lines[task]))
    with matplotlib.rc_context(STYLE | {"lines.linewidth": 1.4}):
        figure = blank(3.1 * len(tasks) + 0.6, 3.4)
        panels = figure.subplots(1, len(tasks), squeeze=False, sharey=True)[0]
        for panel, task in zip(panels, tasks, strict=True):
            for title, mine in lines[task].items():
                place = titles.index(title)
                # Side by side where doses are the same.
                beside = _BESIDE ** (place - (len(titles) - 1) / 2)
                x = [cell.numbers[name] * beside for cell in mine]
                draw_estimates(panel, x, [cell.found for cell in mine], look_of(title, place), title)
            _across(panel, cells, task)
            panel.set_title(task)
            panel.set_xscale("log")
            doses = _apart({cell.numbers[name] for mine in lines[task].values() for cell in mine})
            panel.set_xticks(doses, [axes.short(dose) for dose in doses])
            panel.minorticks_off()
            panel.set_xlabel(_TITLES[name])
            percent_axis(panel, 1.0)
        panels[0].set_ylabel("seeds that have found the goal")
        legend(figure, list(panels))
    caption = f"Share of seeds that found their goal, by the {_TITLES[name]}, with 95 % intervals"
    return Drawing(f"dose-{name.replace('_', '-')}", caption, figure, broad=True)


def _lines(cells: Sequence[Cell], task: str, name: str) -> dict[str, list[Cell]]:
    """The cells of a task in which a number varies and nothing else does, by their title, in order of the number."""
    (other,) = (one for one in NUMBERS if one != name)
    found: dict[tuple[str, float | None], list[Cell]] = {}
    for cell in cells:
        if cell.task == task and cell.kind in SIGNALS and name in cell.numbers:
            found.setdefault((cell.kind, cell.numbers.get(other)), []).append(cell)
    found = {key: sorted(mine, key=lambda cell: cell.numbers[name]) for key, mine in found.items()}
    found = {key: mine for key, mine in found.items() if len({cell.numbers[name] for cell in mine}) >= _LEAST}
    kinds = [kind for kind, _ in found]
    return {
        SIGNALS[kind].title + (f", {other} {axes.short(value)}" if kinds.count(kind) > 1 else ""): mine
        for (kind, value), mine in found.items()
    }


def _across(panel: Axes, cells: Sequence[Cell], task: str) -> None:
    """The controls that have no dose."""
    for kind, line in ((NO_BONUS, ":"), (STEP_COST, "--")):
        mine = [cell for cell in cells if cell.task == task and cell.kind == kind]
        if mine:
            best = max(cell.found.value for cell in mine)
            panel.axhline(best, color="#555555", linestyle=line, linewidth=1.1, label=kind)


def _apart(doses: Iterable[float]) -> list[float]:
    """Those of some doses whose numbers can be written beside each other on a logarithmic axis."""
    found: list[float] = []
    for dose in sorted(doses):
        if not found or dose >= _WRITTEN * found[-1]:
            found.append(dose)
    return found
