"""What the groups of a sweep recorded, cell by cell: episodes, figures, the summary of the sweep."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from icac_jax.reports.results import Result
from icac_jax.runs import files, session, store
from icac_jax.runs import folder as run_folder
from icac_jax.runs.jobs import read_done
from icac_jax.runs.records import SCHEMA
from icac_jax.runs.store import Store
from icac_jax.sweeps import groups, tables, verdicts
from icac_jax.sweeps.engine import Batch
from icac_jax.sweeps.study import Study

# Working files of the groups, removed when the sweep has finished.
GROUPS = "groups"

# The columns of a sweep's `episodes.parquet`.
_CELL = pa.field("cell", pa.int32())


def read_cells(batch: Batch) -> tuple[dict[int, Result], list[dict[str, Any]]]:
    """The result of each cell, by its number, and its row of figures, from the finished groups of a batch.

    Raises:
      DamagedError: a file of a group cannot be read.
    """
    found: dict[int, Result] = {}
    rows = []
    for group in batch.groups:
        folder = batch.place(group)
        facts = read_done(folder)
        table = Store(folder).table(np.array(facts["episodes_done"]))
        job = table["seed"].to_numpy()
        first = 0
        for cell in group.cells:
            number = cell.settings.run.seeds
            mine = table.filter(pa.array((job >= first) & (job < first + number)))
            seeds = pa.array(mine["seed"].to_numpy() - first, pa.int32())
            mine = mine.set_column(mine.schema.get_field_index("seed"), "seed", seeds)
            part = slice(first, first + number)
            jobs = {name: facts[name][part] for name in ("episodes_done", "failed", "steps")}
            found[cell.number] = tables.result_of(cell, mine, jobs)
            rows.append(tables.row(cell, found[cell.number], jobs))
            first += number
    rows.sort(key=lambda row: row["cell"])
    return found, rows


def finish(chosen: Study, batches: list[Batch], folder: Path, seconds: float) -> dict[str, Any]:
    """Puts the groups' records together, writes the table of cells, removes the working files.

    Args:
      chosen: the study.
      batches: all of its cells, trained.
      folder: of the sweep.
      seconds: spent in this call.

    Returns:
      The summary, as written to the folder.
    """
    cells = [cell for batch in batches for cell in batch.cells]
    found: dict[int, Result] = {}
    rows: list[dict[str, Any]] = []
    programs = []
    for batch in batches:
        some, their = read_cells(batch)
        found |= some
        rows += their
        programs += [read_done(batch.place(group)) for group in batch.groups]
    rows.sort(key=lambda row: row["cell"])
    # A column that only some learners report is null in the rows of the others.
    schema = pa.unify_schemas([pa.schema([_CELL, *SCHEMA]), *(found[number].table.schema for number in sorted(found))])
    with (
        files.replacing(folder / store.EPISODES) as file,
        pq.ParquetWriter(file, schema, compression="zstd") as writer,
    ):
        for number in sorted(found):
            table = found[number].table
            table = table.add_column(0, _CELL, pa.array(np.full(table.num_rows, number, np.int32)))
            writer.write_table(pa.concat_tables([schema.empty_table(), table], promote_options="default"))
    files.write_text(folder / tables.CELLS, tables.as_csv(rows))
    failed = sum(row["failed_lanes"] for row in rows)
    verdict = verdicts.judge(rows, chosen.expect, chosen.reference) if chosen.expect else None
    result = {
        "claim": chosen.claim,
        "cells": rows,
        "seconds": seconds,
        "seconds_training": sum(facts["seconds"] for facts in programs),
        "lanes": max(facts["lanes"] for facts in programs),
        "programs": len(groups.grouped(cells)),
        "lane_steps": sum(row["lane_steps"] for row in rows),
        "failed_lanes": failed,
        "lanes_trained": sum(cell.settings.run.seeds for cell in cells),
        "verdict": verdicts.as_json(verdict) if verdict else None,
    }
    files.write_text(folder / run_folder.SUMMARY, json.dumps(result, indent=2) + "\n")
    done = sum(row["episodes_done"] for row in rows)
    total = sum(cell.settings.run.seeds * cell.settings.run.episodes for cell in cells)
    state = "failed" if failed and failed == result["lanes_trained"] else "finished"
    session.write_status(folder, state, done, total, f"{len(rows)} cells")
    run_folder.record(folder, "finished", cells=len(rows), failed_lanes=failed)
    shutil.rmtree(folder / GROUPS, ignore_errors=True)
    _report(chosen, rows, [found[number] for number in sorted(found)], result, verdict, folder)
    return result


def _report(
    chosen: Study,
    rows: list[dict[str, Any]],
    found: list[Result],
    result: dict[str, Any],
    verdict: verdicts.Verdict | None,
    folder: Path,
) -> None:
    """Draws and writes the report; last, so that whatever becomes of it the sweep has finished."""
    # Imported here: training needs no Matplotlib.
    from icac_jax.sweeps import report
    from icac_jax.sweeps.grid import Grid

    varying = chosen.varying([row["varied"] for row in rows])
    report.write(Grid(chosen, rows, found, varying), result, verdict, folder)
