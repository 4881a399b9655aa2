"""`icac plot-map`: the topological map of a seed."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from icac_jax.cli import parsing
from icac_jax.cli.commands import common


@dataclasses.dataclass(frozen=True)
class PlotMapOptions:
    """What `icac plot-map` takes."""

    run: parsing.Positional[Path | None] = common.flag(None, "folder of the run")
    seed: str = common.flag("best", "whose map: a seed, or best in the last tenth")
    out: Path | None = common.flag(None, "PNG or SVG file; RUN/map-seed-N.png if not given")
    no_cache: bool = common.no_cache()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.of_run("plot-map RUN", PlotMapOptions, args)
    if given is None:
        return 0
    common.prepare(given.no_cache)
    from icac_jax.policies import map_picture

    common.compiling("plot-map")
    print(map_picture.plot(given.run, given.seed, given.out, common.warn))
    return 0
