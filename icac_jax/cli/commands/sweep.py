"""`icac sweep`: every cell of a sweep file, trained together wherever cells share a program."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from icac_jax import console
from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.fields import ConfigError


@dataclasses.dataclass(frozen=True)
class SweepOptions(common.Processes):
    """What `icac sweep` takes."""

    file: parsing.Positional[Path | None] = common.flag(None, "TOML, W&B's YAML, or a shipped study's name")
    out: Path | None = common.flag(None, "sweep folder; runs/FILE-NNN if not given")
    dry_run: bool = common.flag(False, "print cells, programs, lanes, time, memory; train nothing")
    nodes: int = common.flag(1, "of --dry-run: nodes of two cores that would share it")
    lanes: int | None = common.flag(None, "learners that train at once; the best for the machine")
    seeds: int | None = common.flag(None, "instead of the file's seeds")
    episodes: int | None = common.flag(None, "instead of the file's episodes")
    physics: str | None = common.flag(None, "instead of the file's physics")
    engine: Literal["local", "ray"] = common.flag("local", "this machine, or a Ray cluster (extra ray)")
    address: str | None = common.flag(None, "of the Ray cluster; a local one if not given")
    slurm: int | None = common.flag(None, "write a Slurm job array of so many tasks; train nothing")
    json: bool = common.flag(False, "print the summary as JSON, and nothing else, on standard output")
    no_cache: bool = common.no_cache()
    checkpoint_every: float = common.checkpoint_every()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.options("sweep FILE", SweepOptions, args)
    if given is None:
        return 0
    if given.file is None:
        raise ConfigError("file: must be a sweep file or the name of a shipped one, got nothing")
    if given.lanes is not None and not 1 <= given.lanes <= 10**6:
        raise ConfigError(f"lanes: must be a whole number at least 1 and at most 1000000, got {given.lanes}")
    if not 1 <= given.nodes <= 10**6:
        raise ConfigError(f"nodes: must be a whole number at least 1 and at most 1000000, got {given.nodes}")
    if given.nodes > 1 and not given.dry_run:
        raise ConfigError("nodes: must be given with --dry-run; how to use several: docs/scaling.md, Several hosts")
    if given.address is not None and given.engine != "ray":
        raise ConfigError("address: must be given with --engine ray, the local engine has none")
    if given.slurm is not None:
        if not 1 <= given.slurm <= 10**5:
            raise ConfigError(f"slurm: must be a whole number at least 1 and at most 100000, got {given.slurm}")
        if given.engine == "ray" or given.coordinator is not None:
            raise ConfigError("slurm: must be left out with --engine ray and --coordinator, its tasks never meet")
    if given.coordinator is not None and given.engine == "ray":
        raise ConfigError("coordinator: must be left out with --engine ray, which finds its machines by itself")
    from icac_jax.runs import folder
    from icac_jax.sweeps import sweep_file

    changed = {name: getattr(given, name) for name in ("seeds", "episodes", "physics")}
    file = sweep_file.find(given.file)
    chosen = sweep_file.read(file, common.warn, **{name: value for name, value in changed.items() if value is not None})
    common.prepare(given.no_cache, given.checkpoint_every, chosen.learners)
    if given.dry_run:
        from icac_jax.sweeps import plan

        facts = plan.plan(chosen, given.lanes, given.nodes)
        print(json.dumps(facts) if given.json else plan.as_text(facts))
        return 0
    if given.slurm is not None:
        from icac_jax.sweeps import slurm

        out = given.out or folder.next_free(Path("runs"), file.stem)
        print(slurm.prepare(chosen, out, given.slurm, given.lanes, given.checkpoint_every))
        return 0
    from icac_jax.sweeps import sweep
    from icac_jax.sweeps.engine import Local

    process = given.connect()
    common.need_folder(given.out, process)
    out = given.out or folder.next_free(Path("runs"), file.stem)
    if given.engine == "ray":
        from icac_jax.sweeps.ray_engine import Ray

        engine = Ray(given.address)
    else:
        engine = Local(process)
    with common.shared(process, out):
        result = sweep.sweep(chosen, out, given.lanes, given.checkpoint_every, common.warn, engine)
    return show(result, out, given.json)


def show(result: dict[str, Any], out: Path, as_json: bool) -> int:
    """Prints a sweep's summary; status 5 if every lane failed."""
    from icac_jax.sweeps import summary

    print(json.dumps(result) if as_json else f"{summary.as_text(result)}\nwritten to {console.shown(out)}")
    return common.status_of_failures(result["failed_lanes"], result["lanes_trained"])
