"""Who trains the groups of a sweep: what every engine does, and the one of this machine."""

import dataclasses
import functools
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol

from icac_jax.runs import folder as run_folder
from icac_jax.runs import processes
from icac_jax.runs.jobs import read_done, train_jobs
from icac_jax.runs.processes import Process
from icac_jax.sweeps import groups
from icac_jax.sweeps.groups import Group
from icac_jax.sweeps.study import Cell


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
            folder = batch.place(group)
            train_jobs(
                group.jobs(),
                folder,
                home,
                f"{group.title}, program {group.number + 1} of {len(batch.groups)}",
                group.options(),
                functools.partial(groups.lanes_at_once, asked=plan.lanes),
                plan.checkpoint_every,
                plan.tell,
                before,
                total,
                self.process,
            )
            shutil.rmtree(folder / run_folder.CHECKPOINTS, ignore_errors=True)
            before += sum(read_done(folder)["episodes_done"])
