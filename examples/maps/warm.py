"""Warm maps against cold ones: does ICAC learn sooner with the map and the predictors of another run?

Two joint ranges of the planar arm. A source run is trained over each; then, on other seeds' goals and starts (another
root seed), ICAC over each range without a map, with that of the same range, and, as a control, with that of the other
range. If any foreign map does as well, it is not knowledge of the arm that helps. Writes `warm.md`, `warm.csv` and
`warm.png`; goes on where it stopped.

Usage: python examples/maps/warm.py --out FOLDER
"""

import argparse
import csv
import functools
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from icac_jax.reports import statistics
from icac_jax.reports.figures import STYLE, looks_by_order
from icac_jax.reports.verdicts import STEPS_TOLERANCE
from icac_jax.runs import devices, train
from icac_jax.runs import folder as run_folder
from icac_jax.settings.options import resolve

RANGES = {
    "half": {"joint_low": (0.0, 0.0), "joint_high": (180.0, 180.0)},
    "full": {"joint_low": (-180.0, -180.0), "joint_high": (180.0, 180.0)},
}
STARTS = {"cold": "no map", "same": "map of the same range", "other": "map of the other range"}
# The rule. A start helps if, against another one, it saves more than the tolerance of steps per episode over the first
# quarter of the episodes, paired by seed, and the 95 % interval lies above 0; it harms if it costs that much; it makes
# no difference if the interval lies within the tolerance; else nothing is decided.
EARLY = 0.25
LATE = 0.1


def decided(saved: statistics.Estimate) -> str:
    """What the rule says of the steps saved."""
    if saved.low > 0 and saved.value > STEPS_TOLERANCE:
        return "helps"
    if saved.high < 0 and saved.value < -STEPS_TOLERANCE:
        return "harms"
    inside = saved.low > -STEPS_TOLERANCE and saved.high < STEPS_TOLERANCE
    return "makes no difference" if inside else "undecided"


def trained(out: Path, options: dict[str, Any]) -> np.ndarray:
    """Steps [S, episodes] of a run in a folder, which is trained, resumed, or read if it is there.

    An episode that does not reach its goal counts as the horizon.
    """
    if not run_folder.is_run(out):
        train.train(resolve(**options), out)
    elif not (out / run_folder.SUMMARY).is_file():
        train.resume(out)
    rows = pq.read_table(out / "episodes.parquet", columns=["seed", "episode", "steps"])
    order = np.lexsort((rows["episode"].to_numpy(), rows["seed"].to_numpy()))
    return rows["steps"].to_numpy()[order].reshape(options["seeds"], -1).astype(float)


def markdown(steps: dict[str, dict[str, np.ndarray]]) -> str:
    """Two tables: what each start led to, and what the rule says of pairs of them."""
    lines = ["| range | start | steps, first quarter | steps, last tenth |", "|---|---|---|---|"]
    pairs = ["| range | start | against | steps saved, first quarter | verdict |", "|---|---|---|---|---|"]
    for place, starts in steps.items():
        low, high = (RANGES[place][end][0] for end in ("joint_low", "joint_high"))
        early = {name: values[:, : _share(values, EARLY)].mean(axis=1) for name, values in starts.items()}
        for name, values in starts.items():
            late = statistics.estimate(values[:, -_share(values, LATE) :].mean(axis=1), "mean")
            first = statistics.estimate(early[name], "mean")
            lines.append(f"| [{low:g}, {high:g}] | {STARTS[name]} | {first.text('.1f')} | {late.text('.1f')} |")
        for name, against in (("same", "cold"), ("other", "cold"), ("same", "other")):
            saved = statistics.paired_difference(early[against], early[name])
            cells = [f"[{low:g}, {high:g}]", STARTS[name], STARTS[against], saved.text("+.1f"), f"**{decided(saved)}**"]
            pairs.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", *pairs]) + "\n"


def _share(values: np.ndarray, share: float) -> int:
    """So many episodes, at least one."""
    return max(1, round(share * values.shape[1]))


def figure(steps: dict[str, dict[str, np.ndarray]]) -> Figure:
    """Mean steps over twenty stretches of the episodes with 95 % intervals over seeds, a panel per range."""
    with matplotlib.rc_context(STYLE):
        page = Figure(figsize=(8.4, 3.6), layout="constrained")
        panels = np.ravel(page.subplots(1, len(steps), sharey=True, squeeze=False))
        for panel, (place, starts) in zip(panels, steps.items(), strict=True):
            for (name, values), look in zip(starts.items(), looks_by_order(len(starts)), strict=True):
                parts = np.array_split(values, min(20, values.shape[1]), axis=1)
                band = statistics.band(np.stack([part.mean(axis=1) for part in parts], axis=1))
                ends = np.cumsum([part.shape[1] for part in parts])
                style = {"color": look.colour, "linestyle": look.line, "marker": look.marker, "markevery": 4}
                panel.plot(ends, band.value, label=STARTS[name], **style)
                panel.fill_between(ends, band.low, band.high, color=look.colour, alpha=0.15, linewidth=0)
            low, high = (RANGES[place][end][0] for end in ("joint_low", "joint_high"))
            panel.set_title(f"joints in [{low:g}, {high:g}] degrees")
            panel.set_xlabel("episodes")
        panels[0].set_ylabel("steps per episode")
        page.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return page


def main(arguments: list[str] | None = None) -> None:
    """Trains what is missing, writes, prints the tables."""
    parser = argparse.ArgumentParser(description="Warm maps against cold ones on the planar arm.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--physics", choices=("servo", "kinematic"), default="servo")
    given = parser.parse_args(arguments)
    devices.use_every_core()
    devices.use_kept()
    common = {"arm": "planar2", "algo": "icac", "physics": given.physics}
    common |= {"seeds": given.seeds, "episodes": given.episodes}
    sources = {place: given.out / f"source-{place}" for place in RANGES}
    for place, folder in sources.items():
        trained(folder, common | RANGES[place] | {"root_seed": 1})
    steps: dict[str, dict[str, np.ndarray]] = {place: {} for place in RANGES}
    for place, start in ((place, start) for place in RANGES for start in STARTS):
        other = next(name for name in RANGES if name != place)
        source = {"cold": None, "same": sources[place], "other": sources[other]}[start]
        warm = {} if source is None else {"warm_map": str(source)}
        run = functools.partial(trained, given.out / f"{place}-{start}")
        steps[place][start] = run(common | RANGES[place] | {"root_seed": 0} | warm)
    with (given.out / "warm.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["range", "start", "seed", "steps_first_quarter", "steps_last_tenth"])
        for place, start in ((place, start) for place in RANGES for start in STARTS):
            for seed, values in enumerate(steps[place][start]):
                early, late = (_share(steps[place][start], share) for share in (EARLY, LATE))
                writer.writerow([place, start, seed, values[:early].mean(), values[-late:].mean()])
    (given.out / "warm.md").write_text(markdown(steps))
    figure(steps).savefig(given.out / "warm.png", dpi=150)
    print(markdown(steps))


if __name__ == "__main__":
    main()
