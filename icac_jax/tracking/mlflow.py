"""MLflow: the options as parameters, the scalars of each chunk as metrics. Optional extra `mlflow`.

`MLFLOW_TRACKING_URI` and `MLFLOW_EXPERIMENT_NAME` count; without the first everything goes into `mlflow.db` beside the
run's folder, which `mlflow ui --backend-store-uri sqlite:///mlflow.db` shows.
"""

import math
import os
import time
from pathlib import Path
from typing import Any

from icac_jax import tracking
from icac_jax.fields import ConfigError
from icac_jax.runs.observers import Observer, Run, Told

try:
    from mlflow.entities import Metric, Param  # pyright: ignore[reportMissingImports]
    from mlflow.tracking import MlflowClient  # pyright: ignore[reportMissingImports]
except ImportError as error:
    raise ConfigError("mlflow: needs the extra, pip install 'icac_jax[mlflow]'") from error

DATABASE = "mlflow.db"
_EXPERIMENT = "icac_jax"
_MOST_PARAMS = 100  # per call
_LONGEST = 500  # characters of a parameter


class MLflow(Observer):
    """Logs over lane-steps; a run that is resumed goes on in the same run of MLflow.

    Args:
      uri: of the tracking server or folder; see above for what is taken otherwise.
      experiment: its name.
    """

    def __init__(self, uri: str | None = None, experiment: str | None = None) -> None:
        self._uri = uri or os.environ.get("MLFLOW_TRACKING_URI")
        self._experiment = experiment or os.environ.get("MLFLOW_EXPERIMENT_NAME", _EXPERIMENT)

    def start(self, run: Run) -> None:
        """Begins the run of MLflow, or goes on with it."""
        beside = run.folder.resolve().parent if run.folder else Path.cwd()
        self._client = MlflowClient(tracking_uri=self._uri or f"sqlite:///{beside / DATABASE}")
        known_by = tracking.remembered(run.folder).get("mlflow") if run.folder else None
        if isinstance(known_by, str):
            self._id = self._client.get_run(known_by).info.run_id
            self._client.update_run(self._id, status="RUNNING")
            return
        # Files of a run, of which there are none, would otherwise get a folder in the current one.
        place = {} if self._uri else {"artifact_location": (beside / "mlartifacts").as_uri()}
        there = self._client.get_experiment_by_name(self._experiment)
        number = there.experiment_id if there else self._client.create_experiment(self._experiment, **place)
        name = run.folder.resolve().name if run.folder else run.title
        self._id = self._client.create_run(number, run_name=name).info.run_id
        tracking.remember(run.folder, "mlflow", self._id)
        params = [Param(name, str(value)[:_LONGEST]) for name, value in run.options.items()]
        for first in range(0, len(params), _MOST_PARAMS):
            self._client.log_batch(self._id, params=params[first : first + _MOST_PARAMS])

    def see(self, told: Told) -> None:
        """Logs the scalars."""
        now, step = int(1000 * time.time()), int(told.scalars["lane_steps"])
        named = {**told.scalars, "episode": told.episode}
        metrics = [Metric(name, value, now, step) for name, value in named.items() if math.isfinite(value)]
        self._client.log_batch(self._id, metrics=metrics)

    def end(self, summary: dict[str, Any] | None) -> None:
        """Says how the run ended."""
        self._client.set_terminated(self._id, "KILLED" if summary is None else "FINISHED")
