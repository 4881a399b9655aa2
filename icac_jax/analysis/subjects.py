"""What `icac compare` is given: run folders, sweep folders and patterns, read and named."""

import glob
from collections.abc import Callable, Sequence
from pathlib import Path

from icac_jax.errors import ConfigError
from icac_jax.reports import results
from icac_jax.reports.results import Result
from icac_jax.runs import folder as run_folder
from icac_jax.sweeps import best, recorded, sweep_file

MOST = 1000


def folders(given: Sequence[Path]) -> list[Path]:
    """The folders of runs and sweeps that were named, in that order, each once.

    Args:
      given: folders, and patterns such as `runs/icac-*` that the shell has left as they are; of what a pattern finds,
        only the folders of runs and sweeps count.

    Raises:
      ConfigError: a folder holds neither a run nor a sweep, or a pattern finds none.
    """
    found: list[Path] = []
    for path in given:
        if path.exists() or not glob.has_magic(str(path)):
            if not run_folder.is_run(path) and not run_folder.is_sweep(path):
                raise ConfigError(f"runs: {path} holds neither a run nor a sweep")
            found.append(path)
            continue
        matches = [Path(name) for name in sorted(glob.glob(str(path), recursive=True))]
        matches = [match for match in matches if run_folder.is_run(match) or run_folder.is_sweep(match)]
        if not matches:
            raise ConfigError(f"runs: nothing that {path} finds holds a run or a sweep")
        found += matches
    return list({path.resolve(): path for path in found}.values())


def names(places: Sequence[Path]) -> list[str]:
    """A name for each folder: as few of the last parts of its path as tell it from the others."""
    whole = [path.resolve().parts for path in places]
    found = []
    for mine in whole:
        others = [parts for parts in whole if parts != mine]
        kept = next(n for n in range(1, len(mine) + 1) if all(parts[-n:] != mine[-n:] for parts in others))
        found.append("/".join(mine[-kept:]))
    return found


def read(given: Sequence[Path], warn: Callable[[str], None] = lambda _: None) -> list[Result]:
    """The results to be compared: one per run, one per cell of a sweep.

    Args:
      given: folders and patterns, see `folders`.
      warn: told, in a line each, of what makes the comparison less than it seems.

    Raises:
      ConfigError: there are fewer than two, or more than `MOST`, or one has no episodes yet.
      DamagedError: a record cannot be read.
    """
    places = folders(given)
    if len(places) == 1 and not run_folder.is_sweep(places[0]):
        raise ConfigError(f"runs: must be at least 2 runs, or a sweep, got {places[0]} alone")
    found: list[Result] = []
    for path, name in zip(places, names(places), strict=True):
        if run_folder.is_sweep(path):
            found += _cells(path, name if len(places) > 1 else "")
        else:
            found.append(results.read(path, name))
    if not 2 <= len(found) <= MOST:
        raise ConfigError(f"runs: must be 2 to {MOST:,} runs or cells, got {len(found):,}")
    tasks = {task(result) for result in found}
    if len(tasks) > 1:
        warn(f"the runs are of {len(tasks)} different tasks, whose figures say little about each other")
    for result in found:
        if not result.summary and run_folder.is_run(result.folder) and result.folder != Path():
            warn(f"{result.name} has not finished: its last episodes are missing")
    return found


def _cells(folder: Path, name: str) -> list[Result]:
    rows = best.summary_of(folder)["cells"]
    chosen = sweep_file.read(folder / run_folder.SWEEP)
    cells = recorded.of_table(chosen, rows, folder)
    prefix = f"{name}: " if name else ""
    return [cell._replace(name=prefix + cell.name, folder=folder) for cell in cells]


def task(result: Result) -> tuple:
    """What makes two runs one task: the arm, where it starts and what it is to reach, and the physics."""
    settings = result.settings
    return settings.arm.name, settings.run.task, settings.run.physics, settings.goals, settings.params


def are_paired(one: Result, other: Result) -> bool:
    """Whether seed k of the one saw the same starts and goals as seed k of the other."""

    def drawn(result: Result) -> tuple:
        return *task(result), result.settings.run.root_seed

    return drawn(one) == drawn(other)
