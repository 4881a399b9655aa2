"""`icac resume`: go on with a run that was stopped or killed."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.fields import ConfigError


@dataclasses.dataclass(frozen=True)
class ResumeOptions(common.Processes):
    """What `icac resume` takes."""

    run: parsing.Positional[Path | None] = common.flag(None, "folder of the run, sweep or reproduction")
    episodes: int | None = common.flag(None, "go on to this many episodes a learner, more than before")
    task: int | None = common.flag(None, "of a sweep that --slurm wrote: train this task's share only")
    checkpoint_every: float = common.checkpoint_every()
    json: bool = common.flag(False, "print the summary as JSON, and nothing else, on standard output")
    no_cache: bool = common.no_cache()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.of_run("resume RUN", ResumeOptions, args)
    if given is None:
        return 0
    common.prepare(given.no_cache, given.checkpoint_every, common.learners_of(given.run))
    from icac_jax import tracking
    from icac_jax.runs import folder, train

    if given.task is not None:
        from icac_jax.sweeps import slurm

        if given.coordinator is not None or given.episodes is not None or not folder.is_sweep(given.run):
            raise ConfigError("task: must be given with a sweep that --slurm wrote, without coordinator, episodes")
        slurm.train_task(given.run, given.task, given.checkpoint_every, common.warn)
        return 0
    process = given.connect()
    if folder.is_sweep(given.run):
        from icac_jax.cli.commands import sweep as sweep_command
        from icac_jax.sweeps import sweep
        from icac_jax.sweeps.engine import Local

        if given.episodes is not None:
            raise ConfigError("episodes: must be left out for a sweep, its file says how many")
        with common.shared(process, given.run):
            result = sweep.resume(given.run, given.checkpoint_every, common.warn, Local(process))
        return sweep_command.show(result, given.run, given.json)
    if not folder.is_run(given.run) and given.run.is_dir():
        from icac_jax.cli.commands import reproduce as reproduce_command
        from icac_jax.paper import plan

        reproduction = plan.read(given.run)
        if reproduction is not None:
            if given.episodes is not None or process.count > 1:
                raise ConfigError("episodes, num_processes: must be left out for a reproduction, which has its own")
            return reproduce_command.run(reproduction, given.run, given.checkpoint_every, given.json)
    with common.shared(process, given.run):
        result = train.resume(
            given.run,
            given.episodes,
            given.checkpoint_every,
            common.warn,
            process,
            lambda: tracking.of_run(given.run, common.warn),
        )
    if process.index == 0:
        from icac_jax.analysis import run_page  # draws, which training does not need

        run_page.after_training(given.run, common.warn)
    return common.show(result, given.run, given.json)
