"""The figures of a run: success and steps at the start and at the end, the map, failures, speed."""

from typing import Any

import numpy as np
import pyarrow as pa

from icac_jax.runs import records
from icac_jax.settings.options import Settings


def of_episodes(reached: np.ndarray, steps: np.ndarray, missing: int = 0, horizon: int = 0) -> dict[str, Any]:
    """Success rate and mean steps of a set of episodes.

    Args:
      reached: [E] bool.
      steps: [E] int, the horizon where not reached.
      missing: episodes that a failed lane did not get to; they count as not reached, with `horizon` steps.
      horizon: most steps an episode.

    Returns:
      `success_rate`, `steps` over all episodes (a failure counts as the horizon), `steps_when_reached`; None where
      there is nothing to average.
    """
    reached = np.append(reached, np.zeros(missing, bool))
    steps = np.append(steps, np.full(missing, horizon))
    return {
        "episodes": int(reached.size),
        "success_rate": float(reached.mean()) if reached.size else None,
        "steps": float(steps.mean()) if reached.size else None,
        "steps_when_reached": float(steps[reached].mean()) if reached.any() else None,
    }


def summarise(
    settings: Settings,
    table: pa.Table,
    failed: dict[int, int],
    lane_steps: int,
    seconds: float,
    oracle_steps: float | None,
) -> dict[str, Any]:
    """The summary of a run as JSON can hold it.

    Args:
      settings: of the run.
      table: its episodes (see `records`).
      failed: seed to number of finished episodes, of lanes that diverged.
      lane_steps: steps taken by running lanes.
      seconds: time spent training, compilation left out.
      oracle_steps: mean of the least number of steps to the goal in this task, if it is known.
    """
    episodes = settings.run.episodes
    columns = {name: table[name].to_numpy() for name in ("seed", "episode", "steps", "reached")}
    tenth = max(episodes // 10, 1)
    first, last = columns["episode"] < tenth, columns["episode"] >= episodes - tenth

    def part(chosen: np.ndarray, seeds: int) -> dict[str, Any]:
        missing = seeds * min(tenth, episodes) - int(chosen.sum())
        return of_episodes(columns["reached"][chosen], columns["steps"][chosen], missing, settings.params.horizon)

    by_seed = {str(seed): part(last & (columns["seed"] == seed), 1) for seed in range(settings.run.seeds)}
    ended = part(last, settings.run.seeds)
    returns = {}
    if settings.is_world:
        rewards = table["extrinsic_reward"].to_numpy()
        tenths = (("first_tenth", first), ("last_tenth", last))
        returns = {"returns": {name: float(rewards[of].mean()) if of.any() else None for name, of in tenths}}
    return {
        "arm": settings.arm.name,
        "algo": settings.algo,
        "physics": settings.physics,
        "preset": settings.run.preset,
        "seeds": settings.run.seeds,
        "episodes": episodes,
        "episodes_recorded": table.num_rows,
        "first_tenth": part(first, settings.run.seeds),
        "last_tenth": ended,
        "last_tenth_by_seed": by_seed,
        "oracle_steps": oracle_steps,
        "steps_over_oracle": ended["steps"] / oracle_steps if oracle_steps else None,
        **returns,
        **of_map(table, episodes),
        "failed_seeds": {str(seed): done for seed, done in sorted(failed.items())},
        "lane_steps": lane_steps,
        "seconds": seconds,
        "lane_steps_per_second": lane_steps / seconds if seconds > 0 else None,
    }


def of_map(table: pa.Table, episodes: int) -> dict[str, Any]:
    """What a learner's map came to.

    Args:
      table: episodes of a run, by seed, then episode.
      episodes: of each seed.

    Returns:
      `live_nodes`, the mean over the seeds that have finished, and `overflow`, how many nodes could not be created over
      all seeds; None for a learner that reports no such thing.
    """
    nodes, overflow = (records.column(table, name) for name in ("live_nodes", "overflow"))
    seed, episode = (table[name].to_numpy() for name in ("seed", "episode"))
    at_end = None if nodes is None else nodes[episode == episodes - 1]
    latest = np.diff(seed, append=-1) != 0
    return {
        "live_nodes": float(at_end.mean()) if at_end is not None and at_end.size else None,
        "overflow": None if overflow is None else int(overflow[latest].sum()),
    }


def as_text(summary: dict[str, Any]) -> str:
    """The summary as a few lines for a person."""
    title = "{algo} on {arm} ({physics}, preset {preset}): {seeds} seeds x {episodes} episodes".format(**summary)
    returns = summary.get("returns")
    if returns:
        each = (f"{name.replace('_', ' '):16}return {_number(returns[name], ',.1f')}" for name in returns)
        lines = [title, *each]
    else:
        lines = [title, *_successes(summary)]
    if summary["live_nodes"]:
        lines.append(
            f"{'map':16}{_number(summary['live_nodes'], '.1f')} live nodes per seed, overflow {summary['overflow']}"
        )
    lines.append(
        f"{'speed':16}{_number(summary['lane_steps_per_second'], ',.0f')} lane-steps per second, "
        f"{summary['lane_steps']:,} lane-steps in {summary['seconds']:.1f} s"
    )
    if summary["failed_seeds"]:
        named = ", ".join(f"{seed} (after {done} episodes)" for seed, done in summary["failed_seeds"].items())
        lines.append(f"warning: seed {named} diverged and was frozen there; the others went on")
    return "\n".join(lines)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def _successes(summary: dict[str, Any]) -> list[str]:
    """Success and steps at the start and at the end, the oracle, success by seed."""
    lines = [f"{'':14}{'success':>9}{'steps':>9}{'steps when reached':>21}"]
    for name, key in (("first tenth", "first_tenth"), ("last tenth", "last_tenth")):
        part = summary[key]
        lines.append(
            f"{name:14}{_number(part['success_rate'], '.1%'):>9}{_number(part['steps'], '.2f'):>9}"
            f"{_number(part['steps_when_reached'], '.2f'):>21}"
        )
    if summary.get("oracle_steps") is not None:  # earlier versions did not write it
        lines.append(
            f"{'oracle':14}{'':9}{summary['oracle_steps']:>9.2f}   "
            f"steps / oracle {_number(summary.get('steps_over_oracle'), '.2f')} in the last tenth"
        )
    rates = [part["success_rate"] for part in summary["last_tenth_by_seed"].values()]
    known = sorted(rate for rate in rates if rate is not None)
    if known:
        lines.append(f"{'success by seed':16}min {known[0]:.1%}  median {np.median(known):.1%}  max {known[-1]:.1%}")
    return lines
