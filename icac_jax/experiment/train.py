"""`icac train` and `icac resume`: a run from settings to a folder, and on from wherever it stopped."""

import contextlib
import dataclasses
import errno
import importlib
import json
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from icac_jax.config import ConfigError
from icac_jax.experiment import CHECKPOINT_EVERY, checkpoints, files, summary
from icac_jax.experiment import folder as run_folder
from icac_jax.experiment.checkpoints import Checkpoint, DamagedError
from icac_jax.experiment.progress import Reporter
from icac_jax.experiment.settings import OPTIONS, Settings, resolve
from icac_jax.experiment.signals import StopRequest
from icac_jax.experiment.store import Store
from icac_jax.experiment.training import Chunk, Training
from icac_jax.rollout import LaneState

_RECENT = 100
# Loaded only when asked for: it needs an optional extra.
_CURVES = "icac_jax.experiment.tensorboard"


class StoppedError(Exception):
    """The run was asked to stop and has saved everything; the message says how to go on.

    Attributes:
      signal: what asked for it.
    """

    def __init__(self, message: str, asked: signal.Signals) -> None:
        super().__init__(message)
        self.signal = asked


class WriteError(Exception):
    """The run folder could not be written while running; the last checkpoint is intact. One line."""


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Turns a disk that cannot be written into one line that says how to go on."""
    try:
        yield
    except OSError as error:
        message = (
            f"cannot write {error.filename or folder}: {error.strerror or error}; stopped at the last checkpoint, "
            f"make room and go on with: icac resume {folder}"
        )
        run_folder.note(folder, message)
        raise WriteError(message) from error


@dataclasses.dataclass
class Session:
    """A run that is going on in its folder.

    Attributes:
      settings: of the run.
      folder: of the run.
      training: the compiled program and its devices.
      checkpoint_every: seconds between checkpoints.
      seconds: time spent training before this session.
      tensorboard: writer of curves, or None.
    """

    settings: Settings
    folder: Path
    training: Training
    checkpoint_every: float
    seconds: float = 0.0
    tensorboard: Any = None

    def __post_init__(self) -> None:
        self.store = Store(self.folder)

    def status(self, state: str, episodes_done: int, note: str = "") -> None:
        """Writes how far the run is, for `icac runs`."""
        run = self.settings.run
        facts = {
            "state": state,
            "episodes_done": episodes_done,
            "episodes": run.seeds * run.episodes,
            "note": note,
        }
        files.write_text(self.folder / run_folder.STATUS, json.dumps(facts) + "\n")

    def save(self, chunk: Chunk, note: str) -> None:
        """Records first, then the checkpoint that counts them: a kill in between loses neither."""
        self.store.flush()
        meta = {"seconds": self.seconds + chunk.seconds, "options": self.settings.flat()}
        checkpoints.save(self.folder / run_folder.CHECKPOINTS, chunk.lanes, meta)
        self.status("running", int(chunk.episodes_done.sum()), note)

    def run(self, lanes: LaneState, done_before: int) -> dict[str, Any]:
        """Trains until all lanes have finished, saving at intervals; returns the summary.

        Raises:
          StoppedError: a signal asked for a stop; everything is saved.
          WriteError: the disk is full or the folder cannot be written any more.
        """
        with _writing(self.folder), StopRequest() as stop:
            return self._run(lanes, done_before, stop)

    def _run(self, lanes: LaneState, done_before: int, stop: StopRequest) -> dict[str, Any]:
        run = self.settings.run
        recent = [deque[bool](maxlen=_RECENT) for _ in range(run.seeds)]
        chunk, note = None, "starting"
        self.status("running", done_before, note)
        with Reporter(
            f"{self.settings.spec.algo} {self.settings.arm.name}", run.seeds * run.episodes, done_before
        ) as reporter:
            saved = time.monotonic()
            for chunk in self.training.chunks(lanes):
                self.store.add(chunk.table)
                if self.tensorboard is not None:
                    self.tensorboard.add(chunk)
                for seed, reached in zip(*(chunk.table[name].to_pylist() for name in ("seed", "reached")), strict=True):
                    recent[seed].append(reached)
                # By seed first: late in a run most new episodes are those of the slowest seeds.
                rates = [np.mean(mine) for mine in recent if mine]
                note = f"success {np.mean(rates):.0%} in each seed's last {_RECENT}" if rates else note
                if stop.signal is not None and not self.training.is_over(chunk):
                    self._stop(chunk, note, stop.signal)
                reporter.update(int(chunk.episodes_done.sum()), chunk.seconds, note)
                if time.monotonic() - saved >= self.checkpoint_every:
                    self.save(chunk, note)
                    saved = time.monotonic()
        assert chunk is not None
        return self._finish(chunk, note)

    def _stop(self, chunk: Chunk, note: str, asked: signal.Signals) -> None:
        self.save(chunk, note)
        self.store.compact(chunk.episodes_done)
        self.status("stopped", int(chunk.episodes_done.sum()), note)
        run_folder.record(self.folder, "stopped", signal=asked.name, episodes_done=int(chunk.episodes_done.sum()))
        raise StoppedError(f"stopped and saved; go on with: icac resume {self.folder}", asked)

    def _finish(self, chunk: Chunk, note: str) -> dict[str, Any]:
        self.save(chunk, note)
        table = self.store.compact(chunk.episodes_done)
        failed = {int(seed): int(chunk.episodes_done[seed]) for seed in np.flatnonzero(chunk.failed)}
        overflow = self.training.overflow(chunk.lanes)
        seconds = self.seconds + chunk.seconds
        result = summary.summarise(self.settings, table, failed, overflow, chunk.lane_steps, seconds)
        files.write_text(self.folder / run_folder.SUMMARY, json.dumps(result, indent=2) + "\n")
        self.status("failed" if chunk.failed.all() else "finished", int(chunk.episodes_done.sum()), note)
        run_folder.record(self.folder, "finished", failed_seeds=sorted(failed))
        if self.tensorboard is not None:
            self.tensorboard.close()
        return result


def _curves(folder: Path, wanted: bool, done: int) -> Any:
    """A TensorBoard writer if one is wanted, or was in the run so far."""
    path = folder / run_folder.TENSORBOARD
    if not wanted and not path.exists():
        return None
    return importlib.import_module(_CURVES).Curves(path, done)


def train(
    settings: Settings, out: Path, checkpoint_every: float = CHECKPOINT_EVERY, tensorboard: bool = False
) -> dict[str, Any]:
    """Trains and writes the run into `out`.

    Args:
      settings: of the run.
      out: a new or empty folder.
      checkpoint_every: seconds between checkpoints.
      tensorboard: write curves for TensorBoard too.

    Returns:
      The summary, as written to the folder.

    Raises:
      ConfigError: the folder cannot be used.
      StoppedError: a signal asked for a stop.
      WriteError: the folder could not be written any more.
    """
    if tensorboard:
        importlib.import_module(_CURVES)  # says what is missing before there is a folder
    training = Training(settings)
    with run_folder.created(out, settings), _writing(out):
        curves = _curves(out, tensorboard, 0)
        run_folder.record(out, "started", platform=run_folder.platform_facts())
        session = Session(settings, out, training, checkpoint_every, tensorboard=curves)
        return session.run(training.start(), 0)


def _latest(folder: Path, training: Training, settings: Settings) -> tuple[Checkpoint | None, list[str]]:
    """The newest checkpoint that can be read with all its records, and what was wrong with newer ones.

    Raises:
      ConfigError: the checkpoint is of other settings than the configuration says.
      DamagedError: there are checkpoints and none can be used, or there is none though the run had finished or stopped.
    """
    problems: list[str] = []
    found = checkpoints.listed(folder / run_folder.CHECKPOINTS)
    template = training.start()
    for path in reversed(found):
        try:
            same_options(folder, checkpoints.read_meta(path)["options"], settings)
            saved = checkpoints.load(path, template, settings.run.seeds)
            done = np.asarray(saved.lanes.episode)[: settings.run.seeds]
            Store(folder).table(done)
        except DamagedError as error:
            problems.append(str(error))
            continue
        return saved, problems
    if found:
        raise DamagedError(problems[0])
    if Store(folder).holds_something():
        raise DamagedError(f"{folder / run_folder.CHECKPOINTS}: no checkpoint is left to go on from")
    return None, problems


def same_options(folder: Path, stored: dict[str, Any], settings: Settings) -> None:
    """Refuses a configuration that is not the checkpoint's; only the number of episodes may grow."""
    now = json.loads(json.dumps(settings.flat()))
    for name, value in now.items():
        # An option that came with a later version had its default's effect before.
        if name != "episodes" and stored.get(name, OPTIONS[name].default) != value:
            raise ConfigError(
                f"{folder / run_folder.CONFIG}: {name} must be {stored.get(name)!r} as in the checkpoint, got {value!r}"
            )


def resume(
    folder: Path,
    episodes: int | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    warn: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Goes on with a run from its last checkpoint, or from its start if there is none yet.

    Args:
      folder: of the run.
      episodes: episodes a learner, if more than before are wanted.
      checkpoint_every: seconds between checkpoints.
      warn: told, in a line each and before training, what is not as it was.

    Returns:
      The summary.

    Raises:
      ConfigError: the folder holds no run, is in use, or its configuration is not that of its checkpoint.
      DamagedError: the run's files cannot be read; nothing was changed.
      StoppedError: a signal asked for a stop.
      WriteError: the folder could not be written any more.
    """
    run_folder.load(folder)  # refuses what is no run before a lock is put there
    with run_folder.locked(folder):
        settings = run_folder.load(folder)
        if episodes is not None:
            if episodes < settings.run.episodes:
                had = settings.run.episodes
                raise ConfigError(f"episodes: must be at least {had}, what the run has, got {episodes}")
            settings = resolve(**settings.flat() | {"episodes": episodes})
        training = Training(settings)
        saved, problems = _latest(folder, training, settings)
        warnings = [f"{problem}; gone on from the checkpoint before" for problem in problems]
        if saved is not None and training.has_finished(saved.lanes):
            summed_up = _summed_up(folder, settings)
            if summed_up is not None:
                for line in [*warnings, "the run has finished already; --episodes makes it longer"]:
                    warn(line)
                return summed_up
        facts = run_folder.platform_facts()
        changes = run_folder.platform_changes(folder, facts)
        if changes:
            warnings.append(f"bits may differ in the last digits from an uninterrupted run: {', '.join(changes)}")
        for line in warnings:
            warn(line)
        done = np.asarray(saved.lanes.episode)[: settings.run.seeds] if saved else np.zeros(settings.run.seeds, int)
        _cut_back(folder, settings, saved, done)
        with _writing(folder):
            run_folder.record(
                folder, "resumed", episodes_done=int(done.sum()), changes=changes, warnings=warnings, platform=facts
            )
            curves = _curves(folder, False, int(done.max()))
        seconds = float(saved.meta["seconds"]) if saved else 0.0
        session = Session(settings, folder, training, checkpoint_every, seconds, curves)
        return session.run(training.place(saved.lanes) if saved else training.start(), int(done.sum()))


def _summed_up(folder: Path, settings: Settings) -> dict[str, Any] | None:
    """The summary of a run whose lanes have finished, unless its end was interrupted before everything was written."""
    written = run_folder.read_json(folder / run_folder.SUMMARY)
    ended = run_folder.read_json(folder / run_folder.STATUS).get("state") in ("finished", "failed")
    as_asked = written.get("episodes") == settings.run.episodes
    return written if ended and as_asked and not Store(folder).has_parts() else None


def _cut_back(folder: Path, settings: Settings, saved: Checkpoint | None, done: np.ndarray) -> None:
    """Makes the folder what it was at the checkpoint: settings, records, and no newer checkpoint.

    Raises:
      ConfigError: this user may not write there.
      WriteError: the disk is full.
    """
    try:
        with _writing(folder):
            run_folder.write_config(folder, settings)
            Store(folder).compact(done)
            for path in checkpoints.listed(folder / run_folder.CHECKPOINTS):
                if saved is not None and path > saved.path:  # unreadable; it would be taken for the newest again
                    path.rename(path.with_suffix(".damaged"))
    except WriteError as error:
        if isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
            raise ConfigError(f"run: cannot write to {folder}: {error.__cause__.strerror}") from error
        raise
