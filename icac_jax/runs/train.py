"""`icac train` and `icac resume`: a run from settings to a folder, and on from wherever it stopped."""

import contextlib
import errno
import functools
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from icac_jax.errors import ConfigError, DamagedError
from icac_jax.rollout import LaneState
from icac_jax.runs import (
    CHECKPOINT_EVERY,
    checkpoints,
    copies,
    evaluations,
    files,
    oracles,
    processes,
    randomness,
    session,
    stored_summary,
    summary,
    warm_maps,
)
from icac_jax.runs import folder as run_folder
from icac_jax.runs.checkpoints import Checkpoint
from icac_jax.runs.evaluations import Evaluations
from icac_jax.runs.jobs import final_lanes, read_done, train_jobs
from icac_jax.runs.loop import Chunk, Progress, Training, jobs_of
from icac_jax.runs.observers import Observer, Observers, Run
from icac_jax.runs.processes import Process
from icac_jax.runs.session import Session, WriteError, writing
from icac_jax.runs.store import Store
from icac_jax.settings.options import Settings, before_there_was, resolve

# Working files of processes that share a run, removed when it has finished.
_SHARES = "shares"


def _shared(
    settings: Settings, folder: Path, checkpoint_every: float, warn: Callable[[str], None], process: Process
) -> dict[str, Any]:
    """Trains this process's share of the seeds; process 0 then makes an ordinary run folder of all shares."""
    finished = ended(folder, settings)
    if finished is not None:
        return finished
    begun = _processes(folder)
    if begun not in (None, process.count):
        raise ConfigError(f"num_processes: must be {begun} as when the run began, got {process.count}")
    jobs, shares_folder = jobs_of(settings), folder / _SHARES
    title = f"{settings.algo} {settings.arm.name}, process {process.index} of {process.count}"
    train_jobs(
        jobs, shares_folder, folder, title, settings.flat(), lambda jobs: jobs, checkpoint_every, warn, process=process
    )
    if process.index > 0:
        processes.wait_for(folder / run_folder.SUMMARY)
        return run_folder.read_json(folder / run_folder.SUMMARY)
    facts = read_done(shares_folder)
    done = np.array(facts["episodes_done"])
    meta = {"seconds": facts["seconds"], "options": settings.flat()}
    store = Store(folder)
    store.add(Store(shares_folder).table(done))
    store.flush()
    checkpoints.save(folder / run_folder.CHECKPOINTS, final_lanes(shares_folder, jobs, process), meta)
    store.compact(done)
    result = _finished(settings, folder, store.table(done), facts, facts["seconds"], "")
    shutil.rmtree(shares_folder, ignore_errors=True)
    return result


def _processes(folder: Path) -> int | None:
    """How many processes began the run, None if none has begun yet."""
    shares = [path.name for path in (folder / _SHARES).glob("host-*-of-*")]
    if shares:
        return int(shares[0].rpartition("-")[2])
    return 1 if (folder / run_folder.CHECKPOINTS).exists() else None


def _finished(
    settings: Settings, folder: Path, table: pa.Table, facts: dict[str, Any], seconds: float, note: str
) -> dict[str, Any]:
    """Writes the summary of a run whose jobs have all ended; `facts` as `shares.read_done` has them."""
    done = facts["episodes_done"]
    failed = {int(seed): int(done[seed]) for seed in np.flatnonzero(facts["failed"])}
    least = oracles.mean_steps(settings)
    result = summary.summarise(settings, table, failed, int(np.sum(facts["steps"])), seconds, least)
    files.write_text(folder / run_folder.SUMMARY, json.dumps(result, indent=2) + "\n")
    total = settings.run.seeds * settings.run.episodes
    run_folder.record(folder, "finished", failed_seeds=sorted(failed))
    # Last: it says that everything is there.
    session.write_status(folder, "failed" if np.all(facts["failed"]) else "finished", int(np.sum(done)), total, note)
    return result


def _run(
    settings: Settings,
    folder: Path,
    training: Training,
    lanes: LaneState,
    progress: Progress,
    checkpoint_every: float,
    seconds: float,
    at_intervals: Evaluations | None,
    observers: Sequence[Observer | Callable[[Chunk], None]],
) -> dict[str, Any]:
    """Trains to the end in a folder that this process has locked; returns the summary, as written there."""
    this = Session(
        training,
        folder,
        folder,
        f"{settings.algo} {settings.arm.name}",
        settings.flat(),
        checkpoint_every,
        seconds,
    )
    result: dict[str, Any] = {}
    with writing(folder):
        done, steps = int(progress.episodes_done.max()), int(progress.steps.sum())
        told = Observers(observers, Run(this.title, this.options, folder, this.total, done, steps))
        this.observers = (told.see, *([at_intervals.see] if at_intervals else []))
        try:
            chunk, note = this.run(lanes, progress)
            table = Store(folder).table(chunk.episodes_done)
            result = _finished(settings, folder, table, chunk.progress._asdict(), seconds + chunk.seconds, note)
        finally:
            told.end(result or None)
    return result


def train(
    settings: Settings,
    out: Path,
    checkpoint_every: float = CHECKPOINT_EVERY,
    evaluate_every: int = 0,
    process: Process = processes.ALONE,
    observers: Sequence[Observer | Callable[[Chunk], None]] = (),
) -> dict[str, Any]:
    """Trains and writes the run into `out`.

    Args:
      settings: of the run.
      out: a new or empty folder.
      checkpoint_every: seconds between checkpoints.
      evaluate_every: episodes between evaluations without exploration; 0 for none.
      process: this process among those that share the run, which see the same `out`.
      observers: told of each chunk of a run that one process trains, see `observers`.

    Returns:
      The summary, as written to the folder.

    Raises:
      ConfigError: the folder cannot be used, or an option is not valid.
      StoppedError: a signal asked for a stop.
      WriteError: the folder could not be written any more.
    """
    if evaluate_every < 0:
        raise ConfigError(f"evaluate_every: must be a whole number at least 0, got {evaluate_every}")
    evaluate_every = int(evaluate_every)  # of NumPy, perhaps
    if process.count > 1 and evaluate_every:
        raise ConfigError("num_processes: must be 1 with evaluate_every, which sees all seeds at once")
    if process.index > 0:
        processes.wait_for(out / run_folder.CONFIG)
        there = run_folder.load(out)
        kept = there.flat()
        own = [name for name in ("arm", "demonstrations", "encoder") if kept.get(f"{name}_sha256")]
        its_own = {key: kept[key] for name in own for key in (name, f"{name}_sha256")}
        settings = resolve(**settings.flat() | its_own | (vars(there.warm) if settings.warm.warm_map else {}))
        return _shared(settings, out, checkpoint_every, lambda _: None, process)
    training = Training.of_run(settings) if process.count == 1 else None

    def config() -> str:
        nonlocal settings
        for copied in (copies.with_arm, copies.with_demonstrations, copies.with_encoder, warm_maps.kept):
            settings = copied(out, settings)
        return run_folder.config_text(settings, out)

    with run_folder.created(out, run_folder.CONFIG, config), writing(out):
        if training is None:
            run_folder.record(out, "started", processes=process.count, platform=randomness.platform_facts())
            return _shared(settings, out, checkpoint_every, lambda _: None, process)
        own = settings.run.arm_sha256, settings.imitation.from_file, settings.camera.encoder, settings.warm.warm_map
        if any(own):
            training = Training.of_run(settings)  # from the copies in the run
        run_folder.record(out, "started", platform=randomness.platform_facts())
        at_intervals = evaluations.started(settings, out, evaluate_every)
        start = training.start(), training.first()
        return _run(settings, out, training, *start, checkpoint_every, 0.0, at_intervals, observers)


def same_options(folder: Path, settings: Settings, stored: dict[str, Any]) -> None:
    """Refuses a configuration that is not the checkpoint's; only the number of episodes may grow."""
    now = json.loads(json.dumps(settings.flat()))
    meant = json.loads(json.dumps(before_there_was(now)))
    for name in ("arm", "demonstrations", "encoder", "warm_map"):
        if now.get(f"{name}_sha256"):
            del now[name]  # where files lie does not count, what they hold does
    for name, value in now.items():
        if name != "episodes" and stored.get(name, meant[name]) != value:
            raise ConfigError(
                f"{folder / run_folder.CONFIG}: {name} must be {stored.get(name)!r} as in the checkpoint, got {value!r}"
            )


def resume(
    folder: Path,
    episodes: int | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    warn: Callable[[str], None] = lambda _: None,
    process: Process = processes.ALONE,
    observers: Callable[[], Sequence[Observer]] = tuple,
) -> dict[str, Any]:
    """Goes on with a run from its last checkpoint, or from its start if there is none yet.

    Args:
      folder: of the run.
      episodes: episodes a learner, if more than before are wanted.
      checkpoint_every: seconds between checkpoints.
      warn: told, in a line each and before training, what is not as it was.
      process: this process among those that share the run.
      observers: gives who is told of each chunk, once it is clear that training goes on.

    Returns:
      The summary.

    Raises:
      ConfigError: the folder holds no run, is in use, or its configuration is not that of its checkpoint.
      DamagedError: the run's files cannot be read; nothing was changed.
      StoppedError: a signal asked for a stop.
      WriteError: the folder could not be written any more.
    """
    settings = run_folder.load(folder)  # refuses what is no run before a lock is put there
    randomness.check(folder)
    if process.count > 1:
        if episodes is not None:
            raise ConfigError("num_processes: must be 1 to make a run longer")
        with run_folder.locked(folder) if process.index == 0 else contextlib.nullcontext(), writing(folder):
            return _shared(settings, folder, checkpoint_every, warn, process)
    with run_folder.locked(folder):
        settings = run_folder.load(folder)
        begun = _processes(folder)
        if begun not in (None, 1):
            raise ConfigError(f"num_processes: must be {begun} as when the run began (and --coordinator, --process-id)")
        if episodes is not None:
            if episodes < settings.run.episodes:
                had = settings.run.episodes
                raise ConfigError(f"episodes: must be at least {had}, what the run has, got {episodes}")
            settings = resolve(**settings.flat() | {"episodes": episodes})
        training = Training.of_run(settings)
        found, problems = session.latest(folder, training, functools.partial(same_options, folder, settings))
        saved, progress = found or (None, training.first())
        warnings = [f"{problem}; resumed from the checkpoint before" for problem in problems]
        if saved is not None and training.is_over(progress):
            finished = ended(folder, settings)
            if finished is not None:
                for line in [*warnings, "the run has finished already; --episodes makes it longer"]:
                    warn(line)
                return finished
        facts = randomness.platform_facts()
        changes = run_folder.platform_changes(folder, facts)
        if changes:
            warnings.append(f"bits may differ in the last digits from an uninterrupted run: {', '.join(changes)}")
        for line in warnings:
            warn(line)
        done = progress.episodes_done
        _cut_back(folder, settings, saved, done)
        with writing(folder):
            run_folder.record(
                folder, "resumed", episodes_done=int(done.sum()), changes=changes, warnings=warnings, platform=facts
            )
            at_intervals = evaluations.resumed(settings, folder, saved.lanes if saved else None)
        seconds = float(saved.meta["seconds"]) if saved else 0.0
        lanes = training.place(saved.lanes) if saved else training.start()
        return _run(settings, folder, training, lanes, progress, checkpoint_every, seconds, at_intervals, observers())


def ended(folder: Path, settings: Settings) -> dict[str, Any] | None:
    """The summary of a run that has ended and of which everything is written; None where something is missing.

    Args:
      folder: of the run.
      settings: of the run, with the episodes that it is to have.
    """
    try:
        written = stored_summary.read(folder, settings)
    except DamagedError:  # it is written anew
        return None
    over = run_folder.read_json(folder / run_folder.STATUS).get("state") in ("finished", "failed")
    as_asked = written is not None and written["episodes"] == settings.run.episodes
    return written if over and as_asked and not Store(folder).has_parts() else None


def _cut_back(folder: Path, settings: Settings, saved: Checkpoint | None, done: np.ndarray) -> None:
    """Makes the folder what it was at the checkpoint: settings, records, and no newer checkpoint.

    Raises:
      ConfigError: this user may not write there.
      WriteError: the disk is full.
    """
    try:
        with writing(folder):
            run_folder.write_config(folder, settings)
            for name in (run_folder.SUMMARY, run_folder.REPORT):
                (folder / name).unlink(missing_ok=True)  # of an end that is one no more
            Store(folder).compact(done)
            session.set_aside(folder, saved)
    except WriteError as error:
        if isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            raise ConfigError(f"run: cannot write to {folder}: {error.__cause__.strerror}") from error
        raise
