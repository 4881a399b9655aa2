"""Training a list of jobs in a folder, alone or as one of several processes that each take a share of it."""

import functools
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa

from icac_jax import shapes
from icac_jax.rollout import LaneState
from icac_jax.runs import files, processes, session, signals
from icac_jax.runs import folder as run_folder
from icac_jax.runs.checkpoints import DamagedError
from icac_jax.runs.loop import Job, Training
from icac_jax.runs.processes import Process
from icac_jax.runs.session import Session, StoppedError
from icac_jax.runs.shares import Share
from icac_jax.runs.store import Store
from icac_jax.settings.options import before_there_was

DONE = "done.json"
# What `done.json` holds one number per job for.
_PER_JOB = ("episodes_done", "failed", "steps")
_SHAPE = shapes.record(
    {"failed": shapes.several(shapes.flag)}
    | dict.fromkeys(("episodes_done", "steps"), shapes.several(shapes.whole))
    | {"seconds": shapes.amount, "lanes": shapes.whole}
)


def read_done(folder: Path) -> dict[str, Any]:
    """What a finished list of jobs says about them; empty if it has not finished, or what it says is damaged.

    Returns:
      `episodes_done`, `failed`, `steps` of each job; `seconds` and `lanes` of the whole.
    """
    facts = run_folder.read_json(folder / DONE)
    return facts if shapes.fits(_SHAPE, facts) else {}


def train_jobs(
    jobs: Sequence[Job],
    folder: Path,
    home: Path,
    title: str,
    options: dict[str, Any],
    lanes: Callable[[int], int],
    checkpoint_every: float,
    tell: Callable[[str], None],
    before: int = 0,
    total: int = 0,
    process: Process = processes.ALONE,
    together: bool = True,
    others: Sequence[Path] | None = None,
) -> None:
    """Trains jobs of one program to their end, or goes on where an earlier call stopped; then `read_done` tells.

    Args:
      jobs: all of them, the same list in every process.
      folder: where records and checkpoints lie; in a folder of its own within it for each of several processes.
      home: the folder that `icac resume` takes.
      title: for the progress display.
      options: what checkpoints say that they are of.
      lanes: how many train at once in a process, for a number of jobs.
      checkpoint_every: seconds between checkpoints.
      tell: told what is not as it should be.
      before: episodes of the home that were finished elsewhere.
      total: episodes of the home; by default those of the jobs.
      process: this process among those that share the jobs.
      together: wait for the others' shares; `read_done` tells nothing before a call does.
      others: the folders of what other processes train in this home; by default their shares of these jobs.

    Raises:
      DamagedError: files of an earlier call cannot be read or are of other jobs.
      StoppedError: a signal asked for a stop.
      OSError: the folder cannot be written.
    """
    if _is_done(folder, len(jobs)):
        return
    files.make_folder(folder)
    share = process.folder(folder)
    if not _is_done(share, len(jobs[process.index :: process.count])):
        share.mkdir(exist_ok=True)
        mine = jobs[process.index :: process.count]
        if mine:
            theirs = (place for place in process.others(folder) if place != share) if others is None else others
            part = Share(share, tuple(theirs), process.index == 0 and together) if process.count > 1 else None
            total = total or sum(job.settings.run.episodes for job in jobs)
            _train(mine, share, home, part, title, options, lanes, checkpoint_every, tell, before, total)
        else:
            _write_done(share, {name: [] for name in _PER_JOB} | {"seconds": 0.0, "lanes": 0})
    if not together:
        return
    if process.count > 1 and process.index == 0 and not _is_done(folder, len(jobs)):
        _gather(folder, len(jobs), process)
    elif process.index > 0:
        processes.wait_for(folder / DONE, home / run_folder.SUMMARY)


def _train(
    jobs: Sequence[Job],
    folder: Path,
    home: Path,
    part: Share | None,
    title: str,
    options: dict[str, Any],
    lanes: Callable[[int], int],
    checkpoint_every: float,
    tell: Callable[[str], None],
    before: int,
    total: int,
) -> None:
    training = Training(jobs, lanes(len(jobs)))

    def check(stored: dict[str, Any]) -> None:
        if not _same(stored, json.loads(json.dumps(options))):
            raise DamagedError(f"{folder}: its checkpoint is of other settings than {home} says")

    found, problems = session.latest(folder, training, check)
    for problem in problems:
        tell(f"{problem}; resumed from the checkpoint before")
    checkpoint, progress = found or (None, training.first())
    Store(folder).compact(progress.episodes_done)
    session.set_aside(folder, checkpoint)
    seconds = float(checkpoint.meta["seconds"]) if checkpoint else 0.0
    this = Session(training, folder, home, title, options, checkpoint_every, seconds, before, total, share=part)
    chunk, _ = this.run(training.place(checkpoint.lanes) if checkpoint else training.start(), progress)
    facts = {name: getattr(chunk.progress, name).tolist() for name in _PER_JOB}
    _write_done(folder, facts | {"seconds": seconds + chunk.seconds, "lanes": training.width})
    if (asked := signals.asked_last()) is not None:
        raise StoppedError(f"stopped and saved; resume with: icac resume {home}", asked)


def _same(stored: Any, now: Any) -> bool:
    """Whether a checkpoint's options are these; earlier versions had other ones, and not all of today's."""
    if isinstance(stored, dict) and isinstance(now, dict):
        if "algo" in now and not now.keys() <= stored.keys():
            stored = json.loads(json.dumps(before_there_was(now))) | stored
        return all(name in stored and _same(stored[name], value) for name, value in now.items())
    if isinstance(stored, list) and isinstance(now, list):
        return len(stored) == len(now) and all(map(_same, stored, now))
    return stored == now


def _write_done(folder: Path, facts: dict[str, Any]) -> None:
    files.write_text(folder / DONE, json.dumps(facts) + "\n")


def _is_done(folder: Path, jobs: int) -> bool:
    facts = read_done(folder)
    if facts and any(len(facts[name]) != jobs for name in _PER_JOB):
        raise DamagedError(f"{folder / DONE}: not of the jobs that it should be of")
    return bool(facts)


def _gather(folder: Path, jobs: int, process: Process) -> None:
    """Puts the shares of all processes together; job j was job j // count of process j % count."""
    facts: dict[str, Any] = {name: [0] * jobs for name in _PER_JOB} | {"seconds": 0.0, "lanes": 0}
    whole = Store(folder)
    for index, share in enumerate(process.others(folder)):
        processes.wait_for(share / DONE)
        theirs = read_done(share)
        if not theirs:
            raise DamagedError(f"{share / DONE}: cannot be read")
        for name in _PER_JOB:
            facts[name][index :: process.count] = theirs[name]
        facts["seconds"] = max(facts["seconds"], theirs["seconds"])
        facts["lanes"] += theirs["lanes"]
        if theirs["episodes_done"]:
            table = Store(share).table(np.array(theirs["episodes_done"]))
            numbers = pa.array((table["seed"].to_numpy() * process.count + index).astype(np.int32))
            whole.add(table.set_column(table.schema.get_field_index("seed"), table.schema.field("seed"), numbers))
    whole.flush()
    whole.compact(np.array(facts["episodes_done"]))
    _write_done(folder, facts)


def final_lanes(folder: Path, jobs: Sequence[Job], process: Process) -> LaneState:
    """The final state of every job, leaves [J, ...] on the host, from the processes' last checkpoints.

    Each process must have had a lane for each of its jobs.

    Raises:
      DamagedError: a checkpoint cannot be read.
    """
    parts, numbers = [], []
    for index, share in enumerate(process.others(folder)):
        mine = jobs[index :: process.count]
        if mine:
            found, _ = session.latest(share, Training(mine), lambda _: None, records=False)
            if found is None:
                raise DamagedError(f"{share}: has no checkpoint")
            parts.append(jax.tree.map(functools.partial(_first, len(mine)), found[0].lanes))
            numbers += range(index, len(jobs), process.count)
    order = np.argsort(numbers)
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves)[order], *parts)


def _first(number: int, leaf: jax.Array) -> jax.Array:
    return leaf[:number]
