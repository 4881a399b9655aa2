"""Curves for TensorBoard: each seed's and their mean, a point a chunk. Optional extra `tensorboard`."""

from pathlib import Path

import numpy as np

from icac_jax.config import ConfigError
from icac_jax.experiment.training import Chunk

try:
    from tensorboardX import SummaryWriter
except ImportError as error:
    raise ConfigError("tensorboard: needs the extra, pip install 'icac_jax[tensorboard]'") from error


class Curves:
    """Writes success, steps and intrinsic reward over episodes.

    Args:
      folder: where the event files go.
      done: most episodes a seed has finished; later points of an earlier session are dropped.
    """

    def __init__(self, folder: Path, done: int) -> None:
        self.writer = SummaryWriter(str(folder), purge_step=done or None)

    def add(self, chunk: Chunk) -> None:
        """Adds the means over the episodes that ended in the chunk."""
        seeds = chunk.table["seed"].to_numpy()
        for curve, column in (("success", "reached"), ("steps", "steps"), ("intrinsic_reward", "intrinsic_reward")):
            values = chunk.table[column].to_numpy().astype(float)
            for seed in np.unique(seeds):
                at = int(chunk.episodes_done[seed])
                self.writer.add_scalar(f"{curve}/seed {seed}", values[seeds == seed].mean(), at)
            if len(values):
                self.writer.add_scalar(f"{curve}/mean", values.mean(), int(chunk.episodes_done.mean()))

    def close(self) -> None:
        """Flushes what was added."""
        self.writer.close()
