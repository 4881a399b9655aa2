"""The episodes of a trained sweep, read from its folder a cell at a time: a large study does not fit into memory."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from icac_jax import reading
from icac_jax.errors import DamagedError
from icac_jax.reports.results import Result
from icac_jax.runs import store
from icac_jax.runs.records import SCHEMA
from icac_jax.sweeps import tables
from icac_jax.sweeps.study import Cell, Study

CELL = pa.field("cell", pa.int32())
"""The column of a sweep's episodes that a run's lack."""


def of_table(chosen: Study, rows: Sequence[dict[str, Any]], folder: Path) -> "Recorded":
    """The result of each cell of a sweep that was put together.

    Args:
      chosen: the study.
      rows: of the table of cells, from the summary.
      folder: of the sweep.

    Raises:
      ConfigError: the table is of other cells than the study's.
      DamagedError: see `Recorded`.
    """
    cells = [chosen.cell(row["cell"], row["varied"]) for row in rows]
    return Recorded(cells, [row["episodes_done"] for row in rows], folder)


class Recorded(Sequence[Result]):
    """The result of each cell, in the order of the sweep's table; each is read when it is asked for.

    Args:
      cells: of the table, in its order.
      episodes_done: of each cell, over its seeds, as the table says.
      folder: of the sweep.

    Raises:
      DamagedError: the episodes cannot be read or are not those of the table. So does the reading of a cell.
    """

    def __init__(self, cells: Sequence[Cell], episodes_done: Sequence[int], folder: Path) -> None:
        self._cells = cells
        self._ends = np.cumsum([0, *episodes_done])
        self._path = folder / store.EPISODES
        try:
            self._file = pq.ParquetFile(reading.regular(self._path), pre_buffer=False)  # see `store.read`
            kinds = self._file.schema_arrow
            if not kinds.field("cell").equals(CELL) or not all(kinds.field(one.name).equals(one) for one in SCHEMA):
                raise ValueError("other columns than expected")
            facts = self._file.metadata
            self._starts = np.cumsum([0, *(facts.row_group(number).num_rows for number in range(facts.num_row_groups))])
            if self._starts[-1] != self._ends[-1]:
                raise ValueError(self._differing())
        except Exception as error:  # altered bytes make the reader raise nearly anything
            raise self._damaged(error) from error
        self._kept: tuple[int, pa.Table] = -1, SCHEMA.empty_table()

    def _differing(self) -> str:
        """Which cell has other rows than the table says."""
        numbers = self._file.read(["cell"])["cell"].to_numpy()
        for cell, episodes in zip(self._cells, np.diff(self._ends), strict=True):
            if np.count_nonzero(numbers == cell.number) != episodes:
                return f"cell {cell.number} has other episodes than the summary says"
        return "it has cells that the summary has not"

    def _damaged(self, error: Exception) -> DamagedError:
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0] or type(error).__name__
        return DamagedError(f"{self._path}: not the readable record of this sweep ({reason})")

    def __len__(self) -> int:
        """How many cells there are."""
        return len(self._cells)

    @overload
    def __getitem__(self, place: int) -> Result: ...
    @overload
    def __getitem__(self, place: slice) -> list[Result]: ...
    def __getitem__(self, place: int | slice) -> Result | list[Result]:
        """The result of a cell, or those of some."""
        if isinstance(place, slice):
            return [self[number] for number in range(len(self))[place]]
        cell = self._cells[place]  # an IndexError where there is none, as a sequence must
        place %= len(self)
        try:
            return self._result(cell, self._rows(self._ends[place], self._ends[place + 1]))
        except Exception as error:
            raise self._damaged(error) from error

    def _rows(self, first: int, last: int) -> pa.Table:
        """Rows [first, last) of the file."""
        low = int(np.searchsorted(self._starts, first, "right")) - 1
        high = int(np.searchsorted(self._starts, last, "left"))
        parts = [self._row_group(number) for number in range(low, max(high, low))]
        parts = parts or [self._file.schema_arrow.empty_table()]
        return pa.concat_tables(parts).slice(first - self._starts[low], last - first)

    def _row_group(self, number: int) -> pa.Table:
        # Neighbouring cells share a row group.
        if self._kept[0] != number:
            self._kept = number, self._file.read_row_group(number)
        return self._kept[1]

    def _result(self, cell: Cell, table: pa.Table) -> Result:
        """A cell from its rows; a column that its learner does not report is left out."""
        run = cell.settings.run
        seed, episode, number = (table[name].to_numpy() for name in ("seed", "episode", "cell"))
        in_place = (seed >= 0) & (seed < run.seeds) & (episode >= 0) & (episode < run.episodes)
        if not np.all(number == cell.number) or not in_place.all():
            raise ValueError(f"cell {cell.number} has other episodes than the summary says")
        if any(table[field.name].null_count for field in SCHEMA):
            raise ValueError("missing numbers")
        missing = [name for name in table.column_names if table[name].null_count]
        done = np.bincount(seed, minlength=run.seeds)
        # Training is over: who has fewer episodes than all has diverged.
        facts = {"episodes_done": done.tolist(), "failed": (done < run.episodes).tolist()}
        return tables.result_of(cell, table.drop_columns(["cell", *missing]), facts)
