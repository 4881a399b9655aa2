"""`icac reproduce`: the paper's evaluation from one command, with a verdict on each claim."""

import dataclasses
import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from icac_jax import console
from icac_jax.cli.commands import common
from icac_jax.policies import PAIRS

if TYPE_CHECKING:
    from icac_jax.paper.plan import Plan

# What --quick takes where nothing else is said: about a minute in all, and too few seeds for a verdict.
_QUICK = {"arm": "planar2", "seeds": 3, "episodes": 100, "physics": "kinematic"}
_QUICK_PAIRS = 100


@dataclasses.dataclass(frozen=True)
class ReproduceOptions:
    """What `icac reproduce` takes."""

    out: Path | None = common.flag(None, "folder of everything; runs/reproduce(-quick) if not given")
    arm: Literal["planar2", "nico4", "both"] | None = common.flag(None, "arm: planar2, nico4 or both; both by default")
    seeds: int | None = common.flag(None, "learners of each run, 20 by default")
    episodes: int | None = common.flag(None, "episodes a learner, the paper's by default")
    physics: Literal["servo", "kinematic"] | None = common.flag(None, "servo (default) or kinematic")
    preset: str | None = common.flag(None, "defaults of the runs: paper (default) or paper-literal")
    root_seed: int | None = common.flag(None, "randomness of all runs, 0 by default")
    ablations: bool = common.flag(True, "ICAC with one part changed, too; --no-ablations to skip")
    quick: bool = common.flag(False, "trial: planar2, 3 seeds, 100 episodes, kinematic")
    json: bool = common.flag(False, "print claims and summaries as JSON on standard output")
    no_cache: bool = common.no_cache()
    checkpoint_every: float = common.checkpoint_every()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.options("reproduce", ReproduceOptions, args)
    if given is None:
        return 0
    from icac_jax.paper import claims
    from icac_jax.paper import plan as plans

    common.prepare(given.no_cache, given.checkpoint_every, claims.ALGORITHMS)

    shared = ("seeds", "episodes", "physics", "preset", "root_seed")
    options = {name: getattr(given, name) for name in shared if getattr(given, name) is not None}
    options = {name: value for name, value in _QUICK.items() if given.quick and name in shared} | options
    arm = given.arm or (_QUICK["arm"] if given.quick else "both")
    plan = plans.Plan(
        arms=("planar2", "nico4") if arm == "both" else (arm,),
        options=options,
        ablations=given.ablations,
        quick=given.quick,
        command=shlex.join(["icac", "reproduce", *args]),
        pairs=_QUICK_PAIRS if given.quick else PAIRS,
    )
    out = given.out or Path("runs") / ("reproduce-quick" if given.quick else "reproduce")
    return run(plan, out, given.checkpoint_every, given.json)


def run(plan: "Plan", out: Path, checkpoint_every: float, as_json: bool) -> int:
    """Runs what is missing of a plan and prints what there is then; status 5 if a run has failed altogether."""
    from icac_jax.paper import page, reproduce
    from icac_jax.paper import verdicts as rule
    from icac_jax.reports import results, tables

    reports = reproduce.reproduce(plan, out, checkpoint_every, console.say, common.warn)
    verdicts = [verdict for found in reports for verdict in found.verdicts]
    if as_json:
        summaries = {found.arm: {name: run.summary for name, run in found.runs.items()} for found in reports}
        facts = {"quick": plan.quick, "out": str(out), "summaries": summaries}
        print(json.dumps(facts | {"claims": [rule.as_json(verdict) for verdict in verdicts]}))
    else:
        shown = [page.short_runs_table(found) for found in reports] + [page.short_claims_table(verdicts)]
        print("\n\n".join([page.QUICK] * plan.quick + [tables.as_text(table) for table in shown]))
        print(f"\nreport: {console.shown(out / reproduce.REPORT)}")
    failed = [str(run.folder) for found in reports for run in found.runs.values() if results.failed(run).all()]
    if failed:
        console.say(f"icac: every learner diverged in {', '.join(failed)}")
    return 5 if failed else 0
