"""`icac render`: the trained arm of a run reaching goals."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from icac_jax.cli import parsing
from icac_jax.cli.commands import common


@dataclasses.dataclass(frozen=True)
class RenderOptions:
    """What `icac render` takes."""

    run: parsing.Positional[Path | None] = common.flag(None, "folder of the run")
    seed: str = common.flag("best", "whose policy: a seed, or best in the last tenth")
    policy: str = common.flag("newest", "newest, or best by --evaluate-every; without RUN best-planar2, best-nico4")
    episodes: int = common.flag(4, "how many episodes; in a strip a row each")
    format: str | None = common.flag(None, "mp4 (needs the extra video), gif or png; else as out ends, else gif")
    out: Path | None = common.flag(None, "file; RUN/render-seed-N.FORMAT if not given")
    pair_seed: int = common.flag(0, "randomness of starts and goals, as in evaluate")
    no_cache: bool = common.no_cache()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.of_run("render [RUN]", RenderOptions, args)
    if given is None:
        return 0
    common.prepare(given.no_cache)
    from icac_jax.policies import film

    common.compiling("render")
    to = given.format, given.out
    print(film.render(given.run, given.seed, given.episodes, *to, given.pair_seed, common.warn, given.policy))
    return 0
