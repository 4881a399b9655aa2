"""Trackers by name: TensorBoard, Weights & Biases, MLflow, a CSV file. Each is an `Observer`.

The module of each but the last needs its extra. `tracking.json` in the folder of a run says which ones it has, so that
a resumed run goes on with them.
"""

import importlib
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from icac_jax.errors import ConfigError
from icac_jax.runs import files
from icac_jax.runs import folder as run_folder
from icac_jax.runs.observers import Observer, Run, Told

FILE = "tracking.json"
# Name of each tracker: its module here, its class, and whether what it cannot send stops a training.
TRACKERS = {
    "tensorboard": ("tensorboard", "TensorBoard", True),
    "wandb": ("wandb", "WandB", False),
    "mlflow": ("mlflow", "MLflow", False),
    "csv": ("csv", "CSV", True),
}


def names_of(text: str) -> list[str]:
    """The trackers that an option names, such as "tensorboard,wandb".

    Raises:
      ConfigError: one of them is not known.
    """
    names = [name.strip() for name in text.split(",") if name.strip()]
    for name in names:
        if name not in TRACKERS:
            raise ConfigError(f"track: must be some of {', '.join(TRACKERS)} with commas, got {name!r}")
    return list(dict.fromkeys(names))


def trackers(names: Sequence[str], warn: Callable[[str], None] = lambda _: None) -> list[Observer]:
    """The trackers of these names; their extras are looked for now.

    Args:
      names: of trackers.
      warn: told, in a line, of one that could not send something; it is left out from there on.

    Raises:
      ConfigError: there is no such tracker, or its extra is missing.
    """
    found: list[Observer] = []
    for name in names:
        module, kind, stops = TRACKERS[names_of(name)[0]]
        tracker = getattr(importlib.import_module(f"icac_jax.tracking.{module}"), kind)()
        found.append(tracker if stops else _Lenient(tracker, name, warn))
    return found


def of_run(folder: Path, warn: Callable[[str], None] = lambda _: None) -> list[Observer]:
    """The trackers that a run was begun with."""
    names = [name for name in remembered(folder) if name in TRACKERS]
    if (folder / run_folder.TENSORBOARD).is_dir() and "tensorboard" not in names:  # of an earlier version
        names.append("tensorboard")
    return trackers(names, warn)


def remembered(folder: Path) -> dict[str, Any]:
    """What trackers know a run by, by their names; empty where it has none."""
    return run_folder.read_json(folder / FILE)


def remember(folder: Path | None, name: str, known_by: str | None = None) -> None:
    """Writes into a run's folder that it has this tracker.

    Args:
      folder: of the run; without one nothing is written.
      name: of the tracker.
      known_by: what the tracker knows the run by.
    """
    if folder is not None:
        files.write_text(folder / FILE, json.dumps(remembered(folder) | {name: known_by}) + "\n")


class _Lenient(Observer):
    """A tracker whose server may be away: what goes wrong there is said once, and the training goes on."""

    def __init__(self, tracker: Observer, name: str, warn: Callable[[str], None]) -> None:
        self._tracker: Observer | None = tracker
        self._name, self._warn = name, warn

    def _do(self, method: str, argument: Any) -> None:
        if self._tracker is None:
            return
        try:
            getattr(self._tracker, method)(argument)
        except ConfigError:
            raise
        except Exception as error:  # of a client, a server, a network
            self._tracker = None
            reason = str(error).partition("\n")[0] or type(error).__name__
            self._warn(f"track: {self._name} gets nothing more of this run ({reason})")

    def start(self, run: Run) -> None:
        """Begins, as the tracker does."""
        self._do("start", run)

    def see(self, told: Told) -> None:
        """Passes on what a chunk tells."""
        self._do("see", told)

    def end(self, summary: dict[str, Any] | None) -> None:
        """Ends, as the tracker does."""
        self._do("end", summary)
