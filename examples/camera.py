"""Seeing instead of feeling: ICAC and TD3 + HER on planar2 from joints, from a picture's embedding, from a control.

The control is a random projection of the same picture to as many numbers. If learners do as well from it, it is not the
encoder's training that helps. The rules, written before the study was run; success is that of the last tenth of the
episodes, a mean over seeds with a 95 % bootstrap interval, differences are paired by seed:

- a learner learns from a sight where its success is at least 95 % and its interval lies above 90 %;
- one sight costs a learner success against another where the difference is beyond 5 points and its interval on one side
  of 0; it makes no difference where the interval lies within 5 points; else nothing is decided;
- the map needs fewer nodes in the embedding than in the pixels where it has at most half as many at the same relative
  resolution: `e_max` is 0.9, the paper's, times the mean distance of two random configurations in that space over their
  mean distance in normalised joints. ICAC has that `e_max` too.

Writes `camera.md`, `camera.csv`, `camera.png`; goes on where it stopped.

Usage: python examples/camera.py --out FOLDER [--encoder-steps N] [--seeds N] [--episodes N]
"""

import argparse
import csv
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from icac_jax.curiosity import CuriosityHyper, itm
from icac_jax.envs import arms, drawing
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.embedding import Embedding
from icac_jax.reports import statistics
from icac_jax.reports.figures import STYLE, looks_by_order
from icac_jax.reports.statistics import Estimate
from icac_jax.reports.verdicts import SUCCESS_TOLERANCE
from icac_jax.runs import devices, encoder_measures, encoders, train
from icac_jax.runs import folder as run_folder
from icac_jax.settings.options import resolve

LEARNERS = {"icac": ("ICAC", {"algo": "icac"}), "td3": ("TD3 + HER", {"preset": "best"})}
SIGHTS = {"joints": "", "embedding": "autoencoder", "projection": "projection"}
SPACES = {**SIGHTS, "pixels": "pixels"}
PAPER_E_MAX, ROOM = 0.9, 1024
ENOUGH, SURE, FEWER = 0.95, 0.90, 0.5
LATE = 0.1


def learns(success: Estimate) -> str:
    """What the rule says of a learner's success."""
    return "learns" if success.value >= ENOUGH and success.low > SURE else "does not"


def decided(difference: Estimate) -> str:
    """What the rule says of the success from one sight less that from another."""
    if difference.high < 0 and difference.value < -SUCCESS_TOLERANCE:
        return "costs success"
    if difference.low > 0 and difference.value > SUCCESS_TOLERANCE:
        return "gains success"
    inside = difference.low > -SUCCESS_TOLERANCE and difference.high < SUCCESS_TOLERANCE
    return "makes no difference" if inside else "undecided"


def encoder(out: Path, method: str, options: dict[str, Any], arm: ArmSpec) -> Embedding:
    """An encoder in a file, which is made, or read if it is there."""
    if not out.is_file():
        encoders.encode(arm.name, out, progress=True, method=method, **options)
    return encoders.read(out, arm)


def stimuli(arm: ArmSpec, made: dict[str, Embedding], number: int, seed: int) -> dict[str, np.ndarray]:
    """The same random configurations of the arm in each space, [number, D]."""
    size = made["pixels"].options.picture_size
    seen = encoder_measures.drawn(arm, drawing.camera(arm, size), number, (seed, 17))
    low, high = np.radians(arm.joint_low), np.radians(arm.joint_high)
    found = {"joints": (2 * (seen.truth["arm"] - low) / (high - low) - 1).astype(np.float32)}
    return found | {
        name: encoder_measures.embedded(embedding, "arm", seen.pictures["arm"]) for name, embedding in made.items()
    }


def spread(points: np.ndarray) -> float:
    """Mean distance of two of the points [n, D]."""
    half = len(points) // 2
    return float(np.mean(np.linalg.norm(points[:half] - points[half : 2 * half], axis=1)))


@functools.partial(jax.jit, static_argnames="capacity")
def _mapped(points: jax.Array, e_max: jax.Array, key: jax.Array, capacity: int) -> jax.Array:
    built = itm.topological_map(capacity, points.shape[1])
    hyper = CuriosityHyper().traced().replace(e_max=e_max)
    state = built.init(key, hyper)
    last, _ = jax.lax.scan(lambda state, point: (built.update(state, point, hyper, True)[0], None), state, points)
    return jnp.sum(last.live)


def nodes(points: np.ndarray, e_max: float, seed: int) -> int:
    """Nodes of the topological map after the stimuli [n, D], one after the other."""
    return int(_mapped(jnp.asarray(points), jnp.float32(e_max), jax.random.key(seed), ROOM))


def trained(out: Path, options: dict[str, Any]) -> tuple[np.ndarray, float]:
    """Whether each episode [S, episodes] of a run was a success, and its seconds per lane-step.

    The run is trained, resumed, or read if it is there.
    """
    if not run_folder.is_run(out):
        train.train(resolve(**options), out)
    elif not (out / run_folder.SUMMARY).is_file():
        train.resume(out)
    rows = pq.read_table(out / "episodes.parquet", columns=["seed", "episode", "reached", "steps"])
    reached = np.zeros((options["seeds"], options["episodes"]))
    reached[rows["seed"].to_numpy(), rows["episode"].to_numpy()] = rows["reached"].to_numpy()
    seconds = run_folder.read_json(out / run_folder.SUMMARY)["seconds"]
    return reached, seconds / rows["steps"].to_numpy().sum()


def late(reached: np.ndarray) -> np.ndarray:
    """Success of each seed [S] in the last tenth of its episodes."""
    return reached[:, -max(1, round(LATE * reached.shape[1])) :].mean(axis=1)


def markdown(
    reached: dict[tuple[str, str], np.ndarray],
    seconds: dict[tuple[str, str], float],
    found: dict[str, list[int]],
    e_max: dict[str, float],
) -> str:
    """Three tables: success and cost by learner and sight, what the rule says of pairs, nodes by space."""
    lines = ["| learner | sees | success, last tenth | verdict | µs per lane-step |", "|---|---|---|---|---|"]
    pairs = ["| learner | sees | against | difference, points | verdict |", "|---|---|---|---|---|"]
    for learner, sight in reached:
        success = statistics.estimate(late(reached[learner, sight]), "mean")
        cost = 1e6 * seconds[learner, sight]
        title = LEARNERS[learner][0]
        lines.append(f"| {title} | {sight} | {success.text('.1%')} | **{learns(success)}** | {cost:.0f} |")
    for learner in dict.fromkeys(learner for learner, _ in reached):
        for sight, against in (("embedding", "joints"), ("embedding", "projection"), ("projection", "joints")):
            apart = statistics.paired_difference(late(reached[learner, sight]), late(reached[learner, against]))
            cells = [LEARNERS[learner][0], sight, against, apart.text("+.1%"), f"**{decided(apart)}**"]
            pairs.append("| " + " | ".join(cells) + " |")
    spaces = ["| space | e_max | nodes |", "|---|---|---|"]
    spaces += [f"| {name} | {e_max[name]:.2f} | {np.mean(counts):.1f} |" for name, counts in found.items()]
    fewer = np.mean(found["embedding"]) <= FEWER * np.mean(found["pixels"])
    said = f"Fewer nodes in the embedding than in the pixels: **{'holds' if fewer else 'does not hold'}**"
    return "\n".join([*lines, "", *pairs, "", *spaces, "", said]) + "\n"


def figure(reached: dict[tuple[str, str], np.ndarray]) -> Figure:
    """Success over twenty stretches of the episodes with 95 % intervals over seeds, a panel per learner."""
    learners = list(dict.fromkeys(learner for learner, _ in reached))
    with matplotlib.rc_context(STYLE):
        page = Figure(figsize=(8.4, 3.6), layout="constrained")
        panels = np.ravel(page.subplots(1, len(learners), sharey=True, squeeze=False))
        for panel, learner in zip(panels, learners, strict=True):
            for sight, look in zip(SIGHTS, looks_by_order(len(SIGHTS)), strict=True):
                values = reached[learner, sight]
                parts = np.array_split(values, min(20, values.shape[1]), axis=1)
                band = statistics.band(np.stack([part.mean(axis=1) for part in parts], axis=1))
                ends = np.cumsum([part.shape[1] for part in parts])
                style = {"color": look.colour, "linestyle": look.line, "marker": look.marker, "markevery": 4}
                panel.plot(ends, band.value, label=sight, **style)
                panel.fill_between(ends, band.low, band.high, color=look.colour, alpha=0.15, linewidth=0)
            panel.set_title(LEARNERS[learner][0])
            panel.set_xlabel("episodes")
            panel.set_ylim(-0.02, 1.02)
        panels[0].set_ylabel("success")
        page.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return page


def main(arguments: list[str] | None = None) -> None:
    """Trains what is missing, writes, prints the tables."""
    parser = argparse.ArgumentParser(description="Learners that see pictures of the planar arm.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--root-seed", type=int, default=0)
    parser.add_argument("--encoder-steps", type=int, default=10000)
    parser.add_argument("--latent-size", type=int, default=8)
    parser.add_argument("--picture-size", type=int, default=32)
    parser.add_argument("--stimuli", type=int, default=4000)
    parser.add_argument("--physics", choices=("servo", "kinematic"), default="servo")
    given = parser.parse_args(arguments)
    devices.use_every_core()
    devices.use_kept()
    given.out.mkdir(parents=True, exist_ok=True)
    arm = arms.get("planar2")
    options = {"steps": given.encoder_steps, "latent_size": given.latent_size, "picture_size": given.picture_size}
    files = {name: given.out / f"{name}.npz" for name, method in SPACES.items() if method}
    made = {name: encoder(path, SPACES[name], options, arm) for name, path in files.items()}
    points = [stimuli(arm, made, given.stimuli, seed) for seed in range(5)]
    scales = {name: float(np.mean([spread(one[name]) for one in points])) for name in SPACES}
    e_max = {name: PAPER_E_MAX * scales[name] / scales["joints"] for name in SPACES}
    found = {name: [nodes(one[name], e_max[name], seed) for seed, one in enumerate(points)] for name in SPACES}
    reached: dict[tuple[str, str], np.ndarray] = {}
    seconds: dict[tuple[str, str], float] = {}
    for learner, sight in ((learner, sight) for learner in LEARNERS for sight in SIGHTS):
        chosen: dict[str, Any] = {"arm": "planar2", "physics": given.physics, "root_seed": given.root_seed}
        chosen |= {"seeds": given.seeds, "episodes": given.episodes} | LEARNERS[learner][1]
        chosen |= {"encoder": str(files[sight])} if sight in files else {}
        chosen |= {"e_max": round(e_max[sight], 3)} if learner == "icac" else {}
        reached[learner, sight], seconds[learner, sight] = trained(given.out / f"{learner}-{sight}", chosen)
    with (given.out / "camera.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["learner", "sees", "seed", "success_last_tenth"])
        for (learner, sight), values in reached.items():
            writer.writerows([learner, sight, seed, value] for seed, value in enumerate(late(values)))
    (given.out / "camera.md").write_text(markdown(reached, seconds, found, e_max))
    figure(reached).savefig(given.out / "camera.png", dpi=150)
    print(markdown(reached, seconds, found, e_max))


if __name__ == "__main__":
    main()
