"""`icac sweep --dry-run`: what a sweep would do, without doing it.

Each node trains its share of a program's learners, whole ones,

    seconds = ceil(learners / nodes) * steps * max(s, t / lanes),

where s is the time per lane-step of many lanes, t that of one step of however few, `lanes` how many a node trains at
once, and `steps` those of a learner none of whose episodes ends early.
"""

import math
from typing import Any

from icac_jax.runs.progress import duration
from icac_jax.settings.options import of_learner, resolve
from icac_jax.sweeps import groups
from icac_jax.sweeps.groups import Group
from icac_jax.sweeps.halving import Promoting
from icac_jax.sweeps.study import Cell, Study

# Lane-steps per second on two cores, rather less than docs/benchmarks.md has; only for the estimate of the time.
# Learners that take `jax.vmap` on a CPU (docs/performance.md) need up to five times as long.
_SPEED = {
    "servo": {"planar2": 3_000_000, "nico4": 2_000_000},
    "kinematic": {"planar2": 3_500_000, "nico4": 2_500_000},
}
_SLOWEST = 40_000
# Floating-point operations per second on two cores in the updates of TD3 (docs/results/learners.md).
_FLOPS = 5e10
# Seconds of a step of a block of lanes, however few of them train (docs/benchmarks.json).
_LEAST = 10e-6


def plan(chosen: Study, lanes: int | None, nodes: int = 1) -> dict[str, Any]:
    """Cells, programs, lanes, and estimates, as JSON can hold them.

    Args:
      chosen: the study.
      lanes: how many learners train at once in a process; by default what the devices are best filled with.
      nodes: processes that share the study, each on two cores of its own.

    Returns:
      `claim`; `nodes`; `cells`, each with `cell` and `name`; `programs`, each with `title`, `cells`, `learners`,
      `lanes` at once per node, `seconds_at_most` on the nodes if no episode ended early, `memory` of a node in bytes;
      `search` with its trials, or None.
    """
    search = chosen.search
    cells = chosen.cells() if search is None else []
    programs = []
    for group in _groups(chosen, cells):
        run = group.settings.run
        learners = len(group.jobs())
        share = math.ceil(learners / nodes)
        at_once = groups.lanes_at_once(share, lanes)
        step = 1 / _SPEED[run.physics].get(run.arm, _SLOWEST) + groups.lane_flops(group.settings) / _FLOPS
        seconds = max(step, _LEAST / at_once) * share / learners
        programs.append(
            {
                "title": group.title,
                "cells": len(group.cells),
                "learners": learners,
                "lanes": at_once,
                "seconds_at_most": group.most_steps * seconds,
                "memory": groups.memory_estimate(group, at_once),
            }
        )
    return {
        "claim": chosen.claim,
        "nodes": nodes,
        "cells": [{"cell": cell.number, "name": cell.name} for cell in cells],
        "programs": programs,
        "search": search
        and {"trials": search.trials, "batch": search.batch, "seeds": resolve(**of_learner(chosen.base)).run.seeds},
    }


def _groups(chosen: Study, cells: list[Cell]) -> list[Group]:
    """The groups that train; with halving those of each rung, as if the first cells were the better ones."""
    if chosen.halving is None:
        return groups.grouped(cells)
    promoting = Promoting(chosen)
    rungs = (promoting.rung(place, range(number)) for place, number in enumerate(promoting.numbers))
    return [group for rung in rungs for group in groups.grouped(rung)]


def as_text(facts: dict[str, Any]) -> str:
    """The plan for a person."""
    lines = [facts["claim"]]
    if facts["search"]:
        lines.append("a search of {trials} cells, {batch} at a time, {seeds} seeds each".format(**facts["search"]))
        return "\n".join(lines)
    lines += [f"{cell['cell']:>5}  {cell['name']}" for cell in facts["cells"]]
    lines.append(f"{'program':28}{'cells':>7}{'learners':>10}{'lanes':>8}{'time at most':>14}{'memory':>11}")
    lines += [
        f"{one['title']:28}{one['cells']:>7}{one['learners']:>10,}{one['lanes']:>8,}"
        f"{duration(one['seconds_at_most']):>14}{one['memory'] / 2**30:>7.1f} GiB"
        for one in facts["programs"]
    ]
    total = sum(one["seconds_at_most"] for one in facts["programs"])
    where = "two cores" if facts["nodes"] == 1 else f"{facts['nodes']:,} nodes of two cores each"
    lines.append(
        f"at most {duration(total)} on {where}, if no episode ended early, and up to a minute of compiling each"
    )
    return "\n".join(lines)
