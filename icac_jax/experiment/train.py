"""`icac train`: one run, from settings to a folder with its records and summary."""

import json
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from icac_jax.experiment import folder as run_folder
from icac_jax.experiment import records, summary
from icac_jax.experiment.progress import Reporter
from icac_jax.experiment.settings import Settings
from icac_jax.experiment.training import Training

_RECENT = 2000


def train(settings: Settings, out: Path) -> dict[str, Any]:
    """Trains and writes the run into `out`.

    Args:
      settings: of the run.
      out: a new or empty folder.

    Returns:
      The summary, as written to the folder.

    Raises:
      ConfigError: the folder cannot be used.
    """
    run_folder.create(out, settings)
    run = settings.run
    training = Training(settings)
    tables: list[pa.Table] = [records.SCHEMA.empty_table()]
    recent: deque[bool] = deque(maxlen=_RECENT)
    chunk = None
    title = f"{settings.spec.algo} {run.arm}"
    with Reporter(title, run.seeds * run.episodes) as reporter:
        for chunk in training.chunks(training.start()):
            tables.append(chunk.table)
            recent.extend(chunk.table["reached"].to_pylist())
            rate = f"success {np.mean(recent):.0%} of the last {len(recent)}" if recent else "no episode yet"
            reporter.update(int(chunk.episodes_done.sum()), chunk.seconds, rate)
    assert chunk is not None
    table = records.ordered(pa.concat_tables(tables))
    failed = {int(seed): int(chunk.episodes_done[seed]) for seed in np.flatnonzero(chunk.failed)}
    result = summary.summarise(settings, table, failed, training.overflow(chunk.lanes), chunk.lane_steps, chunk.seconds)
    records.write(out / run_folder.EPISODES, table)
    run_folder.write_text(out / run_folder.SUMMARY, json.dumps(result, indent=2) + "\n")
    return result
