"""`icac demonstrate`: episodes of the oracle's planner as a file that `icac train --demonstrations` starts from."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from icac_jax import console
from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.fields import ConfigError

# What a run is beside its task and learner, as far as demonstrations depend on it.
_OF_RUN = ("arm", "tip", "preset", "task", "physics", "sub_steps", "root_seed")


@dataclasses.dataclass(frozen=True)
class DemonstrateOptions:
    """What `icac demonstrate` takes beside the options of the task."""

    arm: parsing.Positional[str] = common.flag("planar2", "planar2, nico4, or a file or folder of an own arm")
    out: Path | None = common.flag(None, "Parquet file; ARM-demonstrations.parquet if not given")
    episodes: int = common.flag(20, "episodes, each of which ends in the goal zone")
    noise: float = common.flag(0.0, "standard deviation of the noise on each action, in action bounds")
    seed: int = common.flag(0, "those that a run would show to this seed")
    no_cache: bool = common.no_cache()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    from icac_jax.cli import help
    from icac_jax.envs.goals import GoalOptions
    from icac_jax.envs.reach import ReachParams
    from icac_jax.settings import options

    if {"-h", "--help"} & set(args):
        print(help.command("demonstrate ARM", DemonstrateOptions))
        print("  and of icac train: " + ", ".join("--" + name.replace("_", "-") for name in _OF_RUN[1:]) + ",")
        print("  and what icac train --help-task lists: the limits of the joints, where starts and goals are, ...")
        return 0
    numbers = [field.name for record in (ReachParams, GoalOptions) for field in dataclasses.fields(record)]
    declared = {name: options.COMMON[name] for name in (*_OF_RUN[1:], *numbers)}
    own = [(field.name, field.type, field) for field in dataclasses.fields(DemonstrateOptions)]
    kinds: dict[str, Any] = {name: field.type for name, field in declared.items()}
    of_task = [(name, kind | None, dataclasses.field(default=None)) for name, kind in kinds.items()]
    record: Any = dataclasses.make_dataclass("Demonstrate", own + of_task, frozen=True)
    given = parsing.parse("demonstrate", record, args, declared)
    for name, value, most in (("episodes", given.episodes, 10**6), ("seed", given.seed, 2**31 - 1)):
        if not (name == "episodes") <= value <= most:
            raise ConfigError(f"{name}: must be a whole number at least {int(name == 'episodes')} and at most {most}")
    said = {name: getattr(given, name) for name in declared if getattr(given, name) is not None}
    resolved = options.resolve(
        arm=given.arm,
        demonstrations="oracle",
        demonstrated_episodes=given.episodes,
        demonstration_noise=given.noise,
        **said,
    )
    common.prepare(given.no_cache)
    from icac_jax.runs import build, demonstrations

    common.compiling("demonstrate")
    recorded = demonstrations.of_oracle(resolved, given.seed)
    out = given.out or Path(f"{resolved.arm.name}-demonstrations.parquet")
    run = resolved.run
    facts = {name: getattr(run, name) for name in ("physics", "sub_steps", "root_seed")}
    facts |= {"by": "oracle", "noise": given.noise, "seed": given.seed}
    demonstrations.write(out, recorded, resolved.arm, build.task(resolved, given.seed), **facts)
    steps = len(recorded.episode)
    print(f"{recorded.episodes:,} episodes, {steps:,} steps, {steps / recorded.episodes:.2f} per episode")
    print(f"written to {console.shown(out)}")
    return 0
