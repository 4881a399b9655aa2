"""A sweep as a job array of Slurm: scripts in its folder, what a task of it trains, and the job that puts all together.

Tasks run at any time and in any order; one that is requeued goes on from its last checkpoint.
"""

import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

from icac_jax.fields import ConfigError
from icac_jax.runs import CHECKPOINT_EVERY, files, randomness
from icac_jax.runs import folder as run_folder
from icac_jax.runs.session import write_status, writing
from icac_jax.sweeps import groups, stages, sweep, sweep_file
from icac_jax.sweeps.collect import GROUPS
from icac_jax.sweeps.engine import Plan, Tasks
from icac_jax.sweeps.study import Study

ARRAY, COLLECT = "array.sh", "collect.sh"
_SCRIPT = """#!/bin/sh
#SBATCH --job-name=icac-{name}
#SBATCH --output="{folder}/slurm-{log}.log"
#SBATCH --open-mode=append
#SBATCH --requeue
{options}exec {command}
"""


def prepare(
    chosen: Study, out: Path, tasks: int, lanes: int | None = None, checkpoint_every: float = CHECKPOINT_EVERY
) -> str:
    """Writes a sweep's folder and its scripts; trains nothing.

    Args:
      chosen: the study.
      out: a new or empty folder, which all nodes see.
      tasks: of the array; each trains its share of every program's learners.
      lanes: how many learners train at once in a task; by default what this machine is best filled with.
      checkpoint_every: seconds between checkpoints.

    Returns:
      The command that submits them.

    Raises:
      ConfigError: the folder cannot be used, or cells depend on what others gave: a search, halving.
      WriteError: the folder could not be written any more.
    """
    if chosen.search is not None or chosen.halving is not None:
        kind = "a search" if chosen.search is not None else "halving"
        raise ConfigError(f"slurm: must be left out for {kind}, where cells depend on what others gave")
    cells = chosen.cells()
    folder = out.resolve()
    icac = [sys.executable, "-m", "icac_jax", "resume", str(folder), "--checkpoint-every", f"{checkpoint_every:g}"]
    with run_folder.created(out, run_folder.SWEEP, chosen.text), writing(out):
        facts = {"lanes": lanes or groups.best_lanes(), "most_jobs": None, "tasks": tasks}
        files.write_text(out / sweep.PLAN, json.dumps(facts) + "\n")
        files.make_folder(out / GROUPS)
        array, collect = (
            {"name": out.name, "folder": folder, "log": log, "options": options, "command": shlex.join(icac) + more}
            for log, options, more in (
                ("%a", f"#SBATCH --array=0-{tasks - 1}\n", ' --task "$SLURM_ARRAY_TASK_ID"'),
                ("collect", "", ""),
            )
        )
        files.write_text(out / ARRAY, _SCRIPT.format(**array))
        files.write_text(out / COLLECT, _SCRIPT.format(**collect))
        run_folder.record(out, "prepared", tasks=tasks, platform=randomness.platform_facts())
        write_status(out, "stopped", 0, sum(cell.settings.run.seeds * cell.settings.run.episodes for cell in cells))
    first, second = (shlex.quote(str(folder / name)) for name in (ARRAY, COLLECT))
    return f"sbatch --dependency=afterany:$(sbatch --parsable {first}) {second}"


def train_task(
    folder: Path,
    task: int,
    checkpoint_every: float = CHECKPOINT_EVERY,
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """Trains what is left of a task's share, and puts nothing together.

    Args:
      folder: of a sweep that `prepare` has written.
      task: its number in the array, from 0.
      checkpoint_every: seconds between checkpoints.
      tell: told, in a line each, what is not as it should be.

    Raises:
      ConfigError: the sweep has no such task, or another process works at it.
      DamagedError: files of an earlier call cannot be read.
      StoppedError: a signal asked for a stop.
      WriteError: the folder could not be written any more.
    """
    chosen = sweep_file.read(folder / run_folder.SWEEP)
    tasks = sweep.planned(folder, "tasks")
    if tasks is None:
        raise ConfigError(f"task: must be of a sweep begun with --slurm, {folder} was not")
    if not 0 <= task < tasks:
        raise ConfigError(f"task: must be a whole number at least 0 and less than {tasks}, got {task}")
    if stages.trained(folder) is not None:
        return
    randomness.check(folder)
    with writing(folder):
        batch = sweep.batch_of(folder, chosen.cells(), 0, None)
        total = sum(group.episodes for group in batch.groups)
        plan = Plan(sweep.planned(folder, "lanes"), checkpoint_every, tell)
        Tasks(tasks, task).train(batch, folder, plan, 0, total)
