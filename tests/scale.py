"""What a study of thousands of cells costs to put together and to report; nothing is trained.

`python -m tests.scale [CELLS] [--out FOLDER]` writes the records that training would have left, 20 seeds of 200
episodes per cell with the columns of ICAC, then does what a sweep does when its last group has finished, and prints how
long that took and how much memory it needed.
"""

import argparse
import json
import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa

from icac_jax.runs import folder as run_folder
from icac_jax.runs.jobs import DONE
from icac_jax.runs.store import Store
from icac_jax.sweeps import collect, groups, stages, sweep_file
from icac_jax.sweeps.engine import Batch

_STUDY = """claim = "A study that nobody has trained"

[base]
arm = "planar2"
algo = "icac"
seeds = {seeds}
episodes = {episodes}

[random]
draws = {cells}
gamma = {{ low = 0.5, high = 0.99 }}
sigma = {{ low = 0.1, high = 1.0 }}
e_max = {{ low = 0.2, high = 1.0 }}
"""
# Jobs whose rows are in one part of a record, as if so many had ended between two checkpoints.
_JOBS_PER_PART = 2000


def untrained(folder, text):
    """A sweep's folder with the records of made-up training; returns the study and its one batch."""
    folder.mkdir(parents=True)
    (folder / run_folder.SWEEP).write_text(text)
    chosen = sweep_file.read(folder / run_folder.SWEEP)
    cells = chosen.cells()
    batch = Batch(folder / collect.GROUPS / "batch-0000", cells, groups.grouped(cells))
    rng = np.random.default_rng(0)
    for group in batch.groups:
        _write(batch.place(group), group, rng)
    return chosen, batch


def _write(place, group, rng):
    place.mkdir(parents=True)
    store, jobs = Store(place), group.jobs()
    done = np.array([job.settings.run.episodes for job in jobs])
    done[0] -= 1  # one that diverged in its last episode
    curious = group.settings.algo == "icac"
    for first in range(0, len(jobs), _JOBS_PER_PART):
        mine = done[first : first + _JOBS_PER_PART]
        rows = int(mine.sum())
        reached = rng.random(rows) < 0.3
        columns = {
            "seed": np.repeat(np.arange(first, first + len(mine), dtype=np.int32), mine),
            "episode": np.concatenate([np.arange(number, dtype=np.int32) for number in mine]),
            "steps": np.where(reached, rng.integers(1, 50, rows), 50).astype(np.int32),
            "reached": reached,
            "extrinsic_reward": reached.astype(np.float32),
            "td_error": rng.random(rows, np.float32),
        }
        if curious:
            columns |= {name: rng.random(rows, np.float32) for name in ("learning_progress", "perception_error")}
            columns |= {name: np.full(rows, 20, np.int32) for name in ("live_nodes", "overflow")}
        store.add(pa.table(columns).take(pa.array(rng.permutation(rows))))
        store.flush()
    store.compact(done)  # as it is when a group has ended
    failed = [bool(number < job.settings.run.episodes) for number, job in zip(done, jobs, strict=True)]
    facts = {"episodes_done": done.tolist(), "failed": failed, "steps": (40 * done).tolist()}
    (place / DONE).write_text(json.dumps(facts | {"seconds": 1.0, "lanes": 128}))


def measure(cells, folder):
    """Puts the study together and reports it; prints seconds and MiB."""
    chosen, batch = untrained(folder, _STUDY.format(cells=cells, seeds=20, episodes=200))
    began, cpu = time.monotonic(), time.process_time()
    collect.gather(chosen, [batch], folder, 0.0)
    together = time.monotonic()
    stages.complete(chosen, stages.trained(folder), folder, print)
    ended = time.monotonic()
    # Linux counts in KiB, macOS in bytes.
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10)
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 2**20
    print(
        f"{cells:,} cells, 20 seeds, {cells * 4000 / 1e6:.1f} million episodes: "
        f"put together in {together - began:.1f} s, reported in {ended - together:.1f} s, "
        f"{time.process_time() - cpu:.1f} s of one core in all; "
        f"at most {most:,.0f} MiB of memory, {size:,.0f} MiB on the disk"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("cells", type=int, nargs="?", default=10_000)
    parser.add_argument("--out", type=Path, help="keep the folder here")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        measure(given.cells, given.out or Path(scratch) / "sweep")
