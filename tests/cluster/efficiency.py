"""`make bench-cluster`: what a second node brings and what a task costs, each node one core, in turn.

`python -m tests.cluster.efficiency [KIND ...] [--rounds N]`, kinds as in `tests.cluster`. Fixed is the time of a study
that trains next to nothing, one task per node: to start, to read compiled programs, to put together, to report.
Efficiency is the time on one node over twice the time on two, of a study's work (without what is fixed) and of the
whole command. What a task costs is the time of many tasks that train next to nothing, less that of one per node, over
the others.
"""

import argparse
import os
import shutil
import statistics
import sys
import time

from tests.cluster import hosts, on_ray, slurm
from tests.cluster.nodes import finished, lacking, new_place, nodes

# Some 30 seconds on one core.
_WORK = """[base]
physics = "kinematic"
algo = "icac"
seeds = 64
episodes = 1000
[grid]
gamma = [0.8, 0.9]
"""
# A task per node, and so many.
_FEW, _MANY = 2, 10
_NOTHING = """[base]
physics = "kinematic"
algo = "icac"
seeds = {seeds}
episodes = 1
[random]
draws = {cells}
gamma = {{low = 0.8, high = 0.95}}
"""


class _Hosts:
    """Processes that find each other; they have no tasks."""

    def __init__(self, cluster, place):
        self.nodes, self.place = cluster, place

    def run(self, file, count, _):
        arguments = ["sweep", file, "--out", file.with_suffix("")]
        together = hosts.together(self.nodes, count, arguments, file.stem) if count > 1 else []
        alone = [self.nodes[0].icac(*arguments, log=f"{file.stem}.log")] if count == 1 else []
        assert not any(finished(*together, *alone)), f"{file}: failed"


class _Slurm:
    """A job array and the job that puts it together."""

    def __init__(self, cluster, place):
        self.slurm = slurm.Slurm(cluster, place)

    def run(self, file, _, tasks):
        with self.slurm.array(["sweep", file, "--out", file.with_suffix("")], tasks, f"{file.stem}.log"):
            pass


class _Ray:
    """Tasks on a cluster that is there already; the head, on which the driver runs, trains nothing."""

    def __init__(self, cluster, place):
        self.cluster, self.place = cluster, place
        self.ray = None

    def run(self, file, count, _):
        """The clock starts with the driver: how long Ray takes to start its nodes is not looked at."""
        if self.ray is None or len(self.ray.nodes) != count:
            for node in self.cluster:
                node.die()
            self.ray = on_ray.Ray(self.cluster[: count + 1], self.place)
        started = time.monotonic()
        driver = self.ray.sweep(["sweep", file, "--out", file.with_suffix("")], f"{file.stem}.log")
        assert finished(driver) == [0], f"{file}: failed"
        return time.monotonic() - started


_KINDS = {"hosts": (hosts, _Hosts), "slurm": (slurm, _Slurm), "ray": (on_ray, _Ray)}


def main(kinds, rounds):
    """Measures kinds of clusters, each so many times, and prints a table of medians."""
    if line := lacking([_KINDS[kind][0] for kind in kinds]):
        print(line)
        return False
    place = new_place()
    cores = sorted(os.sched_getaffinity(0))
    head = ("one node, s", "fixed", "two nodes, s", "fixed", "efficiency", "whole", "per task, s")
    print(f"{'kind':14}" + "".join(f"{name:>14}" for name in head), flush=True)
    for kind in kinds:
        module, engine = _KINDS[kind]
        mine = place / kind
        mine.mkdir()
        with nodes(module.NODES, mine) as cluster:
            # The last ones train; what controls them, if anything does, has no core of its own.
            for node, core in zip(cluster if kind == "hosts" else cluster[1:], cores, strict=False):
                node.core = core
            (one, start_one), (two, start_two), task = _measured(engine(cluster, mine), mine, kind, rounds)
        work, whole = (one - start_one) / (2 * (two - start_two)), one / (2 * two)
        seconds = "".join(f"{value:14.1f}" for value in (one, start_one, two, start_two))
        shown = "-" if task is None else f"{task:.1f}"
        print(f"{module.NAME:14}{seconds}{work:14.0%}{whole:14.0%}{shown:>14}", flush=True)
    shutil.rmtree(place)
    return True


def _measured(engine, place, kind, rounds):
    """Median seconds of the work and of next to nothing, on one node and on two; and of a task, None without tasks."""

    def seconds(name, text, count, tasks):
        file = place / f"{name}.toml"
        file.write_text(text)
        started = time.monotonic()
        said = engine.run(file, count, tasks)
        return time.monotonic() - started if said is None else said

    def empty(tasks):
        """Nearly no work in so many tasks: those of an array share every cell's learners, on Ray each has a cell's."""
        return _NOTHING.format(seeds=_MANY, cells=1) if kind == "slurm" else _NOTHING.format(seeds=80, cells=tasks)

    def medians(name, text, *setups):
        """By number of nodes and of tasks, taken in turn; the first turn, which compiles, does not count."""
        turns = range(rounds + 1)
        times = {
            (setup, turn): seconds(f"{name}-{'-'.join(map(str, setup))}-{turn}", text(setup[1]), *setup)
            for turn in turns
            for setup in setups
        }
        return [statistics.median(times[setup, turn] for turn in turns[1:]) for setup in setups]

    works = medians("work", lambda _: _WORK, (1, 1), (2, 2))
    if kind == "hosts":
        return *zip(works, medians("empty", empty, (1, 1), (2, 2)), strict=True), None
    one, few, many = medians("empty", empty, (1, 1), (2, _FEW), (2, _MANY))
    return (works[0], one), (works[1], few), (many - few) * 2 / (_MANY - _FEW)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=f"{', '.join(_KINDS)}; all by default")
    parser.add_argument("--rounds", type=int, default=3, help="how often each is measured, in turn")
    given = parser.parse_args()
    if unknown := set(given.kinds) - set(_KINDS):
        parser.error(f"KIND: must be one of {', '.join(_KINDS)}, got {', '.join(sorted(unknown))}")
    sys.exit(not main(given.kinds or list(_KINDS), given.rounds))
