"""The record of a run on disk: parts while it runs, one `episodes.parquet` when it stops.

A row counts if its episode is below the number of episodes that its seed had finished at the checkpoint resumed from;
that rule alone makes resuming exact, whatever was written after the checkpoint.
"""

import contextlib
import hashlib
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from icac_jax import reading
from icac_jax.errors import DamagedError
from icac_jax.runs import files
from icac_jax.runs.folder import RECORDS as PARTS
from icac_jax.runs.records import SCHEMA, encoding, joined, ordered

EPISODES = "episodes.parquet"
_COLUMNS = b"columns"
_PART = re.compile(r"part-(\d{8,12})\.parquet")
# Rows that are in memory at once where the seeds of a large study are read one after the other.
_ROWS_AT_ONCE = 2**18


def _columns(schema: pa.Schema) -> bytes:
    """What the columns are called and hold, to be kept with them: Parquet has checksums of pages, none of names."""
    return hashlib.sha256("\n".join(f"{field.name} {field.type}" for field in schema).encode()).hexdigest().encode()


def _write(path: Path, tables: Iterable[pa.Table]) -> None:
    """Writes tables of the same columns under each other, one in memory at a time."""
    tables = iter(tables)
    first = next(tables)
    schema = first.schema.with_metadata({_COLUMNS: _columns(first.schema)})
    with (
        files.replacing(path) as file,
        pq.ParquetWriter(file, schema, write_page_checksum=True, **encoding(schema)) as writer,
    ):
        for table in itertools.chain([first], tables):
            writer.write_table(table.cast(schema))


def read(path: Path, seeds: tuple[int, int] | None = None) -> pa.Table:
    """The rows of one file of records (see `records`).

    Args:
      path: of the file.
      seeds: the first seed and the one after the last that are asked for; rows of others may come with them. By default
        all.

    Raises:
      DamagedError: it cannot be read, or holds other columns.
    """
    try:
        with reading.regular(path) as file:  # a path in words would be taken for a URI, and must be UTF-8
            # Read ahead in threads, a process that ends right afterwards was aborted now and then (pyarrow 26).
            content = pq.ParquetFile(file, page_checksum_verification=True, pre_buffer=False)
            table = content.read() if seeds is None else content.read_row_groups(_holding(content, *seeds))
        own = [field for field in table.schema if field.name in SCHEMA.names]
        others = [field for field in table.schema if field.name not in SCHEMA.names]
        if not pa.schema(own).equals(SCHEMA) or any(column.null_count for column in table.columns):
            raise ValueError("other columns than expected")
        if not all(pa.types.is_primitive(field.type) and not pa.types.is_temporal(field.type) for field in others):
            raise ValueError("columns that are no numbers")
        # Earlier versions wrote no checksum.
        if (table.schema.metadata or {}).get(_COLUMNS, _columns(table.schema)) != _columns(table.schema):
            raise ValueError("other columns than were written")
        return table.replace_schema_metadata(None)
    except Exception as error:  # altered bytes make the reader raise nearly anything
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0] or type(error).__name__
        raise DamagedError(f"{path}: not a readable record ({reason})") from error


def _holding(content: pq.ParquetFile, first: int, last: int) -> list[int]:
    """Which row groups of a file may hold rows of the seeds [first, last)."""
    place = content.schema_arrow.get_field_index(SCHEMA[0].name)
    found = []
    for number in range(content.num_row_groups):
        known = content.metadata.row_group(number).column(place).statistics
        if known is None or not known.has_min_max or (known.max >= first and known.min < last):
            found.append(number)
    return found


class Store:
    """The episodes of one run folder.

    Args:
      run: the run folder.
    """

    def __init__(self, run: Path) -> None:
        self.run = run
        self.pending: list[pa.Table] = []

    def holds_something(self) -> bool:
        """Whether a file of finished records is there, readable or not, that starting anew would overwrite."""
        whole = self.run / EPISODES
        try:
            return whole.exists() and read(whole).num_rows > 0
        except DamagedError:
            return True

    def add(self, table: pa.Table) -> None:
        """Keeps rows until the next `flush`."""
        self.pending.append(table)

    def has_parts(self) -> bool:
        """Whether rows lie in parts that `compact` has not put into one file yet."""
        return bool(self._parts())

    def _parts(self) -> list[Path]:
        return [path for _, path in self._numbered()]

    def _numbered(self) -> list[tuple[int, Path]]:
        found = ((_PART.fullmatch(path.name), path) for path in (self.run / PARTS).glob("part-*.parquet"))
        return sorted((int(match[1]), path) for match, path in found if match)

    def _files(self) -> list[Path]:
        whole = self.run / EPISODES
        return ([whole] if whole.exists() else []) + self._parts()

    def flush(self) -> None:
        """Writes the rows kept so far as a part.

        Raises:
          OSError: the disk is full or the folder cannot be written; the rows stay pending.
        """
        table = joined(self.pending)
        if table.num_rows == 0:
            return
        files.make_folder(self.run / PARTS)
        parts = self._numbered()
        number = parts[-1][0] + 1 if parts else 1
        _write(self.run / PARTS / f"part-{number:08d}.parquet", [table])
        self.pending.clear()

    def table(self, episodes_done: np.ndarray) -> pa.Table:
        """Every row that counts, by seed, then episode.

        Args:
          episodes_done: [S] finished episodes of each seed.

        Raises:
          DamagedError: a file cannot be read and its rows are not elsewhere.
        """
        (whole,) = self.tables(episodes_done, [len(episodes_done)])
        return whole

    def tables(self, episodes_done: np.ndarray, ends: Sequence[int]) -> Iterator[pa.Table]:
        """Every row that counts, some seeds at a time, so that no more than these need be in memory.

        Args:
          episodes_done: [S] finished episodes of each seed.
          ends: after the last seed of each table; the last is S.

        Yields:
          The rows of the seeds before each end, by seed, then episode.

        Raises:
          DamagedError: a file cannot be read and its rows are not elsewhere.
        """
        first = 0
        for last in ends:
            yield self._of_seeds(episodes_done, first, last, all_of=len(ends) == 1)
            first = last

    def _of_seeds(self, episodes_done: np.ndarray, first: int, last: int, all_of: bool) -> pa.Table:
        tables, damage = [], None
        for path in self._files():
            try:
                tables.append(read(path, None if all_of else (first, last)))
            except DamagedError as error:
                damage = error
        table = joined(tables)
        seed, episode = (table[name].to_numpy() for name in ("seed", "episode"))
        counts = np.append(np.where(np.arange(len(episodes_done)) < first, 0, episodes_done)[:last], 0)
        limit = counts[np.clip(seed, -1, last)]
        counted = ordered(table.filter(pa.array((episode >= 0) & (episode < limit))))
        # A kill between writing `episodes.parquet` and deleting the parts leaves some rows twice, equal to the bit.
        pair = np.stack([counted[name].to_numpy() for name in ("seed", "episode")])
        once = np.any(np.diff(pair, axis=1, prepend=-1) != 0, axis=0)
        counted = counted.filter(pa.array(once))
        if counted.num_rows != int(counts.sum()):
            missing = int(counts.sum()) - counted.num_rows
            raise damage or DamagedError(f"{self.run / PARTS}: {missing} episodes of the checkpoint are missing")
        return counted.combine_chunks()

    def schema(self) -> pa.Schema:
        """The columns of the record, of whatever rows; only those of `SCHEMA` where there are none.

        Raises:
          DamagedError: no file can be read.
        """
        found, damage = [], None
        for path in self._files():
            try:
                found.append(read(path, (0, 0)).schema)
            except DamagedError as error:
                damage = error
        if damage and not found:
            raise damage
        return pa.unify_schemas([SCHEMA, *found])

    def check(self, episodes_done: np.ndarray) -> None:
        """Reads every row that counts, and keeps none.

        Raises:
          DamagedError: see `table`.
        """
        for _ in self.tables(episodes_done, ends_of(episodes_done)):
            pass

    def compact(self, episodes_done: np.ndarray) -> None:
        """Cuts the record back to `episodes_done` and puts it into one file.

        Raises:
          DamagedError: see `table`.
          OSError: the disk is full or the folder cannot be written; nothing is lost.
        """
        _write(self.run / EPISODES, self.tables(episodes_done, ends_of(episodes_done)))
        for path in self._parts():
            path.unlink()
        with contextlib.suppress(OSError):
            (self.run / PARTS).rmdir()


def ends_of(episodes_done: np.ndarray, most: int = _ROWS_AT_ONCE) -> list[int]:
    """After which seeds to cut so that the rows of a part, unless it is one seed, are no more than `most`.

    Args:
      episodes_done: [S] finished episodes of each seed.
      most: rows.
    """
    found, rows = [], 0
    for seed, number in enumerate(episodes_done.tolist()):
        if rows and rows + number > most:
            found.append(seed)
            rows = 0
        rows += number
    return [*found, len(episodes_done)]
