"""The best cell of a finished sweep."""

from pathlib import Path
from typing import Any

import tomli_w

from icac_jax.fields import ConfigError
from icac_jax.runs import folder as run_folder
from icac_jax.runs.checkpoints import DamagedError
from icac_jax.sweeps import sweep_file, tables


def summary_of(folder: Path) -> dict[str, Any]:
    """The summary of a finished sweep.

    Raises:
      ConfigError: the folder holds no sweep, or one that has not finished.
      DamagedError: the summary cannot be read.
    """
    if not run_folder.is_sweep(folder):
        raise ConfigError(f"folder: {folder} holds no sweep (no {run_folder.SWEEP})")
    result = run_folder.read_json(folder / run_folder.SUMMARY)
    if not result:
        if (folder / run_folder.SUMMARY).exists():
            raise DamagedError(f"{folder / run_folder.SUMMARY}: not a readable summary")
        raise ConfigError(f"folder: the sweep in {folder} has not finished (icac resume continues it)")
    return result


def best(folder: Path, metric: str = "steps") -> str:
    """The best cell of a finished sweep as a configuration that `icac train --config` takes.

    Args:
      folder: of the sweep.
      metric: a key of `study.OBJECTIVES`, taken as the mean over seeds in the last tenth of the episodes.

    Raises:
      ConfigError: the folder holds no sweep that has finished.
    """
    result = summary_of(folder)
    chosen = sweep_file.read(folder / run_folder.SWEEP)
    rows = tables.ranked(result["cells"], metric)
    winner = rows[0]
    equal = tables.within_noise(winner, rows, metric)
    form = ".1%" if metric == "success_rate" else ".2f"
    head = [f"# {result['claim']}", f"# best by {metric}: {winner['name']}, {tables.interval(winner, metric, form)}"]
    head += [f"# within noise of it: {one['name']}, {tables.interval(one, metric, form)}" for one in equal]
    settings = chosen.cell(winner["cell"], winner["varied"]).settings
    return "\n".join(head) + "\n" + tomli_w.dumps(settings.flat())
