"""The record of a run: one row per episode, as a Parquet file that pandas, polars and duckdb read.

The columns are those of `SCHEMA`, then those that the learner reports.
"""

from typing import Any

import numpy as np
import pyarrow as pa

from icac_jax.rollout import EpisodeRecord

# The columns that every run has.
SCHEMA = pa.schema(
    [
        pa.field("seed", pa.int32()),
        pa.field("episode", pa.int32()),
        pa.field("steps", pa.int32()),
        pa.field("reached", pa.bool_()),
        pa.field("extrinsic_reward", pa.float32()),
    ]
)


def encoding(schema: pa.Schema) -> dict[str, Any]:
    """How Parquet files of records are written: to look for numbers that repeat among fractions costs most of the time.

    Args:
      schema: of the file.
    """
    repeating = [field.name for field in schema if not pa.types.is_floating(field.type)]
    return {"compression": "zstd", "use_dictionary": repeating}


def rows(records: EpisodeRecord, seeds: np.ndarray) -> pa.Table:
    """The episodes that ended in a chunk, in order of step, then lane.

    Args:
      records: leaves [length, L] as `run_chunk` gives them, on the host.
      seeds: [L] seed of each lane.
    """
    done = np.nonzero(records.done)
    columns = {
        "seed": np.asarray(seeds, np.int32)[done[1]],
        "episode": records.episode[done],
        "reached": records.reached[done],
        **{name: values[done] for name, values in (records.totals | records.last).items()},
    }
    own = [(field.name, field.type, columns.pop(field.name)) for field in SCHEMA]
    reported = [(name, pa.from_numpy_dtype(values.dtype), values) for name, values in columns.items()]
    parts = own + reported
    schema = pa.schema([pa.field(name, kind) for name, kind, _ in parts])
    return pa.table([_column(kind, values) for _, kind, values in parts], schema=schema)


def _column(kind: pa.DataType, values: np.ndarray) -> pa.Array:
    """A column of numbers, none missing. `pa.array` would load pandas, where it is installed, just to ask."""
    if pa.types.is_boolean(kind):
        content = np.packbits(values, bitorder="little")
    else:
        content = np.ascontiguousarray(values, kind.to_pandas_dtype())
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(content)])


def joined(tables: list[pa.Table]) -> pa.Table:
    """All rows under each other; where a table lacks a column that another has, its rows hold 0 there.

    Versions differ in what a learner reports; a run that is resumed by a later version has rows of both.
    """
    table = pa.concat_tables([SCHEMA.empty_table(), *tables], promote_options="default")
    for place, field in enumerate(table.schema):
        if table.column(place).null_count:
            table = table.set_column(place, field, table.column(place).fill_null(pa.scalar(0).cast(field.type)))
    return table


def column(table: pa.Table, name: str) -> np.ndarray | None:
    """A column as an array, or None where the table has no such column."""
    return table[name].to_numpy() if name in table.column_names else None


def ordered(table: pa.Table) -> pa.Table:
    """The rows by seed, then episode."""
    return table.sort_by([("seed", "ascending"), ("episode", "ascending")])
