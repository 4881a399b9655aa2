"""Cells that share a program train together: groups, their jobs, how many lanes at once, what that costs.

A program is compiled once for each distinct arm, physics, root seed and `Spec`; everything else is traced.
"""

import dataclasses
from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from icac_jax import rollout
from icac_jax.precision import usual
from icac_jax.rollout import EpisodeRecord, LaneState
from icac_jax.runs import loop
from icac_jax.runs.loop import Job, Training
from icac_jax.settings.options import Settings
from icac_jax.sweeps.study import Cell

# On a CPU more lanes per device are not faster (docs/performance.md) and wait longer for the slowest at the end. A GPU
# is filled by more of them.
LANES_A_DEVICE = {"cpu": 64}
_LANES_ELSEWHERE = 8192
# What the process holds before there is a lane: the interpreter, the libraries, the compiler.
_RESIDENT = 650 * 2**20
# The state in the program, its copy on the host for a checkpoint, and what the program works with: between 2.1 and 2.7
# times the state was measured with 10,000 lanes of planar2 and 1,280 of nico4 (docs/scaling.md).
_STATE_COPIES = 2.5


class Group(NamedTuple):
    """Cells of one program.

    Attributes:
      number: its place among the groups, from 0.
      cells: in the order of the study.
    """

    number: int
    cells: tuple[Cell, ...]

    @property
    def settings(self) -> Settings:
        """Of the first cell; the program's own part is the same in all."""
        return self.cells[0].settings

    @property
    def title(self) -> str:
        """What is common to all cells, in a few words."""
        return f"{self.settings.algo} {self.settings.arm.name}"

    def jobs(self) -> list[Job]:
        """Every seed of every cell, cell by cell."""
        return [Job(cell.settings, seed) for cell in self.cells for seed in range(cell.settings.run.seeds)]

    def options(self) -> dict[str, Any]:
        """What a checkpoint of this group says that it is of."""
        return {"cells": [cell.settings.flat() for cell in self.cells]}

    @property
    def episodes(self) -> int:
        """Episodes of all jobs together."""
        return sum(cell.settings.run.seeds * cell.settings.run.episodes for cell in self.cells)

    @property
    def most_steps(self) -> int:
        """Lane-steps if no episode ended early."""
        return sum(
            cell.settings.run.seeds * cell.settings.run.episodes * cell.settings.params.horizon for cell in self.cells
        )


def grouped(cells: Sequence[Cell], most_jobs: int | None = None) -> list[Group]:
    """The cells by program, in order of their first cell.

    Args:
      cells: of a study.
      most_jobs: a program whose cells have more jobs than this becomes several groups; never one of less than a cell.
    """
    found: dict[Hashable, list[list[Cell]]] = {}
    jobs: dict[Hashable, int] = {}  # of the last group of each program
    for cell in cells:
        program = loop.program(cell.settings)
        mine = found.setdefault(program, [[]])
        jobs[program] = jobs.get(program, 0) + cell.settings.run.seeds
        if most_jobs is not None and mine[-1] and jobs[program] > most_jobs:
            mine.append([])
            jobs[program] = cell.settings.run.seeds
        mine[-1].append(cell)
    parts = [part for mine in found.values() for part in mine]
    return [Group(number, tuple(part)) for number, part in enumerate(parts)]


def best_lanes() -> int:
    """How many lanes at once fill this process's devices best."""
    return LANES_A_DEVICE.get(jax.default_backend(), _LANES_ELSEWHERE) * jax.local_device_count()


def lanes_at_once(jobs: int, asked: int | None) -> int:
    """How many lanes train at once: as asked, or what the devices are best filled with, no more than there are jobs."""
    return min(best_lanes() if asked is None else asked, jobs)


def lane_flops(settings: Settings) -> int:
    """Floating-point operations of one lane's update, if they are many (`Agent.flops`)."""
    return Training([Job(settings, 0)]).agent.flops


# Bytes by program, whatever its root seed: to trace a program takes a second, and a study may have dozens of groups.
_bytes_of: dict[Hashable, int] = {}


def lane_bytes(settings: Settings) -> int:
    """Bytes of one lane's state, its traced numbers and its share of a chunk's records."""
    run = dataclasses.replace(settings.run, root_seed=0)
    key = loop.program(dataclasses.replace(settings, run=run)), settings.params.horizon
    if key not in _bytes_of:
        _bytes_of[key] = _traced_bytes(settings)
    return _bytes_of[key]


def _traced_bytes(settings: Settings) -> int:
    job = Training([Job(settings, 0)])
    numbers = jax.tree.map(lambda leaf: leaf[0], job.on_lanes(job.first().slots))

    # One step of one lane says it: to trace a chunk of lanes as training does takes four times as long.
    @usual
    def step() -> tuple[LaneState, EpisodeRecord]:
        lane = rollout.init_lane(job.agent, job.env, jax.random.key(0), jnp.int32(0), *numbers[:2])
        return rollout.step_lane(job.agent, job.env, lane, *numbers)

    parts = jax.eval_shape(step)
    lane, record = (sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(part)) for part in parts)
    return round(_STATE_COPIES * lane + 2 * job.length * record)


def memory_estimate(group: Group, lanes: int) -> int:
    """Bytes that the process will need for a group at its largest.

    Args:
      group: of cells.
      lanes: how many train at once.
    """
    return _RESIDENT + lanes * lane_bytes(group.settings)
