"""What an observer of a training is, and what each chunk tells it.

An observer is an object with the methods of `Observer`, or a function that is called with each `Chunk`. What it
does changes nothing in the training, whose records are the same to the bit with and without it.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from icac_jax.runs.loop import Chunk

# What observers call a column of the record that has a better name.
_NAMES = {"reached": "success"}
_NO_FIGURE = ("seed", "episode")


class Run(NamedTuple):
    """What is about to be trained.

    Attributes:
      title: in a few words, such as "icac planar2".
      options: every option by name; numbers that are arrays over learners are lists.
      folder: where the run is kept, or None.
      episodes: of all learners together.
      episodes_done: of the learner that is furthest, from before; 0 unless a run goes on.
      lane_steps_done: of all learners together, from before; 0 unless a run goes on.
    """

    title: str
    options: dict[str, Any]
    folder: Path | None
    episodes: int
    episodes_done: int = 0
    lane_steps_done: int = 0


class Told(NamedTuple):
    """What a chunk tells.

    Attributes:
      chunk: lanes, progress, table of the episodes that ended.
      episode: mean number of episodes that the learners have finished.
      scalars: by name, means over the episodes that ended in the chunk: `success`, `steps`, `extrinsic_reward`, and
        every column that the learner reports (sums over an episode such as `intrinsic_reward` and `critic_loss`,
        states at its end such as `live_nodes`); nothing of these where no episode ended. Always there: `episodes` of
        all learners so far, `lane_steps` so far, `lane_steps_per_second` of the chunk, `diverged` learners so far.
      by_seed: the means of each seed whose episodes ended, by the same names, then by seed.
    """

    chunk: Chunk
    episode: float
    scalars: dict[str, float]
    by_seed: dict[str, dict[int, float]]


class Observer:
    """Watches a training; a subclass overrides what it wants to know.

    An exception from any method ends the training; `OSError` is taken for a run folder that cannot be written.
    """

    def start(self, run: Run) -> None:
        """Before the first chunk."""

    def see(self, told: Told) -> None:
        """After each chunk."""

    def end(self, summary: dict[str, Any] | None) -> None:
        """After the last chunk.

        Args:
          summary: of the run, as `summary.json` holds it; None where it was stopped or is kept in no folder.
        """


class _Called(Observer):
    """A function that takes chunks, as an observer."""

    def __init__(self, function: Callable[[Chunk], None]) -> None:
        self._function = function

    def see(self, told: Told) -> None:
        self._function(told.chunk)


def _observer(one: Any) -> Observer:
    return one if hasattr(one, "see") else _Called(one)


class Observers:
    """Several observers, to which a training tells its chunks.

    Args:
      observers: objects, or functions that take a `Chunk`.
      run: what is trained.
    """

    def __init__(self, observers: Sequence[Observer | Callable[[Chunk], None]], run: Run) -> None:
        self._all: list[Observer] = [_observer(one) for one in observers]
        self._wanted = any(not isinstance(one, _Called) for one in self._all)
        self._steps, self._seconds = run.lane_steps_done, 0.0
        for one in self._all:
            one.start(run)

    def see(self, chunk: Chunk) -> None:
        """Tells all of them about a chunk."""
        if not self._all:
            return
        told = tell(chunk, self._steps, self._seconds) if self._wanted else Told(chunk, 0.0, {}, {})
        self._steps, self._seconds = chunk.lane_steps, chunk.seconds
        for one in self._all:
            one.see(told)

    def end(self, summary: dict[str, Any] | None) -> None:
        """Tells all of them that it is over."""
        for one in self._all:
            one.end(summary)


def tell(chunk: Chunk, steps: int = 0, seconds: float = 0.0) -> Told:
    """What a chunk tells.

    Args:
      chunk: the chunk.
      steps: lane-steps before it.
      seconds: of training before it.
    """
    scalars: dict[str, float] = {}
    by_seed: dict[str, dict[int, float]] = {}
    seeds = chunk.table["seed"].to_numpy()
    if len(seeds):
        known, place = np.unique(seeds, return_inverse=True)
        number = np.bincount(place)
        for column in map(str, chunk.table.column_names):
            if column not in _NO_FIGURE:
                values, name = chunk.table[column].to_numpy().astype(float), _NAMES.get(column, column)
                scalars[name] = float(values.mean())
                means = np.bincount(place, values) / number
                by_seed[name] = {int(seed): float(mean) for seed, mean in zip(known, means, strict=True)}
    spent = chunk.seconds - seconds
    scalars |= {
        "episodes": float(chunk.episodes_done.sum()),
        "lane_steps": float(chunk.lane_steps),
        "lane_steps_per_second": (chunk.lane_steps - steps) / spent if spent > 0 else 0.0,
        "diverged": float(chunk.failed.sum()),
    }
    return Told(chunk, float(chunk.episodes_done.mean()), scalars, by_seed)
