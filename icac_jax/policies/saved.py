"""One learner out of a run: which seed, and what it had learnt at the newest checkpoint."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import jax
import numpy as np

from icac_jax.fields import ConfigError
from icac_jax.policies import evaluate
from icac_jax.runs import best_policies, files, stored_summary
from icac_jax.runs import folder as run_folder
from icac_jax.settings.options import Settings
from icac_jax.settings.worlds import need_arm

BEST = "best"


class Learner(NamedTuple):
    """A learner of a run.

    Attributes:
      settings: of the run.
      seed: which lane it was.
      agent: its state, leaves on the host without a lane axis.
      episodes: how many it had finished.
    """

    settings: Settings
    seed: int
    agent: Any
    episodes: int


def pick(
    folder: Path,
    seed: str = BEST,
    warn: Callable[[str], None] = lambda _: None,
    policy: str = best_policies.NEWEST,
) -> Learner:
    """The learner of a seed of a run.

    Args:
      folder: of the run.
      seed: a number, or "best": the highest success rate in the last tenth (of the best policies: at their
        evaluations), among equals the fewest steps.
      warn: told, in a line each, of checkpoints that cannot be read.
      policy: "newest" or "best", see `evaluate.learners`.

    Raises:
      ConfigError: no run, no checkpoint, no such seed, no summary to find the best with, or numbers of the seed are
        not finite.
      DamagedError: no checkpoint can be read, or the summary that the best is found with.
    """
    settings = run_folder.load(folder)
    need_arm(settings, "run", "this")
    best_of_best = seed == BEST and policy == best_policies.BEST
    number = 0 if best_of_best else _best(folder, settings) if seed == BEST else _number(seed)
    if number is None or not 0 <= number < settings.run.seeds:
        allowed = f"{BEST} or a whole number from 0 to {settings.run.seeds - 1}"
        raise ConfigError(f"seed: must be {allowed}, got {seed!r}")
    states, episodes = evaluate.learners(folder, settings, policy, warn)
    if best_of_best and (kept := best_policies.read(folder, settings, states)) is not None:
        number = int(np.lexsort((kept.steps, -kept.success_rate))[0])
    agent = jax.tree.map(lambda leaf: leaf[number], states)
    numbers = [leaf for leaf in jax.tree.leaves(agent) if np.issubdtype(leaf.dtype, np.floating)]
    if not all(np.isfinite(leaf).all() for leaf in numbers):
        raise ConfigError(f"seed: seed {number} diverged, take another")
    return Learner(settings, number, agent, int(episodes[number]))


def _number(text: str) -> int | None:
    try:
        return int(text)
    except ValueError:
        return None


def _best(folder: Path, settings: Settings) -> int:
    """The seed with the highest success rate in the last tenth of a finished run; among equals the fewest steps."""
    summary = stored_summary.read(folder, settings)
    by_seed = {} if summary is None else summary["last_tenth_by_seed"]
    ranked = [
        (-part["success_rate"], part["steps"], int(seed))
        for seed, part in by_seed.items()
        if part["success_rate"] is not None and part["steps"] is not None
    ]
    if not ranked:
        raise ConfigError(
            f"seed: {BEST} needs the {run_folder.SUMMARY} of a finished run, {folder} has none; name a seed"
        )
    return min(ranked)[-1]


@contextlib.contextmanager
def writing(path: Path) -> Iterator[IO[bytes]]:
    """A file that takes the place of `path` when the block ends; what a command was asked to write.

    Raises:
      ConfigError: it cannot be written there.
    """
    try:
        with files.replacing(path) as file:
            yield file
    except OSError as error:
        raise ConfigError(f"out: cannot write {path}: {error.strerror or error}") from error
