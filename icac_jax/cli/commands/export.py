"""`icac export`: the policy of a seed as a file of its own."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from icac_jax import console
from icac_jax.cli import parsing
from icac_jax.cli.commands import common


@dataclasses.dataclass(frozen=True)
class ExportOptions:
    """What `icac export` takes."""

    run: parsing.Positional[Path | None] = common.flag(None, "folder of the run")
    seed: str = common.flag("best", "whose policy: a seed, or best in the last tenth")
    policy: str = common.flag("newest", "newest, or each seed's best by --evaluate-every")
    format: str | None = common.flag(None, "npz, onnx (extra), jax; or folder: npz, reader, card")
    out: Path | None = common.flag(None, "file or folder; RUN/policy-seed-N... if not given")
    no_cache: bool = common.no_cache()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.of_run("export RUN", ExportOptions, args)
    if given is None:
        return 0
    common.prepare(given.no_cache)
    from icac_jax.policies import export

    common.compiling("export")
    print(export.export(given.run, given.seed, given.format or "npz", given.out, common.warn, given.policy))
    if given.format is None and given.out is None:
        folder = export.export(given.run, given.seed, export.FOLDER, policy=given.policy)
        console.say(f"with its reader and a card: {console.shown(folder)}")
    return 0
