"""How many training episodes demonstrations spare: a study of sweeps/demonstrations.toml, judged by a rule.

The figure of a seed is the number of training episodes after which 95 % of its last 50 ended in the goal zone; a seed
that never gets there has all its episodes. The rule, written before the study was run: so many demonstrations help a
learner where the mean over seeds of (figure with none - figure with them) has a 95 % bootstrap interval above 0, they
harm where it lies below 0, and nothing is decided otherwise. Seeds are paired: with and without demonstrations a seed
has the same starts, goals and noise. Where half the seeds never get there, with demonstrations and without, the figure
has no verdict; the success in the first and in the last 50 episodes stands beside it.

Usage: python examples/demonstrations.py [--out FOLDER] [--seeds N] [--episodes N]; again it goes on, or only judges
"""

import argparse
import csv
import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from icac_jax.reports import statistics
from icac_jax.reports.figures import STYLE, looks_by_order
from icac_jax.runs import devices
from icac_jax.sweeps import recorded, sweep, sweep_file

STUDY = Path(__file__).resolve().parents[1] / "sweeps" / "demonstrations.toml"
WINDOW, SHARE = 50, 0.95
COLUMNS = (
    "algo",
    "episodes shown",
    "noise",
    "first 50",
    "last 50",
    "episodes to 95 %",
    "got there",
    "spared",
    "verdict",
)


def reached_of(result: Any) -> np.ndarray:
    """Which episodes [S, E] of a cell ended in the goal zone; not those that a seed lacks."""
    run = result.settings.run
    reached = np.zeros((run.seeds, run.episodes), bool)
    seed, episode, ended = (result.table[name].to_numpy() for name in ("seed", "episode", "reached"))
    reached[seed, episode] = ended
    return reached


def episodes_to(reached: np.ndarray) -> np.ndarray:
    """The figure [S] of seeds whose episodes [S, E] reached their goal or did not."""
    width = min(WINDOW, reached.shape[1])
    sums = np.cumsum(np.pad(reached.astype(int), ((0, 0), (1, 0))), axis=1)
    there = sums[:, width:] - sums[:, :-width] >= SHARE * width
    return np.where(there.any(axis=1), there.argmax(axis=1) + width, reached.shape[1])


def verdict(spared: statistics.Estimate) -> str:
    """What the rule says of the mean number of episodes spared, with its interval."""
    return "help" if spared.low > 0 else "harm" if spared.high < 0 else "undecided"


def judged(results: list[Any]) -> list[dict[str, Any]]:
    """A row per cell, in the order of the study; the first cell of a learner is the one without demonstrations."""
    rows, without = [], {}
    for result in results:
        run, shown = result.settings.run, result.settings.imitation
        reached = reached_of(result)
        figure = episodes_to(reached)
        without.setdefault(run.algo, figure)
        spared = statistics.estimate(without[run.algo] - figure, "mean")
        got_there = np.mean(figure < run.episodes)
        numbers = f"{spared.value:.0f} [{spared.low:.0f}, {spared.high:.0f}]" if shown.demonstrated_episodes else ""
        too_few = got_there < 0.5 and np.mean(without[run.algo] < run.episodes) < 0.5
        words = "" if not shown.demonstrated_episodes else "half never get there" if too_few else verdict(spared)
        first, last = (f"{part.mean():.0%}" for part in (reached[:, :WINDOW], reached[:, -WINDOW:]))
        values = (run.algo, shown.demonstrated_episodes, shown.demonstration_noise, first, last)
        rows.append(
            dict(zip(COLUMNS, (*values, f"{figure.mean():.0f}", f"{got_there:.0%}", numbers, words), strict=True))
        )
    return rows


def written(rows: list[dict[str, Any]], out: Path) -> str:
    """The table in Markdown, written beside its CSV into a folder."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    lines += ["| " + " | ".join(str(row[name]) for name in COLUMNS) + " |" for row in rows]
    text = "\n".join(lines) + "\n"
    (out / "demonstrations.md").write_text(text)
    with (out / "demonstrations.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    return text


def drawn(results: list[Any], path: Path) -> None:
    """Success over training, a panel per learner, a line per number of exact demonstrations, bands over seeds."""
    learners = {"cacla_var": "CACLA+Var", "icac": "ICAC", "td3": "TD3 with hindsight"}
    exact = [result for result in results if not result.settings.imitation.demonstration_noise]
    numbers = list(dict.fromkeys(result.settings.imitation.demonstrated_episodes for result in exact))
    looks = dict(zip(numbers, looks_by_order(len(numbers)), strict=True))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.6, 3.6), layout="constrained")
        panels = figure.subplots(1, len(learners), sharey=True)
        for panel, (algo, title) in zip(panels, learners.items(), strict=True):
            for result in exact:
                if result.settings.algo != algo:
                    continue
                shown = result.settings.imitation.demonstrated_episodes
                reached = reached_of(result)
                width = min(WINDOW, reached.shape[1])
                blocks = reached[:, : reached.shape[1] // width * width].reshape(len(reached), -1, width).mean(axis=2)
                x, look = width * (1 + np.arange(blocks.shape[1])), looks[shown]
                band = statistics.band(blocks)
                words = f"{shown} shown" if shown else "none shown"
                style = {"color": look.colour, "linestyle": look.line, "marker": look.marker, "markevery": 3}
                panel.plot(x, band.value, label=words, **style)
                panel.fill_between(x, band.low, band.high, color=look.colour, alpha=0.15, linewidth=0)
            panel.axhline(SHARE, color="#888888", linewidth=0.8)
            panel.set(title=title, xlabel="training episodes", ylim=(0, 1.02))
            panel.yaxis.set_major_formatter(PercentFormatter(1))
        panels[0].set_ylabel("success")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(numbers))
        figure.savefig(path, dpi=150)


def main() -> None:
    """Runs the study, or goes on with it, and judges it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("runs/demonstrations"))
    parser.add_argument("--seeds", type=int)
    parser.add_argument("--episodes", type=int)
    given = parser.parse_args()
    devices.use_every_core()
    devices.use_compile_cache()
    changed = {name: value for name in ("seeds", "episodes") if (value := getattr(given, name)) is not None}
    chosen = sweep_file.read(STUDY, **changed)
    sweep.sweep(chosen, given.out)
    cells = json.loads((given.out / "summary.json").read_text())["cells"]
    results = recorded.of_table(chosen, cells, given.out)
    print(written(judged(results), given.out), end="")
    drawn(results, given.out / "demonstrations.png")


if __name__ == "__main__":
    main()
