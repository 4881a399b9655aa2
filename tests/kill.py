"""Kills trainings at random moments, resumes them, and compares with one that was left alone.

`python -m tests.kill 60` prints a table; the test suite runs a few.
"""

import os
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from icac_jax.runs import checkpoints

# Saving after each chunk makes about half of the moments fall into a save.
TRAIN = ["--physics", "kinematic", "--seeds", "3", "--map-capacity", "32", "--checkpoint-every", "0"]


def start(*args):
    command = [sys.executable, "-m", "icac_jax", *map(str, args)]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def finish(process):
    _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said


def outcome(folder):
    """Records, and the arrays of the final checkpoint."""
    path = checkpoints.listed(folder / "checkpoints")[-1]
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "meta"}
    return pq.read_table(folder / "episodes.parquet"), arrays


def same(first, second):
    """Whether two outcomes are equal bit for bit."""
    table, arrays = first
    other_table, others = second
    return (
        table.equals(other_table)
        and set(arrays) == set(others)
        and all(arrays[name].tobytes() == others[name].tobytes() for name in arrays)
    )


def kill_and_resume(folder, train, whole, rng):
    """One run, killed one to four times in a row; returns the moments and what was there after each kill."""
    moments = []
    for number in range(rng.choice([1, 1, 2, 3, 4])):
        process = start("resume", folder) if number and (folder / "config.toml").exists() else None
        if process is None:
            process = start(*train, "--out", folder)
        # Mostly while it trains and saves; sometimes while it starts.
        delay = rng.uniform(0.45, 1.0) * whole if rng.random() < 0.85 else rng.uniform(0.0, 0.45) * whole
        deadline = time.monotonic() + delay
        while time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.002)
        process.kill()
        _, said = process.communicate()
        assert process.returncode in (0, -9), said
        if process.returncode == 0:
            moments.append("had finished")
            continue
        saved = len(checkpoints.listed(folder / "checkpoints"))
        newest = checkpoints.listed(folder / "checkpoints")[-1].stem[-4:] if saved else "none"
        half = any(folder.rglob("*.partial"))
        moments.append(f"{delay:.2f} s (checkpoint {newest}{', half-written file' if half else ''})")
    finish(start("resume", folder) if (folder / "config.toml").exists() else start(*train, "--out", folder))
    return moments


def main(runs, episodes=1500, seed=0, report=print):
    """Kills and resumes `runs` times; returns how many were equal to the run that was left alone."""
    rng = random.Random(seed)
    equal = kills = 0
    train = ["train", *TRAIN, "--episodes", str(episodes)]
    with tempfile.TemporaryDirectory() as place:
        alone = Path(place) / "alone"
        finish(start(*train, "--out", alone))  # fills the compile cache
        again = Path(place) / "again"
        began = time.monotonic()
        finish(start(*train, "--out", again))
        whole = time.monotonic() - began
        wanted = outcome(alone)
        assert same(wanted, outcome(again))
        report(f"left alone: {whole:.1f} s, {wanted[0].num_rows:,} episodes; twice the same bits")
        for number in range(runs):
            folder = Path(place) / f"run{number}"
            moments = kill_and_resume(folder, train, whole, rng)
            alike = same(wanted, outcome(folder))
            equal += alike
            kills += sum(moment != "had finished" for moment in moments)
            report(
                f"{number + 1:4}  {'equal' if alike else 'DIFFERENT'}  killed {len(moments)} x: {'; '.join(moments)}"
            )
            for path in sorted(folder.rglob("*"), reverse=True):
                path.rmdir() if path.is_dir() else path.unlink()
    report(f"{kills} kills; {equal} of {runs} runs are equal to the uninterrupted one, bit for bit")
    return equal


if __name__ == "__main__":
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 60
    os.environ.setdefault("XDG_CACHE_HOME", str(Path(__file__).resolve().parents[1] / ".cache"))
    sys.exit(0 if main(asked) == asked else 1)
