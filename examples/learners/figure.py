"""Draws success without noise against steps and against seconds, from the files that `compare.py` wrote."""

import argparse
import csv
from collections import defaultdict
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np

matplotlib.use("Agg")
# One look per learner, in the order of the table; dashes are hindsight.
LOOKS = {
    "cacla": ("tab:gray", "-"),
    "cacla_var": ("tab:olive", "-"),
    "icac": ("tab:blue", "-"),
    "cacla + hindsight": ("tab:gray", "--"),
    "cacla_var + hindsight": ("tab:olive", "--"),
    "icac + hindsight": ("tab:blue", "--"),
    "ddpg": ("tab:brown", "-"),
    "td3": ("tab:orange", "-"),
    "td3 + hindsight": ("tab:orange", "--"),
    "best": ("tab:red", "-"),
}


def curves(path: Path, over: str) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """By learner: the axis [T], and mean, least and largest success over seeds [T]."""
    found: dict[str, dict[float, list[float]]] = defaultdict(lambda: defaultdict(list))
    with path.open(newline="") as file:
        for row in csv.DictReader(file):
            found[row["learner"]][float(row[over])].append(float(row["success"]))
    result = {}
    for learner, times in found.items():
        # Seeds that have had their episodes stand still: only times with most seeds are drawn.
        most = max(map(len, times.values()))
        axis = [time for time in sorted(times) if len(times[time]) == most]
        values = [np.array(times[time]) for time in axis]
        result[learner] = (np.array(axis), *(np.array([f(v) for v in values]) for f in (np.mean, np.min, np.max)))
    return result


def main() -> None:
    """Draws one figure per file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="+", type=Path)
    for path in parser.parse_args().files:
        figure, panels = plt.subplots(1, 2, figsize=(11, 4), sharey=True, layout="constrained")
        for panel, over in zip(panels, ("steps", "seconds"), strict=True):
            for learner, (axis, mean, low, high) in curves(path, over).items():
                color, dashes = LOOKS[learner]
                panel.plot(axis, 100 * mean, dashes, color=color, label=learner)
                panel.fill_between(axis, 100 * low, 100 * high, color=color, alpha=0.12, linewidth=0)
            panel.set_xlabel("steps per seed" if over == "steps" else "seconds of training, all seeds together")
            panel.grid(alpha=0.3)
            panel.set_ylim(0, 101)
            panel.set_xlim(left=0)
        panels[1].set_xscale("symlog", linthresh=1.0)
        panels[0].set_ylabel("goals reached without noise, %")
        figure.legend(*panels[0].get_legend_handles_labels(), fontsize=8, loc="outside right center")
        figure.suptitle(f"{path.stem.removeprefix('learners-')}: mean over seeds, band from the worst to the best seed")
        figure.savefig(path.with_suffix(".png"), dpi=120)
        print(path.with_suffix(".png"))


if __name__ == "__main__":
    main()
