"""Where curiosity pays, of one study of discovery or of several in one figure.

`python -m icac_jax.sweeps.where [TITLE=]FOLDER ... --out FILE` reads finished sweeps, or their `discovery.json`. A
title stands behind the names of that study's tasks, such as its arm or physics.
"""

import argparse
import json
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.colors import TwoSlopeNorm
from matplotlib.patches import Rectangle

from icac_jax.errors import ConfigError
from icac_jax.reports.figures import STYLE, Drawing, blank
from icac_jax.runs import files
from icac_jax.sweeps.discovery import FILE
from icac_jax.sweeps.pays import Outcome

# The lead from which numbers are white on their colour, and the one whose colour is the fullest, in points.
_STRONG, _FULL = 25, 50


# What is read of each cell.
_NAMES = {"task", "kind", "signal", "found", "verdict"}


class Square(NamedTuple):
    """A signal on a task.

    Attributes:
      task: its name.
      kind: the signal's name without its numbers.
      signal: with them.
      found: share of seeds that found their goal.
      lead: over the control that found most.
      outcome: by the rule of `pays`.
    """

    task: str
    kind: str
    signal: str
    found: float
    lead: float
    outcome: Outcome


def squares(entries: Sequence[dict[str, Any]], title: str = "") -> list[Square]:
    """Of each signal that was judged on each task the cell that found most.

    Args:
      entries: a study's cells (`discovery.as_json`).
      title: stands behind the tasks' names.
    """
    found: dict[tuple[str, str], Square] = {}
    for entry in entries:
        verdict = entry["verdict"]
        if verdict is None:
            continue
        task = f"{entry['task']}, {title}" if title else entry["task"]
        square = Square(
            *(task, entry["kind"], entry["signal"], entry["found"]["value"], verdict["lead"], verdict["outcome"])
        )
        best = found.setdefault((task, square.kind), square)
        if square.found > best.found:
            found[task, square.kind] = square
    return list(found.values())


def it_pays(all_squares: Sequence[Square]) -> Drawing:
    """Tasks down, signals across: the lead over the control that found most, in points; a frame where a signal pays."""
    tasks = list(dict.fromkeys(square.task for square in all_squares))
    signals = list(dict.fromkeys(square.kind for square in all_squares))
    titles = {kind: _title([square.signal for square in all_squares if square.kind == kind]) for kind in signals}
    leads = np.full((len(tasks), len(signals)), np.nan)
    with matplotlib.rc_context(STYLE | {"axes.grid": False}):
        figure = blank(1.15 * len(signals) + 2.2, 0.62 * len(tasks) + 1.7)
        panel = figure.subplots()
        for square in all_squares:
            row, column = tasks.index(square.task), signals.index(square.kind)
            leads[row, column] = 100 * square.lead
            pays = square.outcome == "pays"
            panel.text(
                column,
                row,
                f"{100 * square.lead:+.0f}\n{square.found:.0%}",
                ha="center",
                va="center",
                fontsize=8,
                weight="bold" if pays else "normal",
                color="white" if abs(100 * square.lead) > _STRONG else "black",
            )
            if pays:
                corner = column - 0.46, row - 0.44
                panel.add_patch(Rectangle(corner, 0.92, 0.88, fill=False, edgecolor="black", linewidth=1.8))
        image = panel.imshow(leads, cmap="RdBu", norm=TwoSlopeNorm(0, -_FULL, _FULL), aspect="auto")
        panel.set_yticks(range(len(tasks)), [textwrap.fill(task, 24) for task in tasks])
        panel.set_xticks(range(len(signals)), [textwrap.fill(titles[kind], 14) for kind in signals])
        panel.xaxis.tick_top()
        panel.tick_params(length=0)
        panel.spines[:].set_visible(False)
        bar = figure.colorbar(image, ax=panel, shrink=0.9)
        bar.set_label("lead over the best control (points)")
    caption = (
        "Where curiosity pays: lead in points of the share of seeds that found their goal over the control that found "
        "most (no bonus, constant, shuffled, step costs, visit counts), below it that share; framed where it pays by "
        "the rule"
    )
    return Drawing("where_curiosity_pays", caption, figure, broad=True)


def _title(names: Sequence[str]) -> str:
    """A signal's name in all studies: with its numbers where they are everywhere the same."""
    different = dict.fromkeys(names)
    return names[0] if len(different) == 1 else min(different, key=len).partition(" ×")[0].partition(" e_max")[0]


def _entries(path: Path) -> list[dict[str, Any]]:
    """The cells of a study from its folder or from its file.

    Raises:
      ConfigError: it has none.
    """
    file = path / FILE if path.is_dir() else path
    try:
        found = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: holds no study of discovery ({FILE}) that is finished") from error
    if not isinstance(found, list) or not all(isinstance(one, dict) and one.keys() >= _NAMES for one in found):
        raise ConfigError(f"{path}: holds no study of discovery ({FILE})")
    return found


def main(arguments: list[str] | None = None) -> int:
    """Draws several studies as one figure."""
    parser = argparse.ArgumentParser(prog="python -m icac_jax.sweeps.where", description="Where curiosity pays.")
    parser.add_argument("studies", nargs="+", metavar="[TITLE=]FOLDER", help="finished sweeps, or their discovery.json")
    parser.add_argument("--out", type=Path, required=True, help="the figure: PNG, SVG or PDF")
    given = parser.parse_args(arguments)
    found: list[Square] = []
    try:
        for study in given.studies:
            title, _, path = study.rpartition("=")
            found += squares(_entries(Path(path)), title)
        if not found:
            raise ConfigError("studies: no signal was judged in them")
        with files.replacing(given.out) as file:
            it_pays(found).figure.savefig(file, format=given.out.suffix.lstrip(".") or "png", dpi=160)
    except (ConfigError, OSError) as error:
        print(f"where: {error}", file=sys.stderr)
        return 2
    print(given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
