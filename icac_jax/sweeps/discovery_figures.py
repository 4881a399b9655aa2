"""Figures of a study of discovery: who has found the goal by which episode, what was visited, where curiosity pays."""

from collections.abc import Callable, Sequence

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from icac_jax.curiosity.signals import SIGNALS
from icac_jax.reports import statistics
from icac_jax.reports.figures import STYLE, Drawing, blank, percent_axis
from icac_jax.sweeps import discovery, dose_figure, where
from icac_jax.sweeps.discovery import COUNTS, NO_BONUS, NUMBERS, STEP_COST, Cell
from icac_jax.sweeps.panels import legend

# Places at which a curve is drawn; more cannot be told apart.
_POINTS = 120
# One colour per kind of signal, in every panel; controls are grey or black, or broken lines.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#882255", "#117733")
_GREYS = {
    NO_BONUS: ("#000000", (0, (1, 1.2))),
    STEP_COST: ("#777777", (0, (5, 2))),
    "constant": ("#aaaaaa", "-"),
    "shuffled": ("#000000", (0, (5, 1.5))),
    COUNTS: ("#999933", (0, (4, 1.5, 1, 1.5))),
}


def all_of(cells: Sequence[Cell], episodes: int) -> list[Drawing]:
    """Every figure of a study of discovery; the first one says most."""
    drawings = [found_by_episode(cells, episodes)]
    if any(cell.judged for cell in cells):
        drawings.insert(0, where.it_pays(where.squares(discovery.as_json(cells))))
    if all(cell.visited is not None for cell in cells):
        drawings.append(visited_by_episode(cells, episodes))
    return drawings + [drawing for name in NUMBERS if (drawing := dose_figure.by_number(cells, name))]


def best_of_kind(cells: Sequence[Cell], task: str) -> dict[str, Cell]:
    """Of each kind of signal the cell of a task with which most seeds found their goal, by kind."""
    found: dict[str, Cell] = {}
    for cell in cells:
        if cell.task == task and (cell.kind not in found or cell.found.value > found[cell.kind].found.value):
            found[cell.kind] = cell
    return found


def _in_words(cells: Sequence[Cell]) -> str:
    """A kind of signal in a legend of several tasks: with its numbers where they are the same in all of them."""
    if len({cell.signal for cell in cells}) == 1:
        return cells[0].signal
    kind = cells[0].kind
    return SIGNALS[kind].title if kind in SIGNALS else kind


def found_by_episode(cells: Sequence[Cell], episodes: int) -> Drawing:
    """The share of seeds that have found their goal by an episode: a panel per task, a line per kind of signal."""
    caption = (
        "Share of seeds that have found their goal by an episode, with 95 % intervals; of each signal its best numbers"
    )

    def found(cell: Cell) -> np.ndarray:
        return cell.by_episode(episodes).astype(float)

    figure = _by_episode(cells, episodes, found, "seeds that have found the goal")
    return Drawing("found", caption, figure, broad=True)


def visited_by_episode(cells: Sequence[Cell], episodes: int) -> Drawing:
    """The share of joint space that has been visited by an episode, as in `found_by_episode`."""
    caption = (
        "Share of the reachable joint space that a seed has visited by an episode, with 95 % intervals; of each signal "
        "the numbers that found most goals"
    )

    def visited(cell: Cell) -> np.ndarray:
        assert cell.visited is not None
        return cell.visited

    return Drawing("visited", caption, _by_episode(cells, episodes, visited, "joint space visited"), broad=True)


def _by_episode(cells: Sequence[Cell], episodes: int, values: Callable[[Cell], np.ndarray], title: str) -> Figure:
    """A panel per task, a line per kind of signal, of values [S, E] that are shares."""
    tasks = list(dict.fromkeys(cell.task for cell in cells))
    kinds = list(dict.fromkeys(cell.kind for cell in cells))
    learnt = [kind for kind in kinds if kind not in _GREYS]
    looks = {kind: (_COLOURS[place % len(_COLOURS)], "-") for place, kind in enumerate(learnt)} | _GREYS
    places = np.unique(np.linspace(1, episodes, _POINTS).astype(int))
    best = {task: best_of_kind(cells, task) for task in tasks}
    words = {kind: _in_words([mine[kind] for mine in best.values() if kind in mine]) for kind in kinds}
    with matplotlib.rc_context(STYLE | {"lines.linewidth": 1.4}):
        columns = min(3, len(tasks))
        rows = -(-len(tasks) // columns)
        alone = len(tasks) == 1  # then a legend above would leave no room for it
        figure = blank(8.6, 3.6) if alone else blank(3.1 * columns + 0.6, 2.5 * rows + 0.9)
        panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for number, panel in enumerate(panels.flat):
            if number >= len(tasks):
                panel.set_visible(False)
                continue
            for kind, cell in best[tasks[number]].items():
                band = statistics.band(values(cell)[:, places - 1])
                colour, line = looks[kind]
                panel.plot(places, band.value, color=colour, linestyle=line, label=words[kind])
                panel.fill_between(places, band.low, band.high, color=colour, alpha=0.12, linewidth=0)
            panel.set_title(tasks[number])
            panel.set_xlim(0, episodes)
            panel.xaxis.set_major_locator(MaxNLocator(4, integer=True))
            panel.set_xlabel("episode")
            percent_axis(panel, 1.0)
        panels[0, 0].set_ylabel(title)
        legend(figure, list(panels.flat), beside=alone)
    return figure
