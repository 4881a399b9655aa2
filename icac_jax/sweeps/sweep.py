"""`icac sweep`: every cell of a study, trained group by group in one folder, and on from wherever it stopped."""

import contextlib
import dataclasses
import functools
import json
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import tomli_w

from icac_jax.fields import ConfigError
from icac_jax.reports.results import Result
from icac_jax.runs import CHECKPOINT_EVERY, files, processes, session, store
from icac_jax.runs import folder as run_folder
from icac_jax.runs.checkpoints import DamagedError
from icac_jax.runs.jobs import read_done, train_jobs
from icac_jax.runs.processes import Host
from icac_jax.runs.records import SCHEMA
from icac_jax.runs.session import writing
from icac_jax.runs.store import Store
from icac_jax.settings.options import resolve
from icac_jax.sweeps import groups, study, tables, verdicts
from icac_jax.sweeps.groups import Group
from icac_jax.sweeps.study import Cell, Study

# Working files of the groups, removed when the sweep has finished.
GROUPS = "groups"
_PLAN = "plan.json"

# The columns of a sweep's `episodes.parquet`.
SWEEP_SCHEMA = pa.schema([pa.field("cell", pa.int32()), *SCHEMA])


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
    def host(self) -> Host:
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
      host: this process among them.
      most_jobs: no bound: all cells of a program are lanes of one compile.
    """

    host: Host = processes.ALONE
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
                self.host,
            )
            shutil.rmtree(folder / run_folder.CHECKPOINTS, ignore_errors=True)
            before += sum(read_done(folder)["episodes_done"])


def _quiet(line: str) -> None:
    pass


def sweep(
    chosen: Study,
    out: Path,
    lanes: int | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
    tell: Callable[[str], None] = _quiet,
    engine: Engine | None = None,
) -> dict[str, Any]:
    """Trains every cell of a study into `out`, or goes on where an earlier call stopped.

    Args:
      chosen: the study.
      out: a new or empty folder, or the folder of the same study.
      lanes: how many learners train at once; by default what the devices are best filled with.
      checkpoint_every: seconds between checkpoints.
      tell: told, in a line each, what is going on.
      engine: who trains; this machine by default.

    Returns:
      The summary, as written to the folder.

    Raises:
      ConfigError: the folder cannot be used or holds another study.
      DamagedError: files of an earlier call cannot be read.
      StoppedError: a signal asked for a stop.
      WriteError: the folder could not be written any more.
    """
    engine = engine or Local()
    if engine.host.index > 0:
        processes.wait_for(out / _PLAN)
    if run_folder.is_sweep(out):
        there = study.read(out / run_folder.SWEEP)
        differing = study.differences(there, chosen)
        if differing:
            raise ConfigError(f"out: {out} holds another sweep, it differs in {', '.join(differing)}")
        return resume(out, checkpoint_every, tell, engine)
    if chosen.search is None:
        chosen.cells()  # says what is wrong before there is a folder
    with run_folder.created(out, run_folder.SWEEP, chosen.text), writing(out):
        # Written down: on a machine with other devices the sweep has to go on with as many lanes as it began with.
        lanes = lanes or groups.best_lanes()
        facts = {"lanes": lanes, "most_jobs": engine.most_jobs}
        files.write_text(out / _PLAN, json.dumps(facts) + "\n")
        run_folder.record(out, "started", platform=run_folder.platform_facts())
        return _run(chosen, out, engine, engine.most_jobs, Plan(lanes, checkpoint_every, tell))


def resume(
    folder: Path,
    checkpoint_every: float = CHECKPOINT_EVERY,
    tell: Callable[[str], None] = _quiet,
    engine: Engine | None = None,
) -> dict[str, Any]:
    """Goes on with a sweep; arguments, result and errors as in `sweep`."""
    engine = engine or Local()
    study.read(folder / run_folder.SWEEP)  # refuses what is no sweep before a lock is put there
    with run_folder.locked(folder) if engine.host.index == 0 else contextlib.nullcontext():
        chosen = study.read(folder / run_folder.SWEEP)
        finished = run_folder.read_json(folder / run_folder.SUMMARY)
        if finished and run_folder.read_json(folder / run_folder.STATUS).get("state") in ("finished", "failed"):
            if engine.host.index == 0:  # left behind by a kill in the last instant
                shutil.rmtree(folder / GROUPS, ignore_errors=True)
            tell("the sweep has finished already")
            return finished
        facts = run_folder.platform_facts()
        changes = run_folder.platform_changes(folder, facts)
        if changes:
            tell(f"bits may differ in the last digits from an uninterrupted sweep: {', '.join(changes)}")
        lanes, most_jobs = (_planned(folder, name) for name in ("lanes", "most_jobs"))
        with writing(folder):
            if engine.host.index == 0:
                run_folder.record(folder, "resumed", changes=changes, platform=facts)
            return _run(chosen, folder, engine, most_jobs, Plan(lanes, checkpoint_every, tell))


def _planned(folder: Path, name: str) -> int | None:
    value = run_folder.read_json(folder / _PLAN).get(name)
    if value is not None and (not isinstance(value, int) or value < 1):
        raise DamagedError(f"{folder / _PLAN}: {name} must be a whole number at least 1, got {value!r}")
    return value


def _run(chosen: Study, folder: Path, engine: Engine, most_jobs: int | None, plan: Plan) -> dict[str, Any]:
    """Trains every batch of cells; `most_jobs` as the sweep was begun with. Returns the summary."""
    started = time.monotonic()
    files.make_folder(folder / GROUPS)
    if engine.host.index == 0:
        for stale in (folder / GROUPS).glob("left-*"):
            stale.unlink()
    batches: list[Batch] = []

    def train(cells: list[Cell], before: int, total: int) -> Batch:
        place = folder / GROUPS / f"batch-{len(batches):04d}"
        files.make_folder(place)
        batch = Batch(place, cells, groups.grouped(cells, most_jobs))
        engine.train(batch, folder, plan, before, total or sum(group.episodes for group in batch.groups))
        batches.append(batch)
        return batch

    if chosen.search is None:
        train(chosen.cells(), 0, 0)
    else:
        from icac_jax.sweeps.search import Asking

        asking = Asking(chosen)
        run = resolve(**chosen.base).run
        total, before = chosen.search.trials * run.seeds * run.episodes, 0
        for cells in asking.batches():
            _, rows = read_cells(train(cells, before, total))
            asking.tell(rows)
            before += sum(row["episodes_done"] for row in rows)
    # Process 0 removes the working files when no other process needs them any more.
    left = [folder / GROUPS / f"left-{index:04d}" for index in range(1, engine.host.count)]
    if engine.host.index > 0:
        left[engine.host.index - 1].touch()
        processes.wait_for(folder / run_folder.SUMMARY)
        return run_folder.read_json(folder / run_folder.SUMMARY)
    for path in left:
        processes.wait_for(path)
    return finish(chosen, batches, folder, time.monotonic() - started)


def read_cells(batch: Batch) -> tuple[dict[int, Result], list[dict[str, Any]]]:
    """The result of each cell, by its number, and its row of figures, from the finished groups of a batch.

    Raises:
      DamagedError: a file of a group cannot be read.
    """
    found: dict[int, Result] = {}
    rows = []
    for group in batch.groups:
        folder = batch.place(group)
        facts = read_done(folder)
        table = Store(folder).table(np.array(facts["episodes_done"]))
        job = table["seed"].to_numpy()
        first = 0
        for cell in group.cells:
            number = cell.settings.run.seeds
            mine = table.filter(pa.array((job >= first) & (job < first + number)))
            seeds = pa.array(mine["seed"].to_numpy() - first, pa.int32())
            mine = mine.set_column(mine.schema.get_field_index("seed"), "seed", seeds)
            part = slice(first, first + number)
            jobs = {name: facts[name][part] for name in ("episodes_done", "failed", "steps", "overflow")}
            found[cell.number] = tables.result_of(cell, mine, jobs)
            rows.append(tables.row(cell, found[cell.number], jobs))
            first += number
    rows.sort(key=lambda row: row["cell"])
    return found, rows


def finish(chosen: Study, batches: list[Batch], folder: Path, seconds: float) -> dict[str, Any]:
    """Puts the groups' records together, writes the table of cells, removes the working files.

    Args:
      chosen: the study.
      batches: all of its cells, trained.
      folder: of the sweep.
      seconds: spent in this call.

    Returns:
      The summary, as written to the folder.
    """
    cells = [cell for batch in batches for cell in batch.cells]
    found: dict[int, Result] = {}
    rows: list[dict[str, Any]] = []
    programs = []
    for batch in batches:
        some, their = read_cells(batch)
        found |= some
        rows += their
        programs += [read_done(batch.place(group)) for group in batch.groups]
    rows.sort(key=lambda row: row["cell"])
    with (
        files.replacing(folder / store.EPISODES) as file,
        pq.ParquetWriter(file, SWEEP_SCHEMA, compression="zstd") as writer,
    ):
        for number in sorted(found):
            table = found[number].table
            column = pa.array(np.full(table.num_rows, number, np.int32))
            writer.write_table(table.add_column(0, SWEEP_SCHEMA.field("cell"), column))
    files.write_text(folder / tables.CELLS, tables.as_csv(rows))
    failed = sum(row["failed_lanes"] for row in rows)
    verdict = verdicts.judge(rows, chosen.expect, chosen.reference) if chosen.expect else None
    result = {
        "claim": chosen.claim,
        "cells": rows,
        "seconds": seconds,
        "seconds_training": sum(facts["seconds"] for facts in programs),
        "lanes": max(facts["lanes"] for facts in programs),
        "programs": len(groups.grouped(cells)),
        "lane_steps": sum(row["lane_steps"] for row in rows),
        "failed_lanes": failed,
        "lanes_trained": sum(cell.settings.run.seeds for cell in cells),
        "verdict": verdicts.as_json(verdict) if verdict else None,
    }
    files.write_text(folder / run_folder.SUMMARY, json.dumps(result, indent=2) + "\n")
    done = sum(row["episodes_done"] for row in rows)
    total = sum(cell.settings.run.seeds * cell.settings.run.episodes for cell in cells)
    state = "failed" if failed and failed == result["lanes_trained"] else "finished"
    session.write_status(folder, state, done, total, f"{len(rows)} cells")
    run_folder.record(folder, "finished", cells=len(rows), failed_lanes=failed)
    shutil.rmtree(folder / GROUPS, ignore_errors=True)
    _report(chosen, rows, [found[number] for number in sorted(found)], result, verdict, folder)
    return result


def _report(
    chosen: Study,
    rows: list[dict[str, Any]],
    found: list[Result],
    result: dict[str, Any],
    verdict: verdicts.Verdict | None,
    folder: Path,
) -> None:
    """Draws and writes the report; last, so that whatever becomes of it the sweep has finished."""
    # Imported here: training needs no Matplotlib.
    from icac_jax.sweeps import report
    from icac_jax.sweeps.grid import Grid

    varying = chosen.varying([row["varied"] for row in rows])
    report.write(Grid(chosen, rows, found, varying), result, verdict, folder)


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
        raise ConfigError(f"folder: the sweep in {folder} has not finished (icac resume goes on with it)")
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
    chosen = study.read(folder / run_folder.SWEEP)
    rows = tables.ranked(result["cells"], metric)
    winner = rows[0]
    equal = tables.within_noise(winner, rows, metric)
    form = ".1%" if metric == "success_rate" else ".2f"
    head = [f"# {result['claim']}", f"# best by {metric}: {winner['name']}, {tables.interval(winner, metric, form)}"]
    head += [f"# within noise of it: {one['name']}, {tables.interval(one, metric, form)}" for one in equal]
    settings = chosen.cell(winner["cell"], winner["varied"]).settings
    return "\n".join(head) + "\n" + tomli_w.dumps(settings.flat())
