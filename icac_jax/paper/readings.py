"""What a study of readings says: how far the paper's figures depend on what the paper leaves open.

A reading is one setting of all open points. The study (`sweeps/readings.toml`) trains the three algorithms of the paper
under each, on the same starts and goals. `python -m icac_jax.paper.readings FOLDER` reads such a sweep and writes
`readings.md`, `readings.png` and `nearest.toml` into it: the readings nearest to the paper as a study of their own,
with other seeds, because the nearest of a thousand is near by luck too. R is the number of readings.
"""

import argparse
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from icac_jax.errors import ConfigError
from icac_jax.paper import claims
from icac_jax.reports import statistics, tables, titles
from icac_jax.reports.tables import Table
from icac_jax.reports.verdicts import STEPS_TOLERANCE
from icac_jax.runs import files
from icac_jax.runs import folder as run_folder
from icac_jax.sweeps import axes, best, sweep_file

ALGORITHMS = tuple(claims.ALGORITHMS)
NEAREST = 10
# Values that were drawn are put into so many groups of equal size.
GROUPS = 4
# How often values are put into disorder to see what they explain by chance.
DISORDERS = 200


class Readings(NamedTuple):
    """The end of learning under each reading.

    Attributes:
      arm: its name.
      options: [R] what each reading sets.
      steps: by algorithm, [R] mean steps of the last tenth over seeds, a failure counting as the horizon.
      leads: [R, S] steps that CACLA+Var needs more than ICAC, by seed.
      paper: the paper's steps, by algorithm.
    """

    arm: str
    options: list[dict[str, Any]]
    steps: dict[str, np.ndarray]
    leads: np.ndarray
    paper: dict[str, float]

    @property
    def lead(self) -> np.ndarray:
        """[R] mean of the leads over seeds."""
        return np.nanmean(self.leads, axis=1)

    @property
    def distance(self) -> np.ndarray:
        """[R] root mean square difference to the paper's three figures, in steps."""
        squares = [(self.steps[name] - value) ** 2 for name, value in self.paper.items()]
        return np.sqrt(np.mean(squares, axis=0))

    @property
    def in_order(self) -> np.ndarray:
        """[R] bool, ICAC before CACLA+Var before CACLA, each by more than the tolerance of a figure."""
        worst, middle, best = (self.steps[name] for name in ALGORITHMS)
        return (worst - middle > STEPS_TOLERANCE) & (middle - best > STEPS_TOLERANCE)


def of(rows: list[dict[str, Any]], arm: str) -> Readings:
    """The readings of a trained study.

    Args:
      rows: its table of cells (`sweeps.tables.row`), which differ in the algorithm and in open points.
      arm: its name.

    Raises:
      ConfigError: a reading lacks one of the three algorithms.
    """
    by_reading: dict[str, dict[str, dict[str, Any]]] = {}
    for row in rows:
        reading = {name: value for name, value in row["varied"].items() if name != "algo"}
        key = repr(sorted(reading.items()))
        by_reading.setdefault(key, {})[row["varied"].get("algo", "")] = row | {"own": reading}
    for one in by_reading.values():
        if set(one) != set(ALGORITHMS):
            raise ConfigError(f"sweep: each reading must have been trained with {', '.join(ALGORITHMS)}")

    def seeds(one: dict[str, dict[str, Any]], name: str) -> np.ndarray:
        return np.array(one[name]["by_seed"]["steps"], float)

    found = list(by_reading.values())
    return Readings(
        arm=arm,
        options=[one[ALGORITHMS[-1]]["own"] for one in found],
        steps={name: np.array([np.nanmean(seeds(one, name)) for one in found]) for name in ALGORITHMS},
        leads=np.array([seeds(one, "cacla_var") - seeds(one, "icac") for one in found]),
        paper=claims.paper_marks(arm, "steps"),
    )


def _drawn(values: list[Any]) -> bool:
    """Whether the values of an option were drawn from a range rather than chosen among a few."""
    return len({repr(value) for value in values}) > 2 * GROUPS


def nearest(readings: Readings) -> list[int]:
    """The readings nearest to the paper, nearest first, no two with the same drawn numbers."""
    numbers = [name for name in readings.options[0] if _drawn([one[name] for one in readings.options])]
    taken: dict[Any, int] = {}
    for place in np.argsort(readings.distance, kind="stable"):
        key = tuple(readings.options[place][name] for name in numbers) or int(place)
        taken.setdefault(key, int(place))
    return list(taken.values())[:NEAREST]


def explained(readings: Readings, figure: np.ndarray) -> list[tuple[str, float, float]]:
    """How much of a figure's variance between readings the main effect of each open point explains, most first.

    Functional ANOVA with group means (Hutter et al. 2014, first-order terms): the variance of the means of groups with
    the same value, or with neighbouring values where they were drawn, over the variance of all.

    Args:
      readings: of the study.
      figure: [R].

    Returns:
      For each open point: its name, its share, and the share to be expected had it no effect: the mean of what its
      values explain in disorder. Readings that share a draw, or a setting of the choices, are no trials of their own:
      what they have in common is put into disorder as a whole.
    """
    found = []
    for name in readings.options[0]:
        values = [one[name] for one in readings.options]
        units = _units(readings, name)
        firsts = [values[place] for place in np.unique(units, return_index=True)[1]]
        labels = _labels(firsts)
        if labels.max(initial=0) > 0:
            rng = np.random.default_rng(0)
            in_disorder = [_share(figure, rng.permutation(labels)[units]) for _ in range(DISORDERS)]
            found.append((name, _share(figure, labels[units]), float(np.mean(in_disorder))))
    return sorted(found, key=lambda one: -one[1])


def _units(readings: Readings, name: str) -> np.ndarray:
    """[R] number of the draw, or of the setting of choices, from which each reading has an option's value."""

    def numbered(names: list[str]) -> np.ndarray:
        keys = [repr([one[name] for name in names]) for one in readings.options]
        return np.unique(keys, return_inverse=True)[1]

    def follows(draws: np.ndarray, name: str) -> bool:
        pairs = {(draw, repr(one[name])) for draw, one in zip(draws, readings.options, strict=True)}
        return len(pairs) == len(set(draws))

    every = list(readings.options[0])
    draws = numbered([name for name in every if _drawn([one[name] for one in readings.options])])
    return draws if follows(draws, name) else numbered([name for name in every if not follows(draws, name)])


def _labels(values: list[Any]) -> np.ndarray:
    """The group of each value: equal ones, or a quarter of the range where they were drawn."""
    if _drawn(values):
        labels = np.zeros(len(values), int)
        for number, places in enumerate(np.array_split(np.argsort(np.array(values, float), kind="stable"), GROUPS)):
            labels[places] = number
        return labels
    return np.unique([repr(value) for value in values], return_inverse=True)[1]


def _share(figure: np.ndarray, labels: np.ndarray) -> float:
    return statistics.explained(figure, [np.flatnonzero(labels == label) for label in np.unique(labels)])[0]


def distribution(readings: Readings) -> Table:
    """How the lead of ICAC over CACLA+Var is distributed over readings."""
    lead = readings.lead
    shares = (1, 5, 25, 50, 75, 95, 99)
    rows = [
        ("least, largest", f"{lead.min():+.1f}, {lead.max():+.1f}"),
        *((f"{share} % of the readings are below", f"{np.percentile(lead, share):+.1f}") for share in shares),
        (f"more than {STEPS_TOLERANCE} ahead", f"{np.mean(lead > STEPS_TOLERANCE):.1%}"),
        (f"more than {STEPS_TOLERANCE} behind", f"{np.mean(lead < -STEPS_TOLERANCE):.1%}"),
        ("in the paper's order, each lead above the tolerance", f"{np.mean(readings.in_order):.1%}"),
    ]
    return Table(f"Lead of ICAC over CACLA+Var in steps, {len(lead):,} readings on {readings.arm}", ("", "lead"), rows)


def nearest_table(readings: Readings) -> Table:
    """The readings nearest to the paper's three figures."""
    header = ("distance", *(titles.RUNS[name] for name in ALGORITHMS), "lead", "reading")
    text = ", ".join(f"{titles.RUNS[name]} {value:g}" for name, value in readings.paper.items())
    rows = []
    for place in nearest(readings):
        words = " ".join(f"{name}={_rounded(value)}" for name, value in readings.options[place].items())
        figures = (f"{readings.steps[name][place]:.1f}" for name in ALGORITHMS)
        lead = statistics.estimate(readings.leads[place], "mean")
        rows.append((f"{readings.distance[place]:.1f}", *figures, lead.text("+.1f"), words))
    title = f"Nearest to the paper's steps ({text}): root mean square difference; lead of ICAC over CACLA+Var"
    return Table(title, header, rows)


def _rounded(value: Any) -> str:
    """A value in words; of a drawn number three digits."""
    return f"{value:.3g}" if isinstance(value, float) else axes.short(value)


def explained_table(readings: Readings) -> Table:
    """Which open points matter, for the lead and for each algorithm."""
    figures = {"lead": readings.lead} | {titles.RUNS[name]: readings.steps[name] for name in ALGORITHMS}
    shares = {title: {name: share for name, share, _ in explained(readings, one)} for title, one in figures.items()}
    order = explained(readings, readings.lead)
    rows = [
        (name, *(f"{shares[title][name]:.1%}" for title in figures), f"{by_chance:.1%}") for name, _, by_chance in order
    ]
    title = "Share of the variance of steps between readings that each open point explains by itself"
    return Table(title, ("open point", *figures, "by chance"), rows)


def nearest_study(readings: Readings, base: dict[str, Any], seeds: int = 20) -> str:
    """The nearest readings as a study with fresh seeds, TOML.

    Args:
      readings: of the study.
      base: the study's [base].
      seeds: how many.
    """
    chosen = [readings.options[place] for place in nearest(readings)]
    file = {
        "claim": f"The {len(chosen)} readings nearest to the paper, on seeds that did not choose them",
        "base": base | {"seeds": seeds, "root_seed": base.get("root_seed", 0) + 1},
        "grid": {"algo": list(ALGORITHMS)},
        "zip": {name: [one[name] for one in chosen] for name in chosen[0]},
    }
    return tomli_w.dumps(file)


def markdown(readings: Readings) -> str:
    """All tables."""
    made = distribution(readings), nearest_table(readings), explained_table(readings)
    return "\n".join(tables.as_markdown(table) for table in made)


def main(arguments: list[str] | None = None) -> int:
    """Reads a sweep and writes what it says about readings into its folder."""
    parser = argparse.ArgumentParser(
        prog="python -m icac_jax.paper.readings", description="What a study of readings says."
    )
    parser.add_argument("folder", type=Path, help="of the finished sweep")
    folder = parser.parse_args(arguments).folder
    from icac_jax.paper import readings_figures  # which draws `Readings`

    try:
        rows = best.summary_of(folder)["cells"]
        study = sweep_file.read(folder / run_folder.SWEEP)
        found = of(rows, study.cells()[0].settings.run.arm)
        files.write_text(folder / "readings.md", markdown(found))
        files.write_text(folder / "nearest.toml", nearest_study(found, study.base))
        readings_figures.draw(found).savefig(folder / "readings.png", dpi=150)
    except ConfigError as error:
        print(f"readings: {error}", file=sys.stderr)
        return 2
    print(folder / "readings.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
