"""Curves for TensorBoard: a point per chunk, and the options. Optional extra `tensorboard`."""

import math
import time
from pathlib import Path
from typing import Any

from icac_jax import tracking
from icac_jax.fields import ConfigError
from icac_jax.runs import folder as run_folder
from icac_jax.runs.observers import Observer, Run, Told

try:
    from tensorboardX.event_file_writer import EventsWriter
    from tensorboardX.proto.event_pb2 import Event, SessionLog  # pyright: ignore[reportAttributeAccessIssue]
    from tensorboardX.summary import hparams, scalar
except ImportError as error:
    raise ConfigError("tensorboard: needs the extra, pip install 'icac_jax[tensorboard]'") from error

_COUNTED = ("episodes", "lane_steps", "lane_steps_per_second", "diverged")


class TensorBoard(Observer):
    """Writes over episodes, in this thread: a full disk is seen where it happens.

    `success/mean`, `success/seed_3` and their like for every column of the record;
    `speed/lane_steps_per_second` and the other counts; the options on the page HPARAMS.

    Args:
      folder: where the event files go; `tensorboard/` in the run's folder by default.
    """

    def __init__(self, folder: str | Path | None = None) -> None:
        self._folder = None if folder is None else Path(folder)

    def start(self, run: Run) -> None:
        """Opens the event file and writes the options."""
        if self._folder is None:
            if run.folder is None:
                raise ConfigError("folder: must be given to TensorBoard where the run has none (out)")
            self._folder = run.folder / run_folder.TENSORBOARD
        tracking.remember(run.folder, "tensorboard")
        self._folder.mkdir(parents=True, exist_ok=True)
        self._writer = EventsWriter(str(self._folder / "events"))
        if run.episodes_done:  # later points of an earlier session are dropped
            self._write(Event(step=run.episodes_done, session_log=SessionLog(status=SessionLog.START)))
        else:
            options = {name: _option(value) for name, value in run.options.items()}
            for summary in hparams(options, {"success/mean": 0.0}):
                self._write(Event(summary=summary))
        self._writer.flush()

    def _write(self, event: Event) -> None:
        event.wall_time = time.time()
        self._writer.write_event(event)

    def see(self, told: Told) -> None:
        """Writes a point per seed and for their mean."""
        done = told.chunk.episodes_done
        for name, means in told.by_seed.items():
            for seed, mean in means.items():
                self._write(Event(step=int(done[seed]), summary=scalar(f"{name}/seed_{seed}", mean)))
        for name, value in told.scalars.items():
            tag = f"speed/{name}" if name in _COUNTED else f"{name}/mean"
            self._write(Event(step=int(told.episode), summary=scalar(tag, value)))
        self._writer.flush()

    def end(self, summary: dict[str, Any] | None) -> None:
        """Closes the event file."""
        self._writer.close()


def _option(value: Any) -> Any:
    """A value as TensorBoard's table of options takes it."""
    return value if isinstance(value, int | float) and math.isfinite(value) else str(value)
