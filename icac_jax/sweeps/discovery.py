"""What a study of discovery tells: in which episode each seed found its goal, under which signal, on which task.

A study is one of discovery where each seed has one goal for all of its episodes (`goal_per`). A cell's **signal** is
what drives exploration beside noise: a learner's intrinsic reward, or a step cost, or nothing. Cells that differ in
their signal alone are compared, by the rule of `pays`. S is the number of seeds, E that of episodes.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icac_jax.agents import registry
from icac_jax.curiosity.options import CuriosityHyper, CuriositySpec
from icac_jax.curiosity.signals import CONTROLS, SIGNALS
from icac_jax.envs import goals, oracle
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.goals import GoalOptions
from icac_jax.envs.reach import ReachParams
from icac_jax.reports import results, statistics
from icac_jax.reports.results import Result
from icac_jax.reports.statistics import Estimate
from icac_jax.reports.tables import Table
from icac_jax.settings import options as settings_options
from icac_jax.settings.options import Settings
from icac_jax.sweeps import axes, pays
from icac_jax.sweeps.grid import Grid
from icac_jax.sweeps.pays import Judged

NO_BONUS, STEP_COST, COUNTS = "no bonus", "step cost", "counts"
FILE = "discovery.json"
# Lower ends of the bands of distance, in control steps; on the tasks with one wall 19 is the first that needs its door.
BANDS = (1, 10, 19, 28)
# What a signal is dosed by.
NUMBERS = ("curiosity", "e_max")
# What stands before a number of a signal in its words, where that is not the option's name.
_SHORT = {"step_cost": "", "curiosity": "×"}


class Cell(NamedTuple):
    """A cell of a study of discovery.

    Attributes:
      task: what it is compared within: task, arm, physics, learner, as far as they vary.
      signal: what drives exploration, in words, with the numbers of it that vary.
      kind: the signal's name without its numbers: `no bonus`, `step cost`, or a value of the option `signal`.
      first: [S] number of the first episode that reached the goal, from 1; infinite if none did.
      late: [S] share of the last quarter of the episodes that reached it.
      numbers: the weight of the signal and, of a map, its resolution, by option.
      visited: [S, E] share of the reachable cells of joint space that the seed has visited by an episode; None where it
        was not recorded.
      distance: [S] control steps to the goal of each seed, by the oracle, walls counted.
      judged: by the rule of `pays`; None of a control that knows nothing, and where there is no control.
    """

    task: str
    signal: str
    kind: str
    first: np.ndarray
    late: np.ndarray
    numbers: dict[str, float]
    visited: np.ndarray | None
    distance: np.ndarray
    judged: Judged | None = None

    @property
    def found(self) -> Estimate:
        """The share of seeds that found their goal, with its interval."""
        return statistics.estimate(np.isfinite(self.first), "mean")

    @property
    def coverage(self) -> np.ndarray | None:
        """[S] share of the reachable cells of joint space that the seed visited; None where it was not recorded."""
        return None if self.visited is None else np.nanmax(self.visited, axis=1)

    def by_episode(self, episodes: int) -> np.ndarray:
        """[S, E] whether the seed has found its goal by then."""
        return self.first[:, None] <= np.arange(1, episodes + 1)


def is_one(settings: Sequence[Settings]) -> bool:
    """Whether cells with these settings are of a study of discovery."""
    return all(one.goals.goal_per == "seed" for one in settings)


def cells(grid: Grid) -> list[Cell]:
    """The cells of a study of discovery, each judged against the controls of its task."""
    names = [name for row in grid.rows for name in row["varied"]]
    varied = list(dict.fromkeys(names))
    found = [_cell(result, varied) for result in grid.results]
    learnt = [cell for cell in found if not _is_blind(cell)]
    return [cell if _is_blind(cell) else cell._replace(judged=_judged(cell, found, len(learnt))) for cell in found]


def _is_blind(cell: Cell) -> bool:
    """Whether a signal knows nothing of what the learner has seen."""
    return cell.kind in (NO_BONUS, STEP_COST, *CONTROLS)


def _judged(cell: Cell, others: list[Cell], number: int) -> Judged | None:
    controls = {
        other.signal: other.first
        for other in others
        if other.task == cell.task and (_is_blind(other) or (other.kind == COUNTS and cell.kind != COUNTS))
    }
    return pays.judge(cell.first, controls, number) if controls else None


def _cell(result: Result, varied: Sequence[str]) -> Cell:
    settings = result.settings
    reached = results.outcomes(result)["reached"]
    episodes = settings.run.episodes
    first = np.where(np.any(reached == 1, axis=1), 1.0 + np.argmax(reached == 1, axis=1), np.inf)
    late = results.mean_of_known(reached[:, episodes - max(episodes // 4, 1) :], axis=1)
    flat = settings.flat()
    kind = flat.get("signal", "none")
    if kind == "none":
        kind = STEP_COST if flat["step_cost"] else NO_BONUS
    run, task = settings.run, settings.params.replace(step_cost=0.0)  # what a step costs moves no goal
    # Records of numbers are frozen, and so have a hash.
    distance = _distances(settings.arm, task, settings.goals, run.root_seed, run.seeds)  # pyright: ignore
    words = _task(settings, varied), _signal(settings, kind, varied), kind
    numbers = {name: float(flat[name]) for name in NUMBERS if name in flat}
    return Cell(*words, first, late, numbers, _visited(result), distance)


@functools.cache
def _of_signals() -> frozenset[str]:
    """The options that say what drives exploration."""
    declared = (*dataclasses.fields(CuriositySpec), *dataclasses.fields(CuriosityHyper))
    return frozenset({"algo", "step_cost", *(field.name for field in declared)})


def _task(settings: Settings, varied: Sequence[str]) -> str:
    flat = settings.flat()
    words = [str(flat["task"]).replace("_", " ")]
    words += [flat["arm"]] if "arm" in varied or "task" not in varied else []
    for name in varied:
        if name not in _of_signals() and name not in ("task", "arm") and name in flat:
            words.append(flat[name] if name == "physics" else f"{name} {axes.short(flat[name])}")
    if "algo" in varied:
        words.append(registry.find(registry.inside(settings.algo)).help)
    return ", ".join(words)


def _signal(settings: Settings, kind: str, varied: Sequence[str]) -> str:
    """A signal in words: its title, and the numbers that vary and are not the default."""
    flat = settings.flat()
    usual = settings_options.defaults(flat["arm"], flat["preset"], settings.algo)
    numbers = [name for name in varied if name in _of_signals() - {"algo", "signal"} and name in flat]
    numbers = [name for name in numbers if flat[name] != usual[name]]
    said = [f"{_SHORT.get(name, name)} {axes.short(flat[name])}".lstrip() for name in numbers]
    return " ".join([SIGNALS[kind].title if kind in SIGNALS else kind, *said])


@functools.lru_cache(maxsize=64)
def _distances(arm: ArmSpec, params: ReachParams, options: GoalOptions, root_seed: int, seeds: int) -> np.ndarray:
    joints = [goals.of_seed(arm, params, options, root_seed, seed).goal_joints for seed in range(seeds)]
    return oracle.distances(arm, params, oracle.tips(arm, np.radians(joints)))


@functools.lru_cache(maxsize=64)
def _reachable(settings: Settings, bins: int) -> int:
    return int(oracle.reachable(settings.arm, settings.params, bins).sum())


def _visited(result: Result) -> np.ndarray | None:
    flat = result.settings.flat()
    if not flat.get("coverage_bins") or "cells_visited" not in result.table.column_names:
        return None
    return results.by_seed(result, "cells_visited") / _reachable(result.settings, flat["coverage_bins"])


def table(found: Sequence[Cell]) -> Table:
    """One row per signal and task, the tasks in order, within each the signals that were found most."""
    rows = []
    for task in dict.fromkeys(cell.task for cell in found):
        mine = sorted((cell for cell in found if cell.task == task), key=lambda cell: -cell.found.value)
        for place, cell in enumerate(mine):
            judged = cell.judged
            coverage = "-" if cell.coverage is None else statistics.estimate(cell.coverage, "mean").text(".0%")
            against = "control" if judged is None else f"{judged.earlier.text('.2f')} against {judged.control}"
            rows.append(
                (
                    "" if place else task,
                    cell.signal,
                    cell.found.text(".0%"),
                    _half(cell.first),
                    statistics.estimate(cell.late, "mean").text(".0%"),
                    coverage,
                    against,
                    "" if judged is None else f"{100 * judged.lead:+.0f}",
                    "" if judged is None else judged.outcome,
                )
            )
    header = ("task", "signal", "found", "half by", "success late", "coverage", "P(earlier)", "lead", "verdict")
    return Table(
        "Share of seeds that found their goal, the episode by which half of them had, success in the last quarter, "
        "share of the reachable joint space visited; P(earlier) against the hardest control, corrected interval; "
        "lead in points over the control that found most",
        header,
        rows,
    )


def by_distance(found: Sequence[Cell]) -> Table:
    """One row per signal and task: the share of seeds that found their goal, by how far it is."""
    ends = [(low, high) for low, high in zip(BANDS, (*BANDS[1:], np.inf), strict=True)]
    rows = []
    for task in dict.fromkeys(cell.task for cell in found):
        mine = [cell for cell in found if cell.task == task]
        within = [(cell.distance >= low) & (cell.distance < high) for cell in mine[:1] for low, high in ends]
        rows.append((task, "seeds", *(str(int(seeds.sum())) for seeds in within)))
        for cell in mine:
            shares = [f"{pays.found(cell.first[seeds]):.0%}" if seeds.any() else "-" for seeds in within]
            rows.append(("", cell.signal, *shares))
    header = [f"{low} to {high - 1:.0f} steps" if np.isfinite(high) else f"{low} steps or more" for low, high in ends]
    title = "Share of seeds that found their goal, by its distance from the start in control steps, walls counted"
    return Table(title, ("task", "signal", *header), rows)


def _half(first: np.ndarray) -> str:
    """The episode by which half of the seeds have found their goal."""
    middle = np.sort(first)[(len(first) - 1) // 2]
    return f"{middle:,.0f}" if np.isfinite(middle) else "never"


def as_json(found: Sequence[Cell]) -> list[dict[str, Any]]:
    """The cells as JSON can hold them: what `table` shows, in numbers."""
    return [
        {
            "task": cell.task,
            "signal": cell.signal,
            "kind": cell.kind,
            "seeds": len(cell.first),
            "found": cell.found.as_json(),
            "success_late": statistics.estimate(cell.late, "mean").as_json(),
            "coverage": None if cell.coverage is None else statistics.estimate(cell.coverage, "mean").as_json(),
            "verdict": None
            if cell.judged is None
            else {
                "outcome": cell.judged.outcome,
                "control": cell.judged.control,
                "earlier": cell.judged.earlier.as_json(),
                "lead": cell.judged.lead,
            },
        }
        for cell in found
    ]
