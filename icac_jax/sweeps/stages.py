"""How far a sweep is: trained, then reported, then finished. Each stage is told by a file that is written last.

`summary.json` says that everything is trained and put together, `report.html` that the report is whole, and only then
`status.json` says "finished". Whenever a sweep is killed, what is missing is made from what the stage before has left.
"""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from icac_jax import shapes
from icac_jax.errors import ConfigError, DamagedError
from icac_jax.reports.figures import FOLDER as FIGURES
from icac_jax.runs import folder as run_folder
from icac_jax.runs import session
from icac_jax.sweeps import collect, tables, verdicts
from icac_jax.sweeps.recorded import Recorded
from icac_jax.sweeps.study import OBJECTIVES, Cell, Study

_ENDS = ("finished", "failed")
_FIGURE = shapes.optional(shapes.number)
_CELL = shapes.record(
    {"name": shapes.text, "varied": shapes.mapping(shapes.anything)}
    | dict.fromkeys(("cell", "failed_lanes", "lane_steps", "episodes_done"), shapes.whole)
    | dict.fromkeys(("steps_over_oracle", "oracle_steps", "live_nodes"), _FIGURE)
    | {"overflow": shapes.optional(shapes.whole)}
    | {f"{name}{part}": _FIGURE for name in tables.ESTIMATED for part in ("", "_iqm", "_low", "_high")}
    | {"by_seed": shapes.record(dict.fromkeys(OBJECTIVES, shapes.several(_FIGURE)))},
    later={"rung": shapes.whole, "at_rungs": shapes.several(_FIGURE, least=1)},
)
_SHAPE = shapes.record(
    {"claim": shapes.text, "cells": shapes.several(_CELL, least=1), "verdict": shapes.optional(verdicts.SHAPE)}
    | dict.fromkeys(("seconds", "seconds_training"), shapes.amount)
    | dict.fromkeys(("lanes", "programs", "lane_steps", "failed_lanes", "lanes_trained"), shapes.whole),
    later={"metric": shapes.one_of(OBJECTIVES)},
)


def trained(folder: Path) -> dict[str, Any] | None:
    """The summary of a sweep that has been trained, None where it has not.

    Raises:
      DamagedError: there is a summary and it cannot be read, or is none.
    """
    return shapes.read(folder / run_folder.SUMMARY, _SHAPE, "summary of a sweep")


def is_reported(folder: Path) -> bool:
    """Whether the report is there; its page is written last."""
    from icac_jax.sweeps import report

    return all((folder / name).exists() for name in (report.PAGE, report.TABLES, FIGURES, tables.CELLS))


def complete(chosen: Study, result: dict[str, Any], folder: Path, tell: Callable[[str], None]) -> None:
    """Makes what is missing of a sweep that has been trained: its report, then its end.

    Args:
      chosen: the study.
      result: its summary, as `trained` gives it.
      folder: of the sweep, locked by this process.
      tell: told if nothing was missing.

    Raises:
      DamagedError: the report is missing and the records cannot be read.
      OSError: the folder cannot be written.
    """
    ended = run_folder.read_json(folder / run_folder.STATUS).get("state") in _ENDS
    if ended and is_reported(folder):
        tell("the sweep has finished already")
    else:
        cells = _cells(chosen, result["cells"], folder)
        _report(chosen, cells, result, folder)
        if not ended:
            _end(cells, result, folder)
    shutil.rmtree(folder / collect.GROUPS, ignore_errors=True)


def _cells(chosen: Study, rows: list[dict[str, Any]], folder: Path) -> list[Cell]:
    """The cells of the table."""
    try:
        return [chosen.cell(row["cell"], row["varied"]) for row in rows]
    except (ConfigError, KeyError, ValueError) as error:
        raise _of_another(folder, error) from error


def _of_another(folder: Path, error: Exception) -> DamagedError:
    return DamagedError(f"{folder / run_folder.SUMMARY}: not of the sweep in {run_folder.SWEEP} ({error})")


def _report(chosen: Study, cells: list[Cell], result: dict[str, Any], folder: Path) -> None:
    # Imported here: training needs no Matplotlib.
    from icac_jax.sweeps import report
    from icac_jax.sweeps.grid import Grid

    rows = result["cells"]
    found = Recorded(cells, [row["episodes_done"] for row in rows], folder)
    try:
        varying = chosen.varying([row["varied"] for row in rows])
    except (KeyError, ValueError) as error:
        raise _of_another(folder, error) from error
    verdict = verdicts.from_json(result["verdict"]) if result["verdict"] else None
    report.write(Grid(chosen, rows, found, [cell.settings for cell in cells], varying), result, verdict, folder)


def _end(cells: list[Cell], result: dict[str, Any], folder: Path) -> None:
    failed, runs = result["failed_lanes"], [cell.settings.run for cell in cells]
    done, total = sum(row["episodes_done"] for row in result["cells"]), sum(run.seeds * run.episodes for run in runs)
    state = "failed" if failed and failed == result["lanes_trained"] else "finished"
    run_folder.record(folder, "finished", cells=len(cells), failed_lanes=failed)
    session.write_status(folder, state, done, total, f"{len(cells)} cells")
