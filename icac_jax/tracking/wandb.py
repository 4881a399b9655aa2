"""Weights & Biases: the options as its config, the scalars of each chunk, the summary. Optional extra `wandb`.

What W&B itself reads from the environment goes on to count: `WANDB_MODE=offline`, `WANDB_PROJECT`, `WANDB_ENTITY`.
"""

import os
import secrets
from typing import Any

from icac_jax import tracking
from icac_jax.fields import ConfigError
from icac_jax.runs.observers import Observer, Run, Told

try:
    import wandb  # pyright: ignore[reportMissingImports]
except ImportError as error:
    raise ConfigError("wandb: needs the extra, pip install 'icac_jax[wandb]'") from error

_PROJECT = "icac_jax"


class WandB(Observer):
    """Logs over lane-steps; a run that is resumed goes on in the same run of W&B.

    Args:
      **init: arguments of `wandb.init` that differ from the ones chosen here.
    """

    def __init__(self, **init: Any) -> None:
        self._init = init

    def start(self, run: Run) -> None:
        """Begins the run of W&B, or goes on with it."""
        known_by = tracking.remembered(run.folder).get("wandb") if run.folder else None
        known_by = known_by if isinstance(known_by, str) else secrets.token_hex(4)
        tracking.remember(run.folder, "wandb", known_by)
        chosen = {
            "project": os.environ.get("WANDB_PROJECT", _PROJECT),
            "name": run.folder.resolve().name if run.folder else run.title,
            "dir": str(run.folder) if run.folder else None,
            "config": run.options,
            "id": known_by,
            "resume": "allow",
        }
        self._run = wandb.init(**chosen | self._init)  # pyright: ignore[reportAttributeAccessIssue]

    def see(self, told: Told) -> None:
        """Logs the scalars."""
        self._run.log({**told.scalars, "episode": told.episode}, step=int(told.scalars["lane_steps"]))

    def end(self, summary: dict[str, Any] | None) -> None:
        """Gives the summary and closes the run."""
        if summary is not None:
            last = {f"last_tenth/{name}": value for name, value in summary["last_tenth"].items()}
            self._run.summary.update(last)
        self._run.finish()
