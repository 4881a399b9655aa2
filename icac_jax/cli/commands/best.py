"""`icac best`: the best cell of a sweep, as options that `icac train --config` takes."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.fields import ConfigError


@dataclasses.dataclass(frozen=True)
class BestOptions:
    """What `icac best` takes."""

    folder: parsing.Positional[Path | None] = common.flag(None, "sweep folder")
    metric: Literal["steps", "success_rate", "extrinsic_reward"] | None = common.flag(
        None, "what is best; the search's metric, or steps"
    )


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.options("best FOLDER", BestOptions, args)
    if given is None:
        return 0
    if given.folder is None:
        raise ConfigError("folder: must be the folder of a sweep, got nothing")
    from icac_jax.sweeps.best import best

    print(best(given.folder, given.metric), end="")
    return 0
