"""`icac sweep`: every cell of a study, trained group by group in one folder, and resumed from wherever it stopped."""

import contextlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from icac_jax.fields import ConfigError
from icac_jax.runs import CHECKPOINT_EVERY, files, processes, randomness
from icac_jax.runs import folder as run_folder
from icac_jax.runs.checkpoints import DamagedError
from icac_jax.runs.session import writing
from icac_jax.sweeps import groups, stages, study, sweep_file
from icac_jax.sweeps.collect import GROUPS, gather, rows_of
from icac_jax.sweeps.engine import Batch, Engine, Local, Plan, Tasks
from icac_jax.sweeps.halving import Promoting
from icac_jax.sweeps.study import Cell, Study

if TYPE_CHECKING:
    from icac_jax.sweeps.search import Asking

PLAN = "plan.json"


def _quiet(line: str) -> None:
    pass


def sweep(
    chosen: Study,
    out: Path,
    lanes: int | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    tell: Callable[[str], None] = _quiet,
    engine: Engine | None = None,
) -> dict[str, Any]:
    """Trains every cell of a study into `out`, or resumes where an earlier call stopped.

    Args:
      chosen: the study.
      out: a new or empty folder, or the folder of the same study.
      lanes: how many learners train at once; by default what the devices are best filled with.
      checkpoint_every: seconds between checkpoints.
      tell: told, in a line each, what happens.
      engine: who trains; this machine by default.

    Returns:
      The summary, as written to the folder.

    Raises:
      ConfigError: the folder cannot be used or holds another study.
      DamagedError: files of an earlier call cannot be read.
      StoppedError: a signal asked for a stop.
      WriteError: the folder could not be written any more.
    """
    engine = engine or Local()
    if engine.process.index > 0:
        processes.wait_for(out / PLAN)
    if run_folder.is_sweep(out):
        there = sweep_file.read(out / run_folder.SWEEP)
        differing = study.differences(there, chosen)
        if differing:
            raise ConfigError(f"out: {out} holds another sweep, it differs in {', '.join(differing)}")
        return resume(out, checkpoint_every, tell, engine)
    if chosen.search is None:
        chosen.cells()  # says what is wrong before there is a folder
    with run_folder.created(out, run_folder.SWEEP, chosen.text), writing(out):
        # Written down: on a machine with other devices the sweep must be resumed with as many lanes as it began with.
        lanes = lanes or groups.best_lanes()
        facts = {"lanes": lanes, "most_jobs": engine.most_jobs}
        files.write_text(out / PLAN, json.dumps(facts) + "\n")
        run_folder.record(out, "started", platform=randomness.platform_facts())
        return _run(chosen, out, engine, engine.most_jobs, Plan(lanes, checkpoint_every, tell))


def resume(
    folder: Path,
    checkpoint_every: float = CHECKPOINT_EVERY,
    tell: Callable[[str], None] = _quiet,
    engine: Engine | None = None,
) -> dict[str, Any]:
    """Resumes a sweep; arguments, result and errors as in `sweep`."""
    engine = engine or Local()
    sweep_file.read(folder / run_folder.SWEEP)  # refuses what is no sweep before a lock is put there
    with run_folder.locked(folder) if engine.process.index == 0 else contextlib.nullcontext():
        chosen = sweep_file.read(folder / run_folder.SWEEP)
        result = stages.trained(folder)
        if result is not None:
            if engine.process.index == 0:
                with writing(folder):
                    stages.complete(chosen, result, folder, tell)
            return result
        randomness.check(folder)
        facts = randomness.platform_facts()
        changes = run_folder.platform_changes(folder, facts)
        if changes:
            tell(f"bits may differ in the last digits from an uninterrupted sweep: {', '.join(changes)}")
        lanes, most_jobs, tasks = (planned(folder, name) for name in ("lanes", "most_jobs", "tasks"))
        if tasks is not None:
            if not isinstance(engine, Local) or engine.process.count > 1:
                raise ConfigError(f"out: {folder} was begun with --slurm {tasks}, it goes on in one process")
            engine = Tasks(tasks)
        with writing(folder):
            if engine.process.index == 0:
                run_folder.record(folder, "resumed", changes=changes, platform=facts)
            return _run(chosen, folder, engine, most_jobs, Plan(lanes, checkpoint_every, tell))


def planned(folder: Path, name: str) -> int | None:
    """How a sweep was begun: its `lanes`, `most_jobs` or `tasks`, None where nothing was said.

    Raises:
      DamagedError: it is no number.
    """
    value = run_folder.read_json(folder / PLAN).get(name)
    if value is not None and (not isinstance(value, int) or value < 1):
        raise DamagedError(f"{folder / PLAN}: {name} must be a whole number at least 1, got {value!r}")
    return value


def batch_of(folder: Path, cells: list[Cell], number: int, most_jobs: int | None) -> Batch:
    """A batch of a sweep's cells, with its folder.

    Args:
      folder: of the sweep.
      cells: of the batch.
      number: of the batch, from 0.
      most_jobs: of a group, as the sweep was begun with.
    """
    place = folder / GROUPS / f"batch-{number:04d}"
    files.make_folder(place)
    return Batch(place, cells, groups.grouped(cells, most_jobs))


def _asking(chosen: Study) -> "Asking | Promoting | None":
    """Who says which cells train next, given how others went; None where all train at once."""
    if chosen.search is not None:
        from icac_jax.sweeps.search import Asking

        return Asking(chosen)
    return Promoting(chosen) if chosen.halving is not None else None


def _run(chosen: Study, folder: Path, engine: Engine, most_jobs: int | None, plan: Plan) -> dict[str, Any]:
    """Trains every batch of cells; `most_jobs` as the sweep was begun with. Returns the summary."""
    started = time.monotonic()
    files.make_folder(folder / GROUPS)
    if engine.process.index == 0:
        for stale in (folder / GROUPS).glob("left-*"):
            stale.unlink()
    batches: list[Batch] = []

    def train(cells: list[Cell], before: int, total: int) -> Batch:
        batch = batch_of(folder, cells, len(batches), most_jobs)
        engine.train(batch, folder, plan, before, total or sum(group.episodes for group in batch.groups))
        batches.append(batch)
        return batch

    if (asking := _asking(chosen)) is None:
        train(chosen.cells(), 0, 0)
    else:
        before = 0
        for cells in asking.batches():
            rows = rows_of(train(cells, before, asking.total))
            asking.tell(rows)
            before += sum(row["episodes_done"] for row in rows)
    # Process 0 removes the working files when no other process needs them any more.
    left = [folder / GROUPS / f"left-{index:04d}" for index in range(1, engine.process.count)]
    if engine.process.index > 0:
        left[engine.process.index - 1].touch()
        processes.wait_for(folder / run_folder.SUMMARY)
        return run_folder.read_json(folder / run_folder.SUMMARY)
    for path in left:
        processes.wait_for(path)
    gather(chosen, batches, folder, time.monotonic() - started)
    result = stages.trained(folder)
    assert result is not None
    stages.complete(chosen, result, folder, _quiet)
    return result
