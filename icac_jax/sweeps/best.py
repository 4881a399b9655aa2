"""The best cell of a finished sweep."""

from pathlib import Path
from typing import Any

import tomli_w

from icac_jax.console import shown
from icac_jax.fields import ConfigError
from icac_jax.runs import folder as run_folder
from icac_jax.sweeps import stages, sweep_file, tables


def summary_of(folder: Path) -> dict[str, Any]:
    """The summary of a finished sweep.

    Raises:
      ConfigError: the folder holds no sweep, or one that has not finished.
      DamagedError: the summary cannot be read.
    """
    if not run_folder.is_sweep(folder):
        raise ConfigError(f"folder: {folder} holds no sweep (no {run_folder.SWEEP})")
    result = stages.trained(folder)
    if result is None:
        raise ConfigError(f"folder: the sweep in {folder} has not finished (icac resume continues it)")
    return result


def best(folder: Path, metric: str | None = None) -> str:
    """The best cell of a finished sweep as a configuration that `icac train --config` takes.

    Args:
      folder: of the sweep.
      metric: a key of `study.OBJECTIVES`, taken as the interquartile mean over seeds in the last tenth of the
        episodes; the study's own by default.

    Raises:
      ConfigError: the folder holds no sweep that has finished.
    """
    result = summary_of(folder)
    chosen = sweep_file.read(folder / run_folder.SWEEP)
    metric = metric or chosen.metric
    rows = tables.ranked(result["cells"], metric)
    winner = rows[0]
    equal = tables.within_noise(winner, rows, metric)
    head = [
        chosen.claim,
        "figures are interquartile means over seeds of the last tenth of the episodes [95 % interval]",
    ]
    head.append(f"best by {metric}: {winner['name']}, {tables.interval(winner, metric)}")
    head += [f"within noise of it: {one['name']}, {tables.interval(one, metric)}" for one in equal]
    settings = chosen.cell(winner["cell"], winner["varied"]).settings
    # A comment of TOML ends with its line, and what a person wrote may have several.
    comments = "".join(f"# {shown(line)}\n" for line in head)
    return comments + tomli_w.dumps(settings.flat())
