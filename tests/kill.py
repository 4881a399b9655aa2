"""Kills commands at random moments (kill -9, Ctrl-C), goes on with them, and compares with what nobody disturbed.

`python -m tests.kill 500` does so for every command that writes, and prints a table; the test suite runs a few.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from icac_jax.runs import checkpoints

# Saving after each chunk makes about half of the moments fall into a save.
TINY = ["--physics", "kinematic", "--seeds", "3", "--checkpoint-every", "0"]
TRAIN = [*TINY, "--map-capacity", "32"]
_MOST = 300  # seconds after which a process hangs


def start(*args):
    command = [sys.executable, "-m", "icac_jax", *map(str, args)]
    # A shell that starts something in the background has it ignore Ctrl-C.
    obey = {"preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **obey)


def finish(process):
    _, said = process.communicate(timeout=_MOST)
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


class Train:
    """A training; what a user does after a kill is `icac resume`, or the same again where there is no run yet."""

    name = "train"

    def __init__(self, place, episodes=300):
        self.options = ["train", *TRAIN, "--episodes", str(episodes)]

    def prepare(self, folder):
        """Makes what the command needs in the folder that it is to write."""

    def begin(self, folder):
        return [*self.options, "--out", folder]

    def again(self, folder):
        return ["resume", folder] if (folder / "config.toml").exists() else self.begin(folder)

    outcome = staticmethod(outcome)
    same = staticmethod(same)


class Replay(Train):
    """TD3 with hindsight, whose replay buffers are in the checkpoints."""

    name = "train td3"

    def __init__(self, place):
        small = ["--hidden-units", 16, "--batch-size", 16, "--warm-up", 100, "--buffer-size", 1024]
        learner = ["--algo", "td3", "--hindsight", "future", *map(str, small)]
        self.options = ["train", *TINY, *learner, "--episodes", "60"]


class Resume(Train):
    """A finished run that is made longer."""

    name = "resume"

    def __init__(self, place):
        super().__init__(place, 150)
        self.base = place / "resume-base"
        finish(start(*self.options, "--out", self.base))

    def prepare(self, folder):
        shutil.copytree(self.base, folder)

    def begin(self, folder):
        return ["resume", folder, "--episodes", 300, "--checkpoint-every", 0]

    again = begin


class Files:
    """What is compared is bytes of files, and a state that says "finished"."""

    compared = ()
    state = ("status.json", "finished")

    def prepare(self, folder):
        """Nothing."""

    def outcome(self, folder):
        said = json.loads((folder / self.state[0]).read_text())["state"] if self.state else None
        left = [(folder / name).read_bytes() for name in self.compared]
        return left, None if self.state is None else said == self.state[1]

    def same(self, one, other):
        return one == other


class Sweep(Files):
    name = "sweep"
    compared = ("cells.csv", "episodes.parquet", "figures/values.svg", "figures/cells.png")

    def __init__(self, place):
        self.file = place / "study.toml"
        self.file.write_text("[base]\nalgo = 'cacla'\n[grid]\ngamma = [0.8, 0.9]\n")

    def begin(self, folder):
        options = ["--physics", "kinematic", "--seeds", "2", "--episodes", "100", "--checkpoint-every", "0"]
        return ["sweep", self.file, *options, "--out", folder]

    def again(self, folder):
        return ["resume", folder] if (folder / "sweep.toml").exists() else self.begin(folder)

    def outcome(self, folder):
        assert (folder / "report.html").exists()
        assert not (folder / "groups").exists()
        return super().outcome(folder)


class Reproduce(Files):
    name = "reproduce"
    state = ("reproduction.json", "finished")
    compared = tuple(f"planar2/{run}/episodes.parquet" for run in ("cacla", "cacla_var", "icac"))
    compared += ("planar2/icac/evaluation.json", "planar2/figures/steps.svg")

    def __init__(self, place):
        pass

    def begin(self, folder):
        options = ["--quick", "--no-ablations", "--seeds", "2", "--episodes", "60", "--checkpoint-every", "0"]
        return ["reproduce", *options, "--out", folder]

    def again(self, folder):
        return ["resume", folder] if (folder / "reproduction.json").exists() else self.begin(folder)

    def outcome(self, folder):
        assert (folder / "report.html").exists()
        return super().outcome(folder)


class Evaluate(Files):
    name = "evaluate"
    state = None
    compared = ("evaluation.json", "episodes.parquet", "summary.json", "status.json", "config.toml")

    def __init__(self, place):
        self.base = place / "evaluate-base"
        finish(start("train", *TINY, "--algo", "cacla", "--episodes", 100, "--out", self.base))

    def prepare(self, folder):
        shutil.copytree(self.base, folder)

    def begin(self, folder):
        return ["evaluate", folder, "--pairs", 20]

    again = begin


def reached(process):
    """Whether the interpreter has come to this package, which answers Ctrl-C; before, only Python itself could."""
    try:
        return "_socket" in Path(f"/proc/{process.pid}/maps").read_text()
    except OSError:
        return True


def strike(process, delay, politely, tally):
    """Kills a process after some seconds, or asks it to stop; whether it had finished by then."""
    deadline = time.monotonic() + delay
    while (time.monotonic() < deadline or (politely and not reached(process))) and process.poll() is None:
        time.sleep(0.002)
    process.send_signal(signal.SIGINT if politely else signal.SIGKILL)
    try:
        _, said = process.communicate(timeout=_MOST)
    except subprocess.TimeoutExpired:
        tally["hangs"] += 1
        process.kill()
        _, said = process.communicate()
    tally["tracebacks"] += "Traceback" in said
    allowed = (0, 130, -9) if politely else (0, -9)
    tally["wrong status"] += process.returncode not in allowed
    tally["tried"] += process.returncode != 0
    return process.returncode == 0


def attack(case, folder, whole, rng, tally, polite=0.0):
    """One job of a command, killed one to four times in a row and completed; returns the moments of the kills."""
    case.prepare(folder)
    moments = []
    for number in range(rng.choice([1, 1, 2, 3, 4])):
        process = start(*(case.again(folder) if number else case.begin(folder)))
        # Mostly while it works and saves; sometimes while it starts.
        delay = rng.uniform(0.45, 1.0) * whole if rng.random() < 0.85 else rng.uniform(0.0, 0.45) * whole
        politely = rng.random() < polite
        if strike(process, delay, politely, tally):
            moments.append("had finished")
            continue
        half = any(folder.rglob("*.partial"))
        moments.append(f"{'Ctrl-C' if politely else 'kill'} {delay:.2f} s{' (half-written file)' if half else ''}")
    process = start(*case.again(folder))
    try:
        _, said = process.communicate(timeout=_MOST)
        tally["tracebacks"] += "Traceback" in said
    except subprocess.TimeoutExpired:
        tally["hangs"] += 1
        process.kill()
        process.communicate()
    return moments


def alone(case, place, report):
    """What a job gives that nobody disturbs, which is done twice, and how long it takes."""
    outcomes = []
    for name in ("alone", "again"):  # the first fills the compile cache
        folder = place / f"{case.name}-{name}"
        case.prepare(folder)
        began = time.monotonic()
        finish(start(*case.begin(folder)))
        whole = time.monotonic() - began
        outcomes.append(case.outcome(folder))
    assert case.same(*outcomes)
    report(f"{case.name}, left alone: {whole:.1f} s; twice the same bits")
    return outcomes[0], whole


def struck(case, wanted, whole, folder, rng, tally, report, polite=0.0):
    """Attacks one job and counts what is lost; whether nothing is."""
    moments = attack(case, folder, whole, rng, tally, polite)
    try:
        alike = case.same(wanted, case.outcome(folder))
    except Exception as error:
        alike = False
        moments.append(f"{type(error).__name__}: {error}")
    tally["lost"] += not alike
    report(f"{case.name:10}{'equal' if alike else 'DIFFERENT'}  {'; '.join(moments)}")
    shutil.rmtree(folder, ignore_errors=True)
    return alike


def main(runs, kind=Train, seed=0, report=print):
    """Kills and resumes `runs` jobs of a kind; returns how many were equal to the job that was left alone."""
    rng, tally = random.Random(seed), Counter()
    with tempfile.TemporaryDirectory() as place:
        case = kind(Path(place))
        wanted, whole = alone(case, Path(place), report)
        equal = sum(
            struck(case, wanted, whole, Path(place) / f"run{number}", rng, tally, report) for number in range(runs)
        )
    report(f"{tally['tried']} kills; {equal} of {runs} runs are equal to the uninterrupted one, bit for bit")
    return equal if not tally["tracebacks"] + tally["wrong status"] else 0


COLUMNS = ("tried", "lost", "tracebacks", "hangs", "wrong status")


def everything(kills, minutes=float("inf"), seed=None, report=print):
    """Kills every command in turn until there were so many kills; returns the counts by command."""
    seed = random.randrange(10**9) if seed is None else seed
    rng, end = random.Random(seed), time.monotonic() + 60 * minutes
    report(f"seed {seed}")
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        cases = [kind(place) for kind in (Train, Replay, Resume, Sweep, Reproduce, Evaluate)]
        known = {case.name: alone(case, place, report) for case in cases}
        tallies = {case.name: Counter() for case in cases}
        number = 0
        while sum(tally["tried"] for tally in tallies.values()) < kills and time.monotonic() < end:
            case = cases[number % len(cases)]
            struck(case, *known[case.name], place / f"try{number}", rng, tallies[case.name], report, polite=0.4)
            number += 1
    report(f"{'':12}" + "".join(f"{column:>14}" for column in COLUMNS))
    for name, tally in tallies.items():
        report(f"{name:12}" + "".join(f"{tally[column]:>14}" for column in COLUMNS))
    return tallies


if __name__ == "__main__":
    os.environ.setdefault("XDG_CACHE_HOME", str(Path(__file__).resolve().parents[1] / ".cache"))
    asked = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    counts = everything(asked, float(sys.argv[2]) if len(sys.argv) > 2 else float("inf"))
    sys.exit(any(tally[column] for tally in counts.values() for column in COLUMNS[1:]))
