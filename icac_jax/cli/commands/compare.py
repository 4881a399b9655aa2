"""`icac compare`: runs beside each other, with intervals."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from icac_jax import console
from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.fields import ConfigError


@dataclasses.dataclass(frozen=True)
class CompareOptions:
    """What `icac compare` takes."""

    runs: parsing.Positional[tuple[Path, ...]] = common.flag(
        (), "runs, sweeps, 'patterns*'; the first is the reference"
    )
    metric: Literal["success_rate", "steps", "steps_when_reached", "extrinsic_reward"] = common.flag(
        "success_rate", "what is compared, in the last tenth"
    )
    png: Path = common.flag(Path("comparison.png"), "file of the figure")
    csv: Path | None = common.flag(None, "file of the table with every number")
    json: bool = common.flag(False, "print the table as JSON, and nothing else")


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.options("compare RUN RUN ...", CompareOptions, args)
    if given is None:
        return 0
    if not given.runs:
        raise ConfigError("runs: must be the folders of runs or sweeps, got nothing")
    from icac_jax.analysis import compare, compare_figure, subjects
    from icac_jax.policies import saved
    from icac_jax.reports import tables

    comparison = compare.compare(subjects.read(given.runs, common.warn), given.metric)
    contents = {given.png: compare_figure.png(comparison)}
    if given.csv is not None:
        contents[given.csv] = compare.as_csv(comparison).encode(errors="surrogateescape")
    for path, content in contents.items():
        with saved.writing(path) as file:
            file.write(content)
    if given.json:
        print(json.dumps(compare.as_rows(comparison)))
    else:
        print(tables.as_text(compare.table(comparison)))
        print("written to " + ", ".join(console.shown(path) for path in contents))
    return 0
