"""`icac evaluate`: what the policies of a run do without exploration."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from icac_jax.cli import parsing
from icac_jax.cli.commands import common
from icac_jax.policies import PAIRS


@dataclasses.dataclass(frozen=True)
class EvaluateOptions:
    """What `icac evaluate` takes."""

    run: parsing.Positional[Path | None] = common.flag(None, "folder of the run")
    pairs: int = common.flag(PAIRS, "start and goal pairs a seed")
    pair_seed: int | None = common.flag(None, "randomness of the pairs; 0, or 1 with --policy best")
    policy: str = common.flag("newest", "newest, or best by --evaluate-every; without RUN best-planar2, best-nico4")
    json: bool = common.flag(False, "print the figures as JSON, and nothing else, on standard output")
    no_cache: bool = common.no_cache()


def main(args: Sequence[str]) -> int:
    """Reads the arguments, does it, returns the exit status."""
    given = common.of_run("evaluate [RUN]", EvaluateOptions, args)
    if given is None:
        return 0
    common.prepare(given.no_cache, learners=[] if given.run is None else common.learners_of(given.run))
    from icac_jax.policies import evaluate, shipped

    shipped.check(given.run, given.policy)
    common.compiling("evaluate")
    if given.run is None:
        result = shipped.evaluated(given.policy, given.pairs, 0 if given.pair_seed is None else given.pair_seed)
    else:
        result = evaluate.evaluate(given.run, given.pairs, given.pair_seed, common.warn, given.policy)
    print(json.dumps(result) if given.json else evaluate.as_text(result))
    return 0
