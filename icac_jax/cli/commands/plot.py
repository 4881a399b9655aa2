"""`icac plot`: the curves of one run, as pictures and as a page."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from icac_jax import console
from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.fields import ConfigError


@dataclasses.dataclass(frozen=True)
class PlotOptions:
    """What `icac plot` takes."""

    run: parsing.Positional[Path | None] = common.flag(None, "folder of the run")
    film: bool = common.flag(True, "show the arm in the report; --no-film for curves alone")
    no_cache: bool = common.no_cache()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.of_run("plot RUN", PlotOptions, args)
    if given is None:
        return 0
    common.prepare(given.no_cache)
    from icac_jax.analysis import run_page

    try:
        written = run_page.write(given.run, given.film, as_files=True, warn=common.warn)
    except OSError as error:
        raise ConfigError(f"run: cannot write to {given.run}: {error.strerror or error}") from error
    print("\n".join(map(console.shown, written)))
    return 0
