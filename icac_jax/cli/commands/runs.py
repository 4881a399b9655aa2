"""`icac runs`: the runs in folders."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from icac_jax.cli import parsing
from icac_jax.cli.commands import common


@dataclasses.dataclass(frozen=True)
class RunsOptions:
    """What `icac runs` takes."""

    folders: parsing.Positional[tuple[Path, ...]] = common.flag((Path("runs"),), "folders to look in, at any depth")
    sort: Literal["folder", "date", "state", "algo", "arm", "episodes_done", "success"] = common.flag(
        "folder", "by what; date and success: the latest, the best first"
    )
    filter: tuple[str, ...] = common.flag((), "KEY=VALUE ...: state, algo, arm, task, physics, kind, date, folder")
    json: bool = common.flag(False, "print the list as JSON")


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.options("runs [FOLDER ...]", RunsOptions, args)
    if given is None:
        return 0
    from icac_jax.cli import listing

    found = [listing.describe(folder) for folder in listing.find(list(given.folders))]
    found = listing.by(listing.chosen(found, given.filter), given.sort, given.sort in ("date", "success"))
    print(json.dumps(found) if given.json else listing.as_text(found))
    return 0
