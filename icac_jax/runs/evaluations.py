"""`icac train --evaluate-every N`: the policies without exploration at intervals, while they are learning.

Evaluating reads the learners and changes nothing in them: a run has the same records to the bit with and without it.
Each seed's best policy so far is kept.
"""

import contextlib
import json
from pathlib import Path
from typing import Any, TypeGuard

import jax
import numpy as np

from icac_jax import reading
from icac_jax.rollout import LaneState
from icac_jax.runs import best_policies, files, trials
from icac_jax.runs import folder as run_folder
from icac_jax.runs.loop import Chunk
from icac_jax.settings.options import Settings
from icac_jax.settings.worlds import need_arm

FILE = "evaluations.jsonl"
# Of the pairs that `icac evaluate` uses.
PAIRS = 100
_EVENT_KEY = "evaluate_every"


class Evaluations:
    """Writes a row a seed whenever the slowest running seed has passed another `every` episodes.

    A row holds `passed` (the multiple of `every` that the slowest seed passed), `seed`, `episode` (episodes that this
    seed had finished), `success_rate`, `steps` (a failure counts as the horizon), `final_distance` in m and `every`.

    Args:
      settings: of the run.
      folder: of the run.
      every: episodes between evaluations.
      lanes: the state that training goes on from, or None at its start; rows of later states are dropped.

    Raises:
      OSError: from any method, when the folder cannot be written.
    """

    def __init__(self, settings: Settings, folder: Path, every: int, lanes: LaneState | None = None) -> None:
        need_arm(settings, "evaluate_every", "an evaluation")
        self.every, self.settings, self.path = every, settings, folder / FILE
        self.play = trials.player(settings, PAIRS, seed=0)
        self.passed, self.best = 0, None
        if lanes is not None:
            seeds = settings.run.seeds
            self.passed = self._passed(np.asarray(lanes.episode)[:seeds], np.asarray(lanes.failed)[:seeds])
            # It may be of an evaluation that was made after the checkpoint: it will be made again, and be equal.
            self.best = best_policies.read(folder, settings, self._learners(lanes))
        if self.path.exists():
            over = lanes is not None and bool(np.all(np.asarray(lanes.failed)[: settings.run.seeds]))
            kept = [json.dumps(row) + "\n" for row in read(folder) if over or row["passed"] <= self.passed]
            files.write_text(self.path, "".join(kept))

    def _learners(self, lanes: LaneState) -> Any:
        """The states of the learners, leaves [S, ...] on the host."""
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: self.settings.run.seeds], lanes.agent)

    def _passed(self, done: np.ndarray, failed: np.ndarray) -> int:
        """The multiple of `every` that the slowest running seed has passed; as before where none is running."""
        running = done[~failed]
        return int(running.min()) // self.every * self.every if running.size else self.passed

    def see(self, chunk: Chunk) -> None:
        """Evaluates if it is time to. To be called before the chunk is saved, so that no row is lost by stopping."""
        passed = self._passed(chunk.episodes_done, chunk.failed)
        if passed <= self.passed:
            return
        self.passed = passed
        learners = self._learners(chunk.lanes)
        played = self.play(learners)
        distance = trials.final_distance(self.settings, played).mean(axis=1)
        rows = [
            {
                "passed": passed,
                "seed": int(seed),
                "episode": int(chunk.episodes_done[seed]),
                "success_rate": float(played.reached[seed].mean()),
                "steps": float(played.steps[seed].mean()),
                "final_distance": float(distance[seed]),
                "every": self.every,
            }
            for seed in np.flatnonzero(~chunk.failed)
        ]
        files.append_line(self.path, "\n".join(map(json.dumps, rows)))
        success_rate = np.where(chunk.failed, np.nan, played.reached.mean(axis=1))
        steps, episodes = np.asarray(played.steps).mean(axis=1), np.asarray(chunk.episodes_done, np.int64)
        parts = best_policies.acting(self.settings, learners)
        self.best = best_policies.better(self.best, success_rate, steps, episodes, parts)
        best_policies.save(self.path.parent, self.best)


def started(settings: Settings, folder: Path, every: int) -> Evaluations | None:
    """Evaluations of a run that starts, or None if none are wanted."""
    if every == 0:
        return None
    run_folder.record(folder, "evaluations", **{_EVENT_KEY: every})
    return Evaluations(settings, folder, every)


def resumed(settings: Settings, folder: Path, lanes: LaneState | None) -> Evaluations | None:
    """Evaluations of a run that goes on from `lanes`, as they were asked for at its start.

    The history says how often; where it was lost, the rows so far do.
    """
    said = [event.get(_EVENT_KEY) for event in run_folder.history(folder)]
    said += [row.get("every") for row in read(folder)[-1:]] if not any(map(_is_interval, said)) else []
    asked = [every for every in said if _is_interval(every)]
    return Evaluations(settings, folder, asked[-1], lanes) if asked else None


def _is_interval(every: Any) -> TypeGuard[int]:
    return isinstance(every, int) and not isinstance(every, bool) and 1 <= every <= 10**9


def read(folder: Path) -> list[dict[str, Any]]:
    """The rows of a run in the order of writing; a line that a kill cut short is left out."""
    rows = []
    with contextlib.suppress(FileNotFoundError):
        rows += reading.json_lines(folder / FILE)
    return [row for row in rows if isinstance(row.get("passed"), int)]
