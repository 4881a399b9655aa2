"""Curves for TensorBoard: each seed's and their mean, a point a chunk. Optional extra `tensorboard`."""

import time
from pathlib import Path

import numpy as np

from icac_jax.fields import ConfigError
from icac_jax.runs.loop import Chunk

try:
    from tensorboardX.event_file_writer import EventsWriter
    from tensorboardX.proto.event_pb2 import Event, SessionLog  # pyright: ignore[reportAttributeAccessIssue]
    from tensorboardX.summary import scalar
except ImportError as error:
    raise ConfigError("tensorboard: needs the extra, pip install 'icac_jax[tensorboard]'") from error


class Curves:
    """Writes success, steps and intrinsic reward over episodes, in this thread: a full disk is seen where it happens.

    Args:
      folder: where the event files go.
      done: most episodes a seed has finished; later points of an earlier session are dropped.

    Raises:
      OSError: from any method, when the folder cannot be written.
    """

    def __init__(self, folder: Path, done: int) -> None:
        folder.mkdir(exist_ok=True)
        self.writer = EventsWriter(str(folder / "events"))
        if done:
            self._write(Event(step=done, session_log=SessionLog(status=SessionLog.START)))

    def _write(self, event: Event) -> None:
        event.wall_time = time.time()
        self.writer.write_event(event)

    def add(self, chunk: Chunk) -> None:
        """Adds the means over the episodes that ended in the chunk."""
        seeds = chunk.table["seed"].to_numpy()
        for curve, column in (("success", "reached"), ("steps", "steps"), ("intrinsic_reward", "intrinsic_reward")):
            if column not in chunk.table.column_names:
                continue  # of a learner without curiosity
            values = chunk.table[column].to_numpy().astype(float)
            means = {f"seed {seed}": (values[seeds == seed], chunk.episodes_done[seed]) for seed in np.unique(seeds)}
            if len(values):
                means["mean"] = (values, chunk.episodes_done.mean())
            for name, (some, at) in means.items():
                self._write(Event(step=int(at), summary=scalar(f"{curve}/{name}", float(some.mean()))))
        self.writer.flush()

    def close(self) -> None:
        """Flushes what was added."""
        self.writer.close()
