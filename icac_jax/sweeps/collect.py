"""What the groups of a sweep recorded, cell by cell: written into the sweep's folder, and read back from there."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from icac_jax import reading
from icac_jax.errors import DamagedError
from icac_jax.reports.results import Result
from icac_jax.runs import files, store
from icac_jax.runs import folder as run_folder
from icac_jax.runs.jobs import read_done
from icac_jax.runs.records import SCHEMA
from icac_jax.runs.store import Store
from icac_jax.sweeps import groups, tables, verdicts
from icac_jax.sweeps.engine import Batch
from icac_jax.sweeps.study import Cell, Study

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


def gather(chosen: Study, batches: list[Batch], folder: Path, seconds: float) -> dict[str, Any]:
    """Puts the groups' records together: episodes, table of cells; last the summary, which says that all is trained.

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
        "metric": chosen.metric,
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
    return result


def recorded(chosen: Study, rows: list[dict[str, Any]], folder: Path) -> list[Result]:
    """The result of each cell of a sweep that was put together, in the order of its table.

    Args:
      chosen: the study.
      rows: of the table of cells, from the summary.
      folder: of the sweep.

    Raises:
      ConfigError: the table is of other cells than the study's.
      DamagedError: the episodes cannot be read or are not those of the table.
    """
    cells = [chosen.cell(row["cell"], row["varied"]) for row in rows]
    path = folder / store.EPISODES
    try:
        with reading.regular(path) as file:
            table = pq.read_table(file, pre_buffer=False)  # see `store.read`
        places = table["cell"].to_numpy()
        if not pa.types.is_int32(table.schema.field("cell").type) or np.any(np.diff(places) < 0):
            raise ValueError("its rows are not sorted by cell")
        if not all(
            table.schema.field(field.name).equals(field) and not table[field.name].null_count for field in SCHEMA
        ):
            raise ValueError("other columns than expected")
        found = []
        for cell, row in zip(cells, rows, strict=True):
            first, last = np.searchsorted(places, cell.number, "left"), np.searchsorted(places, cell.number, "right")
            mine = table.slice(first, last - first).drop_columns("cell")
            found.append(_result(cell, mine, row["episodes_done"]))
        return found
    except Exception as error:  # altered bytes make the reader raise nearly anything
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0] or type(error).__name__
        raise DamagedError(f"{path}: not the readable record of this sweep ({reason})") from error


def _result(cell: Cell, table: pa.Table, episodes_done: int) -> Result:
    """A cell from its rows of the sweep's record; a column that its learner does not report is left out."""
    run = cell.settings.run
    seed, episode = (table[name].to_numpy() for name in ("seed", "episode"))
    in_place = (seed >= 0) & (seed < run.seeds) & (episode >= 0) & (episode < run.episodes)
    if table.num_rows != episodes_done or not in_place.all():
        raise ValueError(f"cell {cell.number} has other episodes than the summary says")
    table = table.drop_columns([name for name in table.column_names if table[name].null_count])
    done = np.bincount(seed, minlength=run.seeds)
    # Training is over: who has fewer episodes than all has diverged.
    return tables.result_of(cell, table, {"episodes_done": done.tolist(), "failed": (done < run.episodes).tolist()})
