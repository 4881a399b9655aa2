"""Trains learners on one task and evaluates them without exploration at intervals: a CSV file and a table."""

import argparse
import csv
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from tasks import EPISODES, LEARNERS, TASKS

from icac_jax.envs import oracle
from icac_jax.reports import statistics
from icac_jax.runs import devices, trials
from icac_jax.runs.loop import Training
from icac_jax.settings.options import resolve

Row = dict[str, Any]

PAIRS = 200
COLUMNS = ("task", "learner", "seed", "steps", "episodes", "seconds", "success", "greedy_steps", "oracle_steps")


def curve(
    task: str, name: str, options: dict[str, Any], seeds: int, root_seed: int, most_steps: int, every: int
) -> Iterator[list[Row]]:
    """Rows of one learner: at each interval, one per seed.

    Args:
      task: name of the task.
      name: of the learner in tables.
      options: of both.
      seeds: how many.
      root_seed: of all randomness.
      most_steps: per seed; training ends before if every seed has had its episodes.
      every: steps between evaluations.
    """
    episodes = EPISODES[options["arm"]]
    settings = resolve(**{"episodes": episodes, "seeds": seeds, "root_seed": root_seed} | options)
    training = Training.of_run(settings)
    training.length = every
    play = trials.player(settings, PAIRS, seed=1)
    least = None
    for chunk in training.chunks(training.start()):
        lanes = jax.tree.map(lambda leaf: np.asarray(leaf)[:seeds], chunk.lanes.agent)
        played = play(lanes)
        if least is None:  # every policy plays the same pairs
            starts, goals = played.start.joints[0], played.start.goal[0]
            least = float(np.mean(oracle.steps(settings.arm, settings.params, starts, goals)))
        last = [
            {
                "task": task,
                "learner": name,
                "seed": seed,
                "steps": int(chunk.progress.steps[seed]),
                "episodes": int(chunk.episodes_done[seed]),
                "seconds": round(chunk.seconds, 3),
                "success": float(played.reached[seed].mean()),
                "greedy_steps": float(played.steps[seed].mean()),
                "oracle_steps": least,
            }
            for seed in range(seeds)
        ]
        print(
            f"{task} {name}: {last[0]['steps']:,} steps, {chunk.seconds:.0f} s: success "
            f"{np.mean([row['success'] for row in last]):.1%}, worst {min(row['success'] for row in last):.1%}, "
            f"steps / oracle {np.mean([row['greedy_steps'] for row in last]) / least:.2f}",
            flush=True,
        )
        yield last
        if max(row["steps"] for row in last) >= most_steps:
            break


def line(rows: list[Row]) -> str:
    """The row of a learner in the table: at its end, and when every seed had 95 %."""
    seeds = sorted({row["seed"] for row in rows})
    times = sorted({row["seconds"] for row in rows})
    last = [row for row in rows if row["seconds"] == times[-1]]
    success = statistics.estimate(np.array([row["success"] for row in last]), "mean")
    ratio = statistics.estimate(np.array([row["greedy_steps"] / row["oracle_steps"] for row in last]), "mean")
    there = "never", ""
    for second in times:
        now = [row for row in rows if row["seconds"] == second]
        if len(now) == len(seeds) and min(row["success"] for row in now) >= 0.95:
            there = f"{max(row['steps'] for row in now):,}", f"{second:.0f}"
            break
    cells = [
        last[0]["learner"],
        f"{max(row['steps'] for row in last):,}",
        success.text(".1%"),
        f"{min(row['success'] for row in last):.1%}",
        ratio.text(".2f"),
        *there,
    ]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    """Reads the options, trains, writes, prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--task", choices=TASKS, required=True)
    parser.add_argument("--only", nargs="*", choices=LEARNERS, default=list(LEARNERS))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--root-seed", type=int, default=0)
    parser.add_argument("--steps", type=int, default=20_000, help="most steps per seed")
    parser.add_argument("--every", type=int, default=500, help="steps between evaluations")
    parser.add_argument("--physics", choices=("servo", "kinematic"), default="servo")
    parser.add_argument("--out", type=Path, default=Path())
    given = parser.parse_args()
    devices.use_every_core()
    devices.use_kept()
    path = given.out / f"learners-{given.task}.csv"
    rows, lines = [], []
    begun = time.perf_counter()
    for name in given.only:
        options = TASKS[given.task] | LEARNERS[name] | {"physics": given.physics}
        for now in curve(given.task, name, options, given.seeds, given.root_seed, given.steps, given.every):
            rows += now
            with path.open("w", newline="") as file:
                writer = csv.DictWriter(file, COLUMNS)
                writer.writeheader()
                writer.writerows(rows)
        lines.append(line([row for row in rows if row["learner"] == name]))
    print("| learner | steps | success | worst seed | steps / oracle | steps to 95 % in every seed | seconds |")
    print("|---|---|---|---|---|---|---|")
    print("\n".join(lines))
    print(f"{given.seeds} seeds, {PAIRS} pairs each, {time.perf_counter() - begun:.0f} s in all: {path}")


if __name__ == "__main__":
    main()
