"""What the groups of a sweep recorded, cell by cell: written into the sweep's folder.

Cells are taken one after the other, whatever group trained them: the episodes of a large study do not fit into memory.
"""

import heapq
import itertools
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from icac_jax.runs import files, store
from icac_jax.runs import folder as run_folder
from icac_jax.runs.jobs import read_done
from icac_jax.runs.records import SCHEMA, encoding
from icac_jax.runs.store import Store
from icac_jax.sweeps import groups, tables, verdicts
from icac_jax.sweeps.engine import Batch
from icac_jax.sweeps.groups import Group
from icac_jax.sweeps.halving import Halving
from icac_jax.sweeps.recorded import CELL
from icac_jax.sweeps.study import Cell, Study

# Working files of the groups, removed when the sweep has finished.
GROUPS = "groups"

# Rows that the groups hold in memory together, and those of a row group of the file that they are written to.
_ROWS_AT_ONCE = 2**18
_ROWS_WRITTEN = 2**17


class _Trained(NamedTuple):
    """A cell that has been trained: its episodes, and `episodes_done`, `failed`, `steps` of each seed."""

    cell: Cell
    table: pa.Table
    jobs: dict[str, Any]


def rows_of(batch: Batch) -> list[dict[str, Any]]:
    """The rows of figures of the cells of a batch whose groups have finished.

    Raises:
      DamagedError: a file of a group cannot be read.
    """
    return [_row(one) for one in _of_batch(batch, 1)]


def _row(one: _Trained) -> dict[str, Any]:
    return tables.row(one.cell, tables.result_of(one.cell, one.table, one.jobs), one.jobs)


def _of_batch(batch: Batch, together: int) -> Iterator[_Trained]:
    """The cells of a batch whose groups have finished, in the order of their numbers.

    Args:
      batch: which one.
      together: batches that are read at the same time.
    """
    most = max(_ROWS_AT_ONCE // max(len(batch.groups) * together, 1), 1)
    parts = [_of_group(batch.place(group), group, most) for group in batch.groups]
    yield from heapq.merge(*parts, key=_number_of)


def _number_of(one: _Trained) -> int:
    return one.cell.number


def _by_cell(batches: Sequence[Batch], halved: bool) -> Iterator[list[_Trained]]:
    """All that was trained of each cell, in the order of their numbers: in halving once for each of its rungs."""
    if not halved:
        yield from ([one] for batch in batches for one in _of_batch(batch, 1))
        return
    every = heapq.merge(*(_of_batch(batch, len(batches)) for batch in batches), key=_number_of)
    yield from (list(mine) for _, mine in itertools.groupby(every, key=_number_of))


def _row_of(rungs: list[_Trained], halving: Halving | None) -> dict[str, Any]:
    """The row of a cell: of its last rung, with the study's metric at each one."""
    rows = [_row(one) for one in rungs]
    if halving is None:
        return rows[-1]
    return rows[-1] | {"rung": len(rows) - 1, "at_rungs": [row[f"{halving.metric}_iqm"] for row in rows]}


def _of_group(folder: Path, group: Group, most: int) -> Iterator[_Trained]:
    """The cells of a group, with the rows of so many of them in memory as are no more than `most`."""
    facts = read_done(folder)
    done = np.array(facts["episodes_done"])
    starts = np.cumsum([0, *(cell.settings.run.seeds for cell in group.cells)])
    by_cell = np.add.reduceat(done, starts[:-1])
    ends = store.ends_of(by_cell, most)
    first = 0
    for last, table in zip(ends, Store(folder).tables(done, starts[ends].tolist()), strict=True):
        row = 0
        for place in range(first, last):
            cell, mine = group.cells[place], table.slice(row, by_cell[place])
            row += int(by_cell[place])
            jobs = slice(starts[place], starts[place + 1])
            seeds = pa.array(mine["seed"].to_numpy() - np.int32(jobs.start), pa.int32())
            mine = mine.set_column(mine.schema.get_field_index("seed"), "seed", seeds)
            yield _Trained(cell, mine, {name: facts[name][jobs] for name in ("episodes_done", "failed", "steps")})
        first = last


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
    rows: list[dict[str, Any]] = []

    def tables_of() -> Iterator[pa.Table]:
        for rungs in _by_cell(batches, chosen.halving is not None):
            rows.append(_row_of(rungs, chosen.halving))
            one = rungs[-1]
            yield one.table.add_column(0, CELL, pa.array(np.full(one.table.num_rows, one.cell.number, np.int32)))

    places = [batch.place(group) for batch in batches for group in batch.groups]
    # A column that only some learners report is null in the rows of the others.
    schema = pa.unify_schemas([pa.schema([CELL, *SCHEMA]), *(Store(place).schema() for place in places)])
    _write(folder / store.EPISODES, schema, tables_of())
    programs = [read_done(place) for place in places]
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
        "lane_steps": sum(sum(facts["steps"]) for facts in programs),
        "failed_lanes": failed,
        "lanes_trained": sum(cell.settings.run.seeds for cell in {cell.number: cell for cell in cells}.values()),
        "verdict": verdicts.as_json(verdict) if verdict else None,
    }
    files.write_text(folder / run_folder.SUMMARY, _as_json(result))
    return result


def _as_json(result: dict[str, Any]) -> str:
    """The summary with a line per cell: with a line per number, thousands of cells take a minute."""
    facts = [f"  {json.dumps(name)}: {json.dumps(value)}" for name, value in result.items() if name != "cells"]
    lines = ",\n".join(f"    {json.dumps(row)}" for row in result["cells"])
    return "{\n" + ",\n".join([*facts, f'  "cells": [\n{lines}\n  ]']) + "\n}\n"


def _write(path: Path, schema: pa.Schema, tables_: Iterable[pa.Table]) -> None:
    """Writes tables under each other, in row groups that are large enough to be read fast."""
    with files.replacing(path) as file, pq.ParquetWriter(file, schema, **encoding(schema)) as writer:
        waiting: list[pa.Table] = [schema.empty_table()]

        def flush() -> None:
            writer.write_table(pa.concat_tables(waiting, promote_options="default"))
            del waiting[1:]

        for table in tables_:
            if sum(one.num_rows for one in waiting) + table.num_rows > _ROWS_WRITTEN and len(waiting) > 1:
                flush()
            waiting.append(table)
        flush()
