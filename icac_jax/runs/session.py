"""Training in a folder: checkpoints at intervals, stopping politely, a disk that cannot be written."""

import contextlib
import dataclasses
import json
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from icac_jax.errors import DamagedError, StoppedError, WriteError
from icac_jax.rollout import LaneState
from icac_jax.runs import checkpoints, files
from icac_jax.runs import folder as run_folder
from icac_jax.runs.checkpoints import Checkpoint
from icac_jax.runs.loop import Chunk, Progress, Training
from icac_jax.runs.progress import Reporter
from icac_jax.runs.shares import Share
from icac_jax.runs.signals import StopRequest
from icac_jax.runs.store import Store

_RECENT = 100
_ATTEMPTS = 10


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turns a disk that cannot be written into one line that says how to go on."""
    try:
        yield
    except OSError as error:
        message = (
            f"cannot write {error.filename or folder}: {error.strerror or error}; stopped at the last checkpoint, "
            f"make room and resume with: icac resume {folder}"
        )
        run_folder.note(folder, message)
        raise WriteError(message) from error


def write_status(folder: Path, state: str, episodes_done: int, episodes: int, note: str = "") -> None:
    """Writes how far a run or a sweep is, for `icac runs`.

    Args:
      folder: of the run or the sweep.
      state: running, stopped, finished or failed.
      episodes_done: episodes finished so far, over all learners.
      episodes: all that there will be.
      note: the latest figure in words.
    """
    facts = {"state": state, "episodes_done": episodes_done, "episodes": episodes, "note": note}
    files.write_text(folder / run_folder.STATUS, json.dumps(facts) + "\n")


@dataclasses.dataclass
class Session:
    """A training that goes on in a folder.

    Attributes:
      training: the compiled program, its jobs and its devices.
      folder: where records and checkpoints lie.
      home: the folder that `icac resume` takes; `folder` itself, or the one around it.
      title: what is running, for the progress display.
      options: what a checkpoint says that it is of.
      checkpoint_every: seconds between checkpoints.
      seconds: time spent training before this session.
      before: episodes that were finished elsewhere in the same home.
      total: episodes of the whole home.
      observers: called with each chunk.
      share: this process's part in work that it shares with others, None where it works alone.
    """

    training: Training
    folder: Path
    home: Path
    title: str
    options: dict[str, Any]
    checkpoint_every: float
    seconds: float = 0.0
    before: int = 0
    total: int = 0
    observers: tuple[Callable[[Chunk], None], ...] = ()
    share: Share | None = None

    def __post_init__(self) -> None:
        self.store = Store(self.folder)
        self.total = self.total or int(self.training.episodes.sum())

    def _status(self, state: str, chunk: Chunk, note: str) -> None:
        self._say(state, int(chunk.episodes_done.sum()), note)

    def _say(self, state: str, own: int, note: str) -> None:
        """Writes how far this process is, and how far all are if that is its part."""
        if self.share is not None:
            write_status(self.share.folder, state, own, int(self.training.episodes.sum()), note)
        if self.share is None or self.share.leads:
            write_status(self.home, state, self._all(own), self.total, note)

    def _all(self, own: int) -> int:
        """Episodes of the whole home, of which this process has finished so many in this session's jobs."""
        return self.before + own + (self.share.elsewhere() if self.share else 0)

    def _done(self, chunk: Chunk) -> int:
        return self._all(int(chunk.episodes_done.sum()))

    def _save(self, chunk: Chunk, note: str) -> None:
        """Records first, then the checkpoint that counts them: a kill in between loses neither."""
        self.store.flush()
        meta = {"seconds": self.seconds + chunk.seconds, "options": self.options}
        meta |= _as_json(chunk.progress)
        checkpoints.save(self.folder / run_folder.CHECKPOINTS, chunk.lanes, meta, width=self.training.width)
        self._status("running", chunk, note)

    def run(self, lanes: LaneState, progress: Progress) -> tuple[Chunk, str]:
        """Trains until all jobs have ended, saving at intervals; then puts all records into one file.

        Returns:
          The last chunk, and the latest figure in words.

        Raises:
          StoppedError: a signal asked for a stop; everything is saved.
          OSError: the folder cannot be written any more.
        """
        with StopRequest() as stop:
            return self._run(lanes, progress, stop)

    def _run(self, lanes: LaneState, progress: Progress, stop: StopRequest) -> tuple[Chunk, str]:
        recent: dict[int, deque[float]] = {}
        # A world that has no goal has no success.
        told = "extrinsic_reward" if self.training.env.goal is None else "reached"
        chunk, note = None, "starting"
        own = int(progress.episodes_done.sum())
        self._say("running", own, note)
        with Reporter(self.title, self.total, self._all(own)) as reporter:
            saved = time.monotonic()
            for chunk in self.training.chunks(lanes, progress):
                self.store.add(chunk.table)
                for observe in self.observers:
                    observe(chunk)
                for job, value in zip(*(chunk.table[name].to_pylist() for name in ("seed", told)), strict=True):
                    recent.setdefault(job, deque(maxlen=_RECENT)).append(value)
                # By learner first: late in a run most new episodes are those of the slowest.
                rates = [np.mean(mine) for mine in recent.values()]
                if rates:
                    mean = float(np.mean(rates))
                    shown = f"success {mean:.0%}" if told == "reached" else f"return {mean:,.1f}"
                    note = f"{shown} in each seed's last {_RECENT}"
                if stop.signal is not None and not self.training.is_over(chunk.progress):
                    self._stop(chunk, note, stop.signal)
                reporter.update(self._done(chunk), chunk.seconds, note)
                if time.monotonic() - saved >= self.checkpoint_every:
                    self._save(chunk, note)
                    saved = time.monotonic()
        assert chunk is not None
        self._save(chunk, note)
        self.store.compact(chunk.episodes_done)
        return chunk, note

    def _stop(self, chunk: Chunk, note: str, asked: signal.Signals) -> None:
        self._save(chunk, note)
        self.store.compact(chunk.episodes_done)
        self._status("stopped", chunk, note)
        where = self.home if self.share is None or self.share.leads else self.share.folder
        run_folder.record(where, "stopped", signal=asked.name, episodes_done=self._done(chunk))
        raise StoppedError(f"stopped and saved; resume with: icac resume {self.home}", asked)


def latest(
    folder: Path, training: Training, check: Callable[[dict[str, Any]], None], records: bool = True
) -> tuple[tuple[Checkpoint, Progress] | None, list[str]]:
    """The newest checkpoint in a folder that can be read, and what was wrong with newer ones.

    Args:
      folder: where records and checkpoints lie.
      training: of the same jobs.
      check: refuses a checkpoint of other options.
      records: whether all episodes that it counts must be there too.

    Returns:
      The checkpoint and how far its jobs were, None where there is none yet; the problems of newer ones.

    Raises:
      DamagedError: there are checkpoints and none can be used, or there is none though training had gone on.
    """
    template = training.fresh()
    attempts = 0
    while True:
        found = checkpoints.listed(folder / run_folder.CHECKPOINTS)
        read, problems = _first_readable(folder, found, template, training, check, records)
        attempts += 1
        # A run that is going on removes old checkpoints while another process, such as `icac evaluate`, reads them.
        if attempts == _ATTEMPTS or all(path.exists() for path in found):
            break
    if read is not None:
        return read, problems
    if found:
        raise DamagedError(problems[0])
    if records and Store(folder).holds_something():
        raise DamagedError(f"{folder / run_folder.CHECKPOINTS}: no checkpoint is left to go on from")
    return None, problems


def _first_readable(
    folder: Path,
    found: list[Path],
    template: LaneState,
    training: Training,
    check: Callable[[dict[str, Any]], None],
    records: bool,
) -> tuple[tuple[Checkpoint, Progress] | None, list[str]]:
    """The newest of the checkpoints that can be read, and what was wrong with newer ones; see `latest`."""
    problems: list[str] = []
    for path in reversed(found):
        try:
            meta = checkpoints.read_meta(path)
            check(meta["options"])
            saved = checkpoints.load(path, template, training.width)
            progress = _from_json(meta, saved, training)
            if records:
                Store(folder).check(progress.episodes_done)
        except DamagedError as error:
            problems.append(str(error))
            continue
        return (saved, progress), problems
    return None, problems


def set_aside(folder: Path, saved: Checkpoint | None) -> None:
    """Renames checkpoints newer than the one resumed from: unreadable, they would be taken for the newest again."""
    for path in checkpoints.listed(folder / run_folder.CHECKPOINTS):
        if saved is not None and checkpoints.number(path) > checkpoints.number(saved.path):
            path.rename(path.with_suffix(".damaged"))


_COUNTS = ("episodes_done", "failed", "steps")


def _as_json(progress: Progress) -> dict[str, Any]:
    """What of the progress the lanes do not say: nothing while every job has its lane from the beginning."""
    if progress.begun <= np.sum(progress.slots >= 0):
        return {}
    counts = {name: getattr(progress, name).astype(int).tolist() for name in _COUNTS}
    return {"progress": {"slots": progress.slots.tolist(), "begun": progress.begun, **counts}}


def _from_json(meta: dict[str, Any], saved: Checkpoint, training: Training) -> Progress:
    """The progress of a checkpoint.

    Raises:
      DamagedError: it is not one of these jobs.
    """
    start = training.first()
    if "progress" not in meta:
        return training.reached(saved.lanes)
    try:
        stored = meta["progress"]
        slots = np.full_like(start.slots, -1)
        held = np.array(stored["slots"], np.int32)[: training.width]
        slots[: len(held)] = held
        counts = {name: np.array(stored[name], getattr(start, name).dtype) for name in _COUNTS}
        progress = Progress(slots=slots, begun=int(stored["begun"]), **counts)
        jobs = len(training.jobs)
        if any(len(values) != jobs for values in counts.values()) or not training.width <= progress.begun <= jobs:
            raise ValueError("other jobs than expected")
        if len(held) != training.width or held.min() < 0 or held.max() >= progress.begun:
            raise ValueError("lanes of no job")
        going_on = np.arange(jobs) < progress.begun
        going_on &= ~progress.failed & (progress.episodes_done < training.episodes)
        if not np.isin(np.flatnonzero(going_on), held).all():
            raise ValueError("jobs without their lanes")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise DamagedError(f"{saved.path}: not a checkpoint of this run ({error})") from error
    return progress
