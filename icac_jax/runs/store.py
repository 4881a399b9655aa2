"""The record of a run on disk: parts while it runs, one `episodes.parquet` when it stops.

A row counts if its episode is below the number of episodes that its seed had finished at the checkpoint resumed from;
that rule alone makes resuming exact, whatever was written after the checkpoint.
"""

import contextlib
import hashlib
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from icac_jax import reading
from icac_jax.errors import DamagedError
from icac_jax.runs import files
from icac_jax.runs.folder import RECORDS as PARTS
from icac_jax.runs.records import SCHEMA, joined, ordered

EPISODES = "episodes.parquet"
_COLUMNS = b"columns"
_PART = re.compile(r"part-(\d{8,12})\.parquet")


def _columns(schema: pa.Schema) -> bytes:
    """What the columns are called and hold, to be kept with them: Parquet has checksums of pages, none of names."""
    return hashlib.sha256("\n".join(f"{field.name} {field.type}" for field in schema).encode()).hexdigest().encode()


def _write(path: Path, table: pa.Table) -> None:
    table = table.replace_schema_metadata({_COLUMNS: _columns(table.schema)})
    with files.replacing(path) as file:
        pq.write_table(table, file, compression="zstd", write_page_checksum=True)


def read(path: Path) -> pa.Table:
    """The rows of one file of records (see `records`).

    Raises:
      DamagedError: it cannot be read, or holds other columns.
    """
    try:
        with reading.regular(path) as file:  # a path in words would be taken for a URI, and must be UTF-8
            # Read ahead in threads, a process that ends right afterwards was aborted now and then (pyarrow 26).
            table = pq.read_table(file, page_checksum_verification=True, pre_buffer=False)
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
        _write(self.run / PARTS / f"part-{number:08d}.parquet", table)
        self.pending.clear()

    def table(self, episodes_done: np.ndarray) -> pa.Table:
        """Every row that counts, by seed, then episode.

        Args:
          episodes_done: [S] finished episodes of each seed.

        Raises:
          DamagedError: a file cannot be read and its rows are not elsewhere.
        """
        tables, damage = [], None
        whole = self.run / EPISODES
        for path in ([whole] if whole.exists() else []) + self._parts():
            try:
                tables.append(read(path))
            except DamagedError as error:
                damage = error
        table = joined(tables)
        seed, episode = (table[name].to_numpy() for name in ("seed", "episode"))
        limit = np.append(episodes_done, 0)[np.clip(seed, -1, len(episodes_done))]
        counted = ordered(table.filter(pa.array((episode >= 0) & (episode < limit))))
        # A kill between writing `episodes.parquet` and deleting the parts leaves some rows twice, equal to the bit.
        pair = np.stack([counted[name].to_numpy() for name in ("seed", "episode")])
        first = np.any(np.diff(pair, axis=1, prepend=-1) != 0, axis=0)
        counted = counted.filter(pa.array(first))
        if counted.num_rows != int(episodes_done.sum()):
            missing = int(episodes_done.sum()) - counted.num_rows
            raise damage or DamagedError(f"{self.run / PARTS}: {missing} episodes of the checkpoint are missing")
        return counted.combine_chunks()

    def compact(self, episodes_done: np.ndarray) -> pa.Table:
        """Cuts the record back to `episodes_done` and puts it into one file; returns it.

        Raises:
          DamagedError: see `table`.
          OSError: the disk is full or the folder cannot be written; nothing is lost.
        """
        table = self.table(episodes_done)
        _write(self.run / EPISODES, table)
        for path in self._parts():
            path.unlink()
        with contextlib.suppress(OSError):
            (self.run / PARTS).rmdir()
        return table
