"""Who trains the groups of a sweep: what every engine does, and the one of this machine."""

import dataclasses
import functools
import itertools
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

from icac_jax.runs import files, processes, shares
from icac_jax.runs import folder as run_folder
from icac_jax.runs.jobs import read_done, train_jobs
from icac_jax.runs.processes import Process
from icac_jax.sweeps import groups
from icac_jax.sweeps.groups import Group
from icac_jax.sweeps.study import Cell

_TASK = "task-"


class Batch(NamedTuple):
    """Cells that are trained before anything is made of them: all of a study, or what a search asks for at a time.

    Attributes:
      folder: where the groups' working files lie.
      cells: the cells.
      groups: the cells by program.
    """

    folder: Path
    cells: list[Cell]
    groups: list[Group]

    def place(self, group: Group) -> Path:
        """Where a group's working files lie."""
        return self.folder / f"{group.number:04d}"


class Plan(NamedTuple):
    """How a sweep is trained; no part of what it is.

    Attributes:
      lanes: how many learners train at once, or None for what the devices are best filled with.
      checkpoint_every: seconds between checkpoints.
      tell: told, in a line each, what is not as it should be.
    """

    lanes: int | None
    checkpoint_every: float
    tell: Callable[[str], None]


class Engine(Protocol):
    """Who trains the groups of a sweep."""

    @property
    def most_jobs(self) -> int | None:
        """Groups are made no larger than this; None for no bound."""
        ...

    @property
    def process(self) -> Process:
        """This process among those that share the sweep."""
        ...

    def train(self, batch: Batch, home: Path, plan: Plan, before: int, total: int) -> None:
        """Trains the groups of a batch that have not finished yet, each into its place.

        Args:
          batch: what to train.
          home: the sweep's folder.
          plan: how.
          before: episodes that the sweep has finished elsewhere.
          total: episodes of the whole sweep.
        """
        ...


@dataclasses.dataclass(frozen=True)
class Local:
    """This machine, or this one and others that share a folder and find each other through `jax.distributed`.

    Attributes:
      process: this process among them.
      most_jobs: no bound: all cells of a program are lanes of one compile.
    """

    process: Process = processes.ALONE
    most_jobs: int | None = None

    def train(self, batch: Batch, home: Path, plan: Plan, before: int, total: int) -> None:
        """Trains group by group, see `Engine`."""
        for group in batch.groups:
            _train(group, batch, home, plan, before, total, self.process)
            folder = batch.place(group)
            shutil.rmtree(folder / run_folder.CHECKPOINTS, ignore_errors=True)
            before += sum(read_done(folder)["episodes_done"])


@dataclasses.dataclass(frozen=True)
class Tasks:
    """Processes that share a folder, run at any time and in any order, and never wait for each other: a job array.

    Attributes:
      count: how many tasks there are; each trains its share of every group.
      only: the one to train, from 0. By default what is left of each, one after the other; then all are put together.
      process: to others, one process alone.
      most_jobs: no bound, as in `Local`.
    """

    count: int
    only: int | None = None
    process: Process = processes.ALONE
    most_jobs: int | None = None

    def train(self, batch: Batch, home: Path, plan: Plan, before: int, total: int) -> None:
        """Trains task by task, see `Engine`; how far it is, is said of the task.

        Raises:
          ConfigError: another process works at a task.
        """
        for index in range(self.count) if self.only is None else [self.only]:
            place = batch.folder / f"{_TASK}{index:04d}"
            files.make_folder(place)
            with run_folder.locked(place):
                own = [
                    sum(job.settings.run.episodes for job in group.jobs()[index :: self.count])
                    for group in batch.groups
                ]
                mine = Process(index, self.count)
                places = [batch.place(group) for group in batch.groups]
                others = [share for place in places for share in mine.others(place) if share != mine.folder(place)]
                for group, done in zip(batch.groups, itertools.accumulate(own, initial=0), strict=False):
                    _train(group, batch, home, plan, done, total, mine, False, others)
        if self.only is None:
            for group in batch.groups:
                _train(group, batch, home, plan, before, total, Process(0, self.count))


def how_far(batches: Path) -> tuple[int, int]:
    """How many tasks of a job array run, and how many episodes all tasks have finished, by what they said last.

    Args:
      batches: the folder of the sweep's batches.
    """
    run = sum(run_folder.is_locked(place) for place in batches.glob(f"*/{_TASK}*"))
    return run, shares.episodes_done(batches.glob("*/*/host-*"))


def _train(
    group: Group,
    batch: Batch,
    home: Path,
    plan: Plan,
    before: int,
    total: int,
    process: Process,
    together: bool = True,
    others: list[Path] | None = None,
) -> None:
    who = "" if process.count == 1 else f"{'process' if together else 'task'} {process.index} of {process.count}, "
    train_jobs(
        group.jobs(),
        batch.place(group),
        home,
        f"{group.title}, {who}program {group.number + 1} of {len(batch.groups)}",
        group.options(),
        functools.partial(groups.lanes_at_once, asked=plan.lanes),
        plan.checkpoint_every,
        plan.tell,
        before,
        total,
        process,
        together,
        others,
    )
