"""`icac evaluate`: the saved policies of a run, without exploration, on a fixed set of start and goal pairs."""

import functools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from icac_jax import shapes
from icac_jax.fields import ConfigError
from icac_jax.greedy import GreedyEpisode
from icac_jax.policies import PAIRS
from icac_jax.reports import results, statistics
from icac_jax.runs import best_policies, files, oracles, randomness, session, train, trials
from icac_jax.runs import folder as run_folder
from icac_jax.runs.checkpoints import Checkpoint
from icac_jax.runs.loop import Training
from icac_jax.settings.options import Settings
from icac_jax.settings.worlds import need_arm

FILE = "evaluation.json"
_MOST = 1_000_000
_METRICS = ("success_rate", "steps", "steps_over_oracle", "final_distance")
_SHAPE = shapes.record(
    dict.fromkeys(("arm", "algo", "policy"), shapes.text)
    | dict.fromkeys(("pairs", "pair_seed", "horizon"), shapes.whole)
    | {"episodes_trained": shapes.several(shapes.whole), "oracle_steps": shapes.number}
    | dict.fromkeys(_METRICS, statistics.AS_JSON)
    | {"by_seed": shapes.record(dict.fromkeys(_METRICS, shapes.several(shapes.optional(shapes.number))))}
)


def newest(folder: Path, settings: Settings, warn: Callable[[str], None] = lambda _: None) -> Checkpoint:
    """The newest checkpoint of a run that can be read; newer ones that cannot are told to `warn`.

    Raises:
      ConfigError: the run has none yet, or the configuration or JAX's generator is not the checkpoint's.
      DamagedError: none can be read.
    """
    randomness.check(folder)
    check = functools.partial(train.same_options, folder, settings)
    found, problems = session.latest(folder, Training.of_run(settings), check, records=False)
    for problem in problems:
        warn(f"{problem}; the checkpoint before is evaluated")
    if found is None:
        raise ConfigError(f"run: {folder} has no checkpoint yet")
    return found[0]


def learners(
    folder: Path, settings: Settings, policy: str = best_policies.NEWEST, warn: Callable[[str], None] = lambda _: None
) -> tuple[Any, np.ndarray]:
    """The learners of a run, leaves [S, ...] on the host, and how many episodes [S] each had finished.

    Args:
      folder: of the run.
      settings: of the run.
      policy: "newest", or "best": they act as each did at its best evaluation while it was trained.
      warn: told, in a line each, of checkpoints that cannot be read.

    Raises:
      ConfigError: no such policy, no checkpoint, or nothing is kept.
      DamagedError: nothing of it can be read.
    """
    if policy not in best_policies.POLICIES:
        raise ConfigError(f"policy: must be one of {', '.join(best_policies.POLICIES)}, got {policy!r}")
    lanes = newest(folder, settings, warn).lanes
    seeds = settings.run.seeds
    states = jax.tree.map(lambda leaf: np.asarray(leaf)[:seeds], lanes.agent)
    if policy == best_policies.BEST:
        return best_policies.states_with(folder, settings, states)
    return states, np.asarray(lanes.episode)[:seeds]


def greedy_episodes(settings: Settings, states: Any, pairs: int, seed: int) -> GreedyEpisode:
    """One greedy episode of each policy on each pair: leaves [S, N, ...] on the host.

    Args:
      settings: of the run.
      states: of the learners, leaves [S, ...].
      pairs: N; pair k is the same for every policy and every run of the same task.
      seed: of the pairs.
    """
    return trials.player(settings, pairs, seed)(states)


def check_pairs(name: str, number: int, most: int, pair_seed: int) -> None:
    """Refuses start and goal pairs that are not allowed.

    Args:
      name: of the option that says how many.
      number: how many.
      most: how many are allowed.
      pair_seed: of the pairs.

    Raises:
      ConfigError: one line that names the option.
    """
    if not 1 <= number <= most:
        raise ConfigError(f"{name}: must be a whole number at least 1 and at most {most}, got {number}")
    if not 0 <= pair_seed < 2**32:
        raise ConfigError(f"pair_seed: must be a whole number at least 0 and less than 2^32, got {pair_seed}")


def evaluate(
    folder: Path,
    pairs: int = PAIRS,
    seed: int | None = None,
    warn: Callable[[str], None] = lambda _: None,
    policy: str = best_policies.NEWEST,
) -> dict[str, Any]:
    """Evaluates the policies of a run and writes `evaluation.json` into its folder.

    Args:
      folder: of the run.
      pairs: start and goal pairs per seed.
      seed: of the pairs; 0 by default, and 1 for the best policies, which were chosen by success on pairs of seed 0.
      warn: told, in a line each, of checkpoints that cannot be read and of a folder that cannot be written.
      policy: "newest" or "best", see `learners`.

    Returns:
      Success rate, steps over all episodes, steps / oracle over the successful ones, final distance in m: over seeds
      with intervals, and by seed.

    Raises:
      ConfigError: a number is not allowed, or the folder holds no run, no checkpoint, or a changed configuration.
      DamagedError: no checkpoint can be read.
    """
    seed = (1 if policy == best_policies.BEST else 0) if seed is None else seed
    check_pairs("pairs", pairs, _MOST, seed)
    settings = run_folder.load(folder)
    need_arm(settings, "run", "an evaluation against the oracle")
    states, episodes = learners(folder, settings, policy, warn)
    result = of_states(settings, states, episodes, policy, pairs, seed)
    try:
        files.write_text(folder / FILE, json.dumps(result, indent=2, allow_nan=False) + "\n")
    except OSError as error:
        warn(f"cannot write {folder / FILE}: {error.strerror or error}")
    return result


def of_states(
    settings: Settings, states: Any, episodes: np.ndarray, policy: str, pairs: int, seed: int
) -> dict[str, Any]:
    """Evaluates learners, as `evaluate` does it, and writes nothing.

    Args:
      settings: of their run.
      states: of the learners, leaves [S, ...].
      episodes: [S] that each had finished.
      policy: what the result calls them.
      pairs: start and goal pairs per seed.
      seed: of the pairs.

    Raises:
      ConfigError: a number is not allowed.
    """
    check_pairs("pairs", pairs, _MOST, seed)
    pairs, seed = int(pairs), int(seed)  # of NumPy, perhaps
    played = greedy_episodes(settings, states, pairs, seed)
    least = oracles.steps(settings, played.start.joints, played.start.goal)
    distance = trials.final_distance(settings, played)
    ratio = np.where(played.reached, played.steps / least, np.nan)
    by_seed = {
        "success_rate": played.reached.mean(axis=1),
        "steps": played.steps.mean(axis=1),
        "steps_over_oracle": results.mean_of_known(ratio, axis=1),
        "final_distance": distance.mean(axis=1),
    }
    return {
        "arm": settings.arm.name,
        "algo": settings.algo,
        "policy": policy,
        "pairs": pairs,
        "pair_seed": seed,
        "horizon": settings.params.horizon,
        "episodes_trained": [int(done) for done in episodes],
        "oracle_steps": float(least.mean()),
        **{name: statistics.estimate(values, "mean").as_json() for name, values in by_seed.items()},
        "by_seed": {name: [statistics.finite(value) for value in values] for name, values in by_seed.items()},
    }


def read(folder: Path) -> dict[str, Any] | None:
    """The evaluation of a run, as `evaluate` wrote it; None where there is none that can be read."""
    found = run_folder.read_json(folder / FILE)
    if isinstance(found, dict):
        found.setdefault("policy", best_policies.NEWEST)  # all there was before there were best ones
    return found if shapes.fits(_SHAPE, found) else None


def as_text(result: dict[str, Any]) -> str:
    """The evaluation as a few lines for a person."""

    def line(title: str, name: str, form: str) -> str:
        figure = result[name]
        value, low, high = (
            "-" if figure[key] is None else format(figure[key], form) for key in ("value", "low", "high")
        )
        known = [v for v in result["by_seed"][name] if v is not None]
        spread = f"   seeds {format(min(known), form)} to {format(max(known), form)}" if known else ""
        return f"{title:28}{value:>9}  [{low}, {high}]{spread}"

    others = {best_policies.BEST: "best policy of each seed", best_policies.NEWEST: "no exploration"}
    which = others.get(result["policy"], result["policy"])
    return "\n".join(
        [
            f"{result['algo']} on {result['arm']}, {which}, {result['pairs']:,} start and goal pairs per seed",
            line("success", "success_rate", ".1%"),
            line(f"steps, a failure is {result['horizon']}", "steps", ".2f"),
            line("steps / oracle when reached", "steps_over_oracle", ".2f"),
            line("final distance, m", "final_distance", ".3f"),
            f"{'oracle steps':28}{result['oracle_steps']:>9.2f}",
        ]
    )
