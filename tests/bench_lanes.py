"""`python -m tests.bench_lanes`: what a lane-step costs by the number of lanes, on whatever device JAX finds.

For a GPU above all, where a step of 20 lanes and one of 20,000 take about the same time. Every program is compiled,
run once, and then measured over chunks of some tenths of a second. Results: a table and JSON on standard output.
"""

import argparse
import json
import time

import jax
import numpy as np

from icac_jax.runs import devices
from icac_jax.runs.loop import Training
from icac_jax.settings.options import resolve
from tests.bench import facts

SECONDS, FEWEST, MOST, CHUNKS = 0.4, 5, 2000, 5
# The paper's learners, and one with a replay buffer per lane, kept small because its memory is what counts here.
LEARNERS = {
    "nico4 icac, servo": {"arm": "nico4", "algo": "icac", "physics": "servo"},
    "nico4 icac, kinematic": {"arm": "nico4", "algo": "icac", "physics": "kinematic"},
    "planar2 icac, kinematic": {"arm": "planar2", "algo": "icac", "physics": "kinematic"},
    "planar2 td3 with hindsight, kinematic": {
        "arm": "planar2",
        "algo": "td3",
        "hindsight": "future",
        "physics": "kinematic",
        "buffer_size": 4096,
    },
}


class Chunk:
    """A compiled chunk of so many steps of so many lanes."""

    def __init__(self, lanes, length, options):
        training = Training.of_run(resolve(**options, seeds=lanes, episodes=10**9))
        self.length, self.state = length, training.start()
        self.args = training.on_lanes(training.first().slots)
        started = time.perf_counter()
        self.compiled = training.program._replace(length=length).compiled(self.state, self.args)
        self.seconds = time.perf_counter() - started
        self()

    def __call__(self):
        """Seconds of one chunk."""
        started = time.perf_counter()
        self.state, _ = jax.block_until_ready(self.compiled(self.state, *self.args))
        return time.perf_counter() - started


def measure(lanes, options):
    """One row: lanes, microseconds per step and per lane-step, lane-steps per second, seconds of compiling, bytes."""
    trial = Chunk(lanes, FEWEST, options)
    length = int(np.clip(SECONDS / (trial() / FEWEST), FEWEST, MOST))
    chunk = Chunk(lanes, length, options)
    seconds = float(np.median([chunk() for _ in range(CHUNKS)])) / length
    memory = jax.local_devices()[0].memory_stats() or {}
    return {
        "lanes": lanes,
        "microseconds_per_step": seconds * 1e6,
        "microseconds_per_lane_step": seconds / lanes * 1e6,
        "lane_steps_per_second": lanes / seconds,
        "compile_seconds": chunk.seconds,
        "peak_bytes": memory.get("peak_bytes_in_use"),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--lanes", type=int, nargs="+", default=[20, 640, 20_000, 100_000])
    parser.add_argument("--only", nargs="+", choices=LEARNERS, default=list(LEARNERS), metavar="LEARNER")
    parser.add_argument("--json", help="file for the results as JSON")
    chosen = parser.parse_args()
    devices.use_every_core()
    devices.keep_loops()
    devices.use_full_precision()
    kind = jax.local_devices()[0].device_kind
    results = {"device": kind, "facts": facts(), "learners": {}}
    head = "learner", "lanes", "µs per step", "µs per lane-step", "lane-steps per second", "compiling, s", "GiB"
    print(f"{kind}\n\n| {' | '.join(head)} |")
    print("|---|---|---|---|---|---|---|", flush=True)
    for name in chosen.only:
        for lanes in chosen.lanes:
            try:
                row = measure(lanes, LEARNERS[name])
            except jax.errors.JaxRuntimeError as error:  # too little memory
                print(f"| {name} | {lanes:,} | {str(error).splitlines()[0][:80]} | | | | |", flush=True)
                continue
            results["learners"].setdefault(name, []).append(row)
            size = "" if row["peak_bytes"] is None else f"{row['peak_bytes'] / 2**30:.1f}"
            print(
                f"| {name} | {lanes:,} | {row['microseconds_per_step']:,.0f} | {row['microseconds_per_lane_step']:.3g} "
                f"| {row['lane_steps_per_second']:,.0f} | {row['compile_seconds']:.1f} | {size} |",
                flush=True,
            )
            if chosen.json:
                with open(chosen.json, "w") as file:
                    json.dump(results, file, indent=1)


if __name__ == "__main__":
    main()
