"""The episodes of a run by seed: what figures, claims and reports are made from.

S is the number of seeds, E the number of episodes per seed.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from icac_jax.errors import ConfigError, DamagedError
from icac_jax.runs import folder as run_folder
from icac_jax.runs import store, stored_summary
from icac_jax.settings.options import Settings

# What `last_tenth` gives for each seed.
METRICS = ("success_rate", "steps", "steps_when_reached", "extrinsic_reward")


class Result(NamedTuple):
    """A run that has stopped or finished.

    Attributes:
      name: what figures and tables call it.
      settings: of the run.
      table: its episodes (see `records`).
      summary: what `summary.json` holds; empty where the run has not finished.
      folder: where it was read from.
    """

    name: str
    settings: Settings
    table: pa.Table
    summary: dict[str, Any]
    folder: Path


def read(folder: Path, name: str | None = None) -> Result:
    """Reads a run.

    Args:
      folder: of the run.
      name: what figures and tables call it; the algorithm by default.

    Raises:
      ConfigError: the folder holds no run, or one that has not stopped or finished yet.
      DamagedError: the episodes or the summary cannot be read, or are of another run.
    """
    settings = run_folder.load(folder)
    path = folder / store.EPISODES
    if not path.is_file():
        raise ConfigError(f"run: {folder} has no {store.EPISODES} yet, which comes when a run stops or finishes")
    summary, table = stored_summary.read(folder, settings) or {}, store.read(path)
    for column, limit in (("seed", settings.run.seeds), ("episode", settings.run.episodes)):
        values = table[column].to_numpy()
        if np.any((values < 0) | (values >= limit)):
            raise DamagedError(f"{path}: not the record of this run (a {column} of {values.max()})")
    return Result(name or settings.algo, settings, table, summary, folder)


def by_seed(result: Result, column: str) -> np.ndarray:
    """A column of the episodes as floats [S, E]; NaN where a seed did not get to the episode.

    Args:
      result: of a run.
      column: of the table.
    """
    run = result.settings.run
    values = np.full((run.seeds, run.episodes), np.nan)
    place = tuple(result.table[name].to_numpy() for name in ("seed", "episode"))
    values[place] = result.table[column].to_numpy()
    return values


def failed(result: Result) -> np.ndarray:
    """[S] bool, seeds that diverged: they were frozen when a number stopped being finite."""
    frozen = np.zeros(result.settings.run.seeds, bool)
    frozen[[int(seed) for seed in result.summary.get("failed_seeds", {})]] = True
    return frozen


def outcomes(result: Result) -> dict[str, np.ndarray]:
    """How each episode ended, as floats [S, E]: `reached`, `steps`, `steps_when_reached`, `extrinsic_reward`.

    Episodes that a diverged seed did not get to count as not reached, with the horizon as their steps and no reward;
    those of a run that is not over are NaN. `steps_when_reached` is NaN where the goal was not reached.
    """
    values = {name: by_seed(result, name) for name in ("reached", "steps", "extrinsic_reward")}
    lost = np.isnan(values["reached"]) & failed(result)[:, None]
    for name, value in (("reached", 0.0), ("steps", result.settings.params.horizon), ("extrinsic_reward", 0.0)):
        values[name][lost] = value
    return values | {"steps_when_reached": np.where(values["reached"] == 1, values["steps"], np.nan)}


def last_tenth(result: Result) -> dict[str, np.ndarray]:
    """Means over the last tenth of the episodes, [S] each, NaN where a seed has none.

    Returns:
      `success_rate`, `steps` (a failure counts as the horizon), `steps_when_reached`, `extrinsic_reward` per episode.
    """
    episodes = result.settings.run.episodes
    ends = {name: values[:, episodes - max(episodes // 10, 1) :] for name, values in outcomes(result).items()}
    ends["success_rate"] = ends.pop("reached")
    return {name: mean_of_known(ends[name], axis=1) for name in METRICS}


def judged(result: Result) -> dict[str, np.ndarray]:
    """What claims are about, [S] each: `last_tenth`, and for the speed of learning the mean steps of other episodes.

    Returns:
      Also `steps_all_episodes`, the area under the curve of steps divided by the number of episodes, and
      `steps_first_tenth`.
    """
    steps = outcomes(result)["steps"]
    first = steps[:, : max(result.settings.run.episodes // 10, 1)]
    parts = {"steps_all_episodes": steps, "steps_first_tenth": first}
    return last_tenth(result) | {name: mean_of_known(values, axis=1) for name, values in parts.items()}


def mean_of_known(values: np.ndarray, axis: int) -> np.ndarray:
    """Mean along an axis without the NaN; NaN where there is nothing else."""
    known = np.sum(~np.isnan(values), axis=axis)
    return np.where(known > 0, np.nansum(values, axis=axis) / np.maximum(known, 1), np.nan)
