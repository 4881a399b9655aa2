"""The record of a run: one row an episode, as a Parquet file that pandas, polars and duckdb read."""

import numpy as np
import pyarrow as pa

from icac_jax.rollout import EpisodeRecord

# The columns of `episodes.parquet`.
SCHEMA = pa.schema(
    [
        pa.field("seed", pa.int32()),
        pa.field("episode", pa.int32()),
        pa.field("steps", pa.int32()),
        pa.field("reached", pa.bool_()),
        pa.field("extrinsic_reward", pa.float32()),
        pa.field("intrinsic_reward", pa.float32()),
        pa.field("learning_progress", pa.float32()),
        pa.field("perception_error", pa.float32()),
        pa.field("live_nodes", pa.int32()),
    ]
)


def rows(records: EpisodeRecord, seeds: np.ndarray) -> pa.Table:
    """The episodes that ended in a chunk, in order of step, then lane.

    Args:
      records: leaves [length, L] as `run_chunk` gives them, on the host.
      seeds: [L] seed of each lane.
    """
    done = np.nonzero(records.done)
    totals = records.totals
    columns = {
        "seed": seeds[done[1]],
        "episode": records.episode[done],
        "steps": totals.steps[done],
        "reached": records.reached[done],
        "extrinsic_reward": totals.extrinsic_reward[done],
        "intrinsic_reward": totals.intrinsic_reward[done],
        "learning_progress": totals.learning_progress[done],
        "perception_error": totals.perception_error[done],
        "live_nodes": records.live_nodes[done],
    }
    return pa.table([_column(field.type, columns[field.name]) for field in SCHEMA], schema=SCHEMA)


def _column(kind: pa.DataType, values: np.ndarray) -> pa.Array:
    """A column of numbers, none missing. `pa.array` would load pandas, where it is installed, just to ask."""
    if pa.types.is_boolean(kind):
        content = np.packbits(values, bitorder="little")
    else:
        content = np.ascontiguousarray(values, kind.to_pandas_dtype())
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(content)])


def ordered(table: pa.Table) -> pa.Table:
    """The rows by seed, then episode."""
    return table.sort_by([("seed", "ascending"), ("episode", "ascending")])
