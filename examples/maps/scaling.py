"""Maps beside each other: nodes against volume and dimension, errors, Delaunay edges, time per stimulus; a verdict.

Sec. III.A: "Unlike other common topology-representing networks such as the SOM and the Growing Neural Gas, ITM is
considered more computationally efficient, with the number of nodes scaling linearly with the volume of the state space,
of which it provides a Delaunay triangulation". Writes `maps.md`, `maps.csv`, `maps-times.csv` and `maps.png`.

Usage: python examples/maps/scaling.py --out FOLDER
"""

import argparse
import csv
import functools
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import Delaunay

from icac_jax import CuriosityHyper, CuriositySpec
from icac_jax.curiosity import maps
from icac_jax.curiosity.base import Map
from icac_jax.reports.figures import STYLE, looks_by_order

# Resolution of the ITM by dimension: in the largest box, [-1, 1]^D, it gives some tens to hundreds of nodes.
E_MAX = {2: 0.15, 3: 0.35, 4: 0.6, 5: 0.8, 6: 0.9, 7: 1.0}
ROOM = 1024  # slots of the ITM
PAPER_E_MAX = 0.9  # at which nodes are counted in every dimension
VOLUMES = (1.0, 0.5, 0.25, 0.125)  # of the box, as a share of the largest
KINDS = ("uniform", "walk")
STEP = 0.2  # of the walk, about what an action of the paper's does to a normalised joint
TIMED_NODES, TIMED_DIMENSIONS, LANES = 256, (2, 4, 7), 20
MOST_DELAUNAY = 4  # dimensions; beyond, a triangulation of hundreds of nodes takes minutes

# The rule. Linear: the exponent b of nodes ~ volume^b lies in this range, and the map is full-grown: the second half of
# the stimuli added at most this share of the nodes. Cheap: a step takes at most this share of the other map's time.
LINEAR = (0.8, 1.2)
GROWN = 0.1
CHEAPER = 0.9


class Setting(NamedTuple):
    """One map in one dimension.

    Attributes:
      map: its name.
      size: D.
      choices: static ones of the map.
      numbers: traced ones.
    """

    map: str
    size: int
    choices: dict[str, int]
    numbers: dict[str, float]

    @property
    def built(self) -> Map:
        """The map."""
        sizes = {"observation_size": self.size, "state_size": self.size}
        return maps.build(CuriositySpec(map=self.map, **sizes, **self.choices))  # pyright: ignore[reportArgumentType]


def others(size: int, nodes: int, stimuli: int) -> list[Setting]:
    """The other maps at a resolution comparable with an ITM of so many nodes.

    Growing neural gas with as many nodes, there after half of the stimuli; the square SOM next to as many; a grid whose
    cells are as wide as the ITM's resolution.
    """
    interval = max(1, stimuli // 2 // nodes)
    return [
        Setting("gng", size, {"map_capacity": max(2, nodes)}, {"gng_interval": interval}),
        Setting("som", size, {"som_side": max(2, round(nodes**0.5))}, {"som_decay_steps": stimuli // 2}),
        Setting("grid", size, {"grid_side": max(2, round(2 / E_MAX[size]))}, {}),
    ]


def stimuli_of(kind: str, size: int, volume: float, number: int, seed: int) -> np.ndarray:
    """Stimuli [number, D] in a box in the corner of [-1, 1]^D that has a share of its volume; a walk is reflected."""
    rng = np.random.default_rng((seed, size, KINDS.index(kind)))
    side = 2 * volume ** (1 / size)
    if kind == "uniform":
        places = rng.uniform(0, side, (number, size))
    else:
        places = np.cumsum(rng.normal(0, STEP, (number, size)), axis=0) % (2 * side)
        places = np.minimum(places, 2 * side - places)
    return (places - 1).astype(np.float32)


@functools.cache
def _program(built: Map) -> Any:
    """From keys [L], stimuli [n, L, D] and numbers to maps after half of the stimuli and after all."""

    def feed(states: Any, points: jax.Array, numbers: Any) -> Any:
        step = jax.vmap(lambda state, point: built.update(state, point, numbers, True)[0])
        return jax.lax.scan(lambda states, now: (step(states, now), None), states, points)[0]

    start = jax.jit(jax.vmap(built.init, (0, None)))
    return start, jax.jit(feed)


def grown(setting: Setting, points: np.ndarray) -> tuple[Any, Any]:
    """Maps of the lanes after half of the stimuli and after all; stimuli [n, L, D]."""
    start, feed = _program(setting.built)
    values: dict[str, Any] = {"e_max": E_MAX[setting.size]} | setting.numbers
    numbers = CuriosityHyper(**values).traced()
    half = len(points) // 2
    middle = feed(start(jax.random.split(jax.random.key(0), points.shape[1]), numbers), points[:half], numbers)
    return middle, feed(middle, points[half : 2 * half], numbers)


def figures(setting: Setting, state: Any, fresh: np.ndarray) -> dict[str, float]:
    """What one map is worth: nodes, distance of fresh stimuli [m, D] to their node over e_max, Delaunay edges."""
    nodes = setting.built.nodes(jax.tree.map(jnp.asarray, state))
    live = np.flatnonzero(nodes.live)
    places = np.asarray(nodes.weights, float)[live]
    nearest = np.min(np.linalg.norm(fresh[:, None] - places, axis=2), axis=1)
    found = {"nodes": len(live), "error": float(nearest.mean()) / E_MAX[setting.size]}
    if setting.size <= MOST_DELAUNAY and len(live) > setting.size + 2 and nodes.edges is not None:
        mine = {(a, b) for a, b in np.argwhere(np.triu(np.asarray(nodes.edges)[np.ix_(live, live)])).tolist()}
        ends, starts = Delaunay(places, qhull_options="QJ").vertex_neighbor_vertices
        there = {(a, int(b)) for a in range(len(live)) for b in starts[ends[a] : ends[a + 1]] if a < b}
        found |= {"found": len(mine & there) / len(there), "right": len(mine & there) / max(1, len(mine))}
    return found


def measured(size: int, stimuli: int, seeds: int) -> list[dict[str, Any]]:
    """Rows of all maps in one dimension: one per map, kind of stimuli, volume and seed."""
    lanes = [(volume, seed) for volume in VOLUMES for seed in range(seeds)]
    rows: list[dict[str, Any]] = []
    settings = [Setting("itm", size, {"map_capacity": ROOM}, {})]
    while settings:
        setting = settings.pop(0)
        for kind in KINDS:
            points = np.stack([stimuli_of(kind, size, volume, stimuli, seed) for volume, seed in lanes], axis=1)
            middle, last = (jax.device_get(states) for states in grown(setting, points))
            for lane, (volume, seed) in enumerate(lanes):
                before, state = (jax.tree.map(lambda leaf: leaf[lane], states) for states in (middle, last))  # noqa: B023
                fresh = stimuli_of("uniform", size, volume, 500, seed + 1000)
                row = {"map": setting.map, "dimensions": size, "stimuli": kind, "volume": volume, "seed": seed}
                row |= {"nodes_half": float(np.sum(setting.built.nodes(before).live))}
                row |= {"overflow": int(getattr(state, "overflow", 0))}
                rows.append(row | figures(setting, state, fresh))
        if setting.map == "itm":
            full = [row["nodes"] for row in rows if row["volume"] == 1.0 and row["stimuli"] == "uniform"]
            settings = others(size, round(float(np.mean(full))), stimuli)
    return rows


def by_dimension(size: int, stimuli: int, seeds: int) -> dict[str, Any]:
    """Nodes of the ITM at the paper's resolution in [-1, 1]^D, uniform stimuli; as many lanes as `measured` has."""
    setting = Setting("itm", size, {"map_capacity": ROOM}, {"e_max": PAPER_E_MAX})
    lanes = range(len(VOLUMES) * seeds)
    middle, last = grown(setting, np.stack([stimuli_of("uniform", size, 1.0, stimuli, n) for n in lanes], axis=1))
    half, nodes = (np.mean(np.sum(np.asarray(state.live), axis=1)) for state in (middle, last))
    full = int(np.sum(np.asarray(last.overflow) > 0))
    return {"dimensions": size, "nodes": float(nodes), "nodes_half": float(half), "full": full}


def timed(steps: int, repeats: int = 3) -> list[dict[str, Any]]:
    """Microseconds per stimulus and lane of each map with room for the same number of nodes; the grid's does not count.

    The quickest of some repeats, compilation left out.
    """
    rows = []
    for size in TIMED_DIMENSIONS:
        side = round(TIMED_NODES**0.5)
        for setting in (
            Setting("itm", size, {"map_capacity": TIMED_NODES}, {}),
            Setting("gng", size, {"map_capacity": TIMED_NODES}, {}),
            Setting("som", size, {"som_side": side}, {}),
            Setting("grid", size, {"grid_side": max(2, round(2 / E_MAX[size]))}, {}),
        ):
            one = [stimuli_of("uniform", size, 1.0, 2 * steps, seed) for seed in range(LANES)]
            points = np.stack(one, axis=1)
            jax.block_until_ready(grown(setting, points))
            seconds = []
            for _ in range(repeats):
                begun = time.perf_counter()
                jax.block_until_ready(grown(setting, points))
                seconds.append(time.perf_counter() - begun)
            per_step = 1e6 * min(seconds) / (2 * steps * LANES)
            rows.append({"map": setting.map, "dimensions": size, "microseconds": per_step})
    return rows


def mean(rows: list[dict[str, Any]], name: str, **of: Any) -> float:
    """Mean of a figure over the rows that have these values; NaN where none has it."""
    values = [row[name] for row in rows if name in row and all(row[key] == value for key, value in of.items())]
    return float(np.mean(values)) if values else float("nan")


def exponent(rows: list[dict[str, Any]], **of: Any) -> float:
    """The exponent b of nodes ~ volume^b, by least squares of the logarithms of means over seeds."""
    nodes = [mean(rows, "nodes", volume=volume, **of) for volume in VOLUMES]
    return round(float(np.polyfit(np.log(VOLUMES), np.log(nodes), 1)[0]), 6) + 0.0  # no -0.00 in a table


def linear(rows: list[dict[str, Any]], **of: Any) -> str:
    """Whether a map's nodes scale linearly with volume in one dimension: yes, no, still growing, or full."""
    if any(row["overflow"] for row in rows if row["map"] == "itm" and all(row[key] == of[key] for key in of)):
        return "full"
    before, after = mean(rows, "nodes_half", volume=1.0, **of), mean(rows, "nodes", volume=1.0, **of)
    if after > (1 + GROWN) * before:
        return "still growing"
    return "yes" if LINEAR[0] <= exponent(rows, **of) <= LINEAR[1] else "no"


def verdicts(rows: list[dict[str, Any]], times: list[dict[str, Any]]) -> list[str]:
    """The sentences of the claim, each with what was measured."""
    said = []
    for kind in KINDS:
        by_size = {size: linear(rows, map="itm", dimensions=size, stimuli=kind) for size in _sizes(rows)}
        judged = [word for word in by_size.values() if word in ("yes", "no")]
        word = "not decided" if not judged else "holds" if set(judged) == {"yes"} else "does not hold"
        word = "holds in some dimensions" if set(judged) == {"yes", "no"} else word
        words = ", ".join(f"{size}-D {found}" for size, found in by_size.items())
        said.append(f"Linear in the volume, {kind} stimuli: **{word}** ({words}).")
    for other in ("gng", "som"):
        shares = [
            mean(times, "microseconds", map="itm", dimensions=size)
            / mean(times, "microseconds", map=other, dimensions=size)
            for size in TIMED_DIMENSIONS
        ]
        cheap = [share <= CHEAPER for share in shares]
        word = "holds" if all(cheap) else "does not hold" if not any(cheap) else "holds in some dimensions"
        words = ", ".join(f"{size}-D {share:.2f}" for size, share in zip(TIMED_DIMENSIONS, shares, strict=True))
        said.append(f"Cheaper than {maps.MAPS[other].title}: **{word}** (time of a step over that map's: {words}).")
    return said


def _sizes(rows: list[dict[str, Any]]) -> list[int]:
    return sorted({row["dimensions"] for row in rows})


def markdown(rows: list[dict[str, Any]], times: list[dict[str, Any]], sizes: list[dict[str, Any]]) -> str:
    """Verdicts and tables."""

    def text(value: float, form: str) -> str:
        return "–" if np.isnan(value) else format(value, form)

    lines = ["\n".join(f"- {line}" for line in verdicts(rows, times)), ""]
    lines += [
        "| map | D | stimuli | nodes | b of nodes ~ volume^b | added by the second half | error / e_max "
        "| Delaunay edges found | its edges that are Delaunay |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for size in _sizes(rows):
        for name in maps.MAPS:
            for kind in KINDS:
                of: dict[str, Any] = {"map": name, "dimensions": size, "stimuli": kind}
                half, nodes = (mean(rows, figure, volume=1.0, **of) for figure in ("nodes_half", "nodes"))
                cells = [name, size, kind, f"{nodes:.0f}", f"{exponent(rows, **of):.2f}", f"{nodes / half - 1:.0%}"]
                cells += [text(mean(rows, "error", volume=1.0, **of), ".2f")]
                cells += [text(mean(rows, figure, volume=1.0, **of), ".0%") for figure in ("found", "right")]
                lines.append("| " + " | ".join(map(str, cells)) + " |")
    lines += ["", f"Nodes of the ITM in [-1, 1]^D at e_max {PAPER_E_MAX:g}, uniform stimuli, room for {ROOM:,}:", ""]
    lines += ["| D | nodes | added by the second half | maps that were full |", "|---|---|---|---|"]
    for row in sizes:
        more = row["nodes"] / row["nodes_half"] - 1
        lines.append(f"| {row['dimensions']} | {row['nodes']:.0f} | {more:.0%} | {row['full']} |")
    lines += ["", f"Microseconds per stimulus and lane, room for {TIMED_NODES} nodes, {LANES} lanes:", ""]
    lines += ["| map | " + " | ".join(f"{size}-D" for size in TIMED_DIMENSIONS) + " |"]
    lines += ["|---|" + "---|" * len(TIMED_DIMENSIONS)]
    for name in maps.MAPS:
        cells = [f"{mean(times, 'microseconds', map=name, dimensions=size):.2f}" for size in TIMED_DIMENSIONS]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def figure(rows: list[dict[str, Any]]) -> Figure:
    """Nodes against volume, a panel per dimension, uniform stimuli; the dotted line is linear."""
    import matplotlib

    sizes = _sizes(rows)
    columns = min(3, len(sizes))
    with matplotlib.rc_context(STYLE):
        page = Figure(figsize=(3.2 * columns, 2.7 * -(-len(sizes) // columns) + 0.5), layout="constrained")
        panels = np.ravel(page.subplots(-(-len(sizes) // columns), columns, squeeze=False))
        looks = looks_by_order(len(maps.MAPS))
        for panel, size in zip(panels, sizes, strict=False):
            for (name, kind), look in zip(maps.MAPS.items(), looks, strict=True):
                nodes = [mean(rows, "nodes", map=name, dimensions=size, stimuli="uniform", volume=v) for v in VOLUMES]
                style = {"color": look.colour, "linestyle": look.line, "marker": look.marker, "label": kind.title}
                panel.loglog(VOLUMES, nodes, **style)
                if name == "itm":
                    panel.loglog(VOLUMES, nodes[0] * np.array(VOLUMES), color="#888888", linestyle=":", label="linear")
            panel.set_title(f"{size} dimensions, e_max {E_MAX[size]:g}")
            panel.set_xlabel("volume, share of the largest box")
            panel.set_xticks(VOLUMES, [f"{volume:g}" for volume in VOLUMES])
            low, high = panel.get_ylim()
            ticks = [digit * 10**power for power in range(4) for digit in (1, 2, 5)]
            ticks = [number for number in ticks if low <= number <= high]
            panel.set_yticks(ticks, [f"{number:,}" for number in ticks])
            panel.minorticks_off()
        for panel in panels[::columns]:
            panel.set_ylabel("nodes")
        for panel in panels[len(sizes) :]:
            panel.set_visible(False)
        page.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return page


def main(arguments: list[str] | None = None) -> None:
    """Measures, writes, prints the verdicts."""
    parser = argparse.ArgumentParser(description="Maps: nodes, errors, edges and time against volume and dimension.")
    parser.add_argument("--out", type=Path, default=Path())
    parser.add_argument("--dimensions", type=int, nargs="+", choices=E_MAX, default=list(E_MAX))
    parser.add_argument("--stimuli", type=int, default=20_000, help="per map")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--timed-stimuli", type=int, default=1000, help="per lane and repeat")
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    times = timed(given.timed_stimuli // 2)
    rows: list[dict[str, Any]] = []
    sizes = []
    for size in given.dimensions:
        rows += measured(size, given.stimuli, given.seeds)
        sizes.append(by_dimension(size, given.stimuli, given.seeds))
        print(f"{size}-D done", flush=True)
    names = list(dict.fromkeys(name for row in rows for name in row))
    for path, header, table in (("maps.csv", names, rows), ("maps-times.csv", list(times[0]), times)):
        with (given.out / path).open("w", newline="") as file:
            writer = csv.DictWriter(file, header)
            writer.writeheader()
            writer.writerows(table)
    (given.out / "maps.md").write_text(markdown(rows, times, sizes))
    figure(rows).savefig(given.out / "maps.png", dpi=150)
    print("\n".join(verdicts(rows, times)))


if __name__ == "__main__":
    main()
