"""Feeds damaged and hostile files to every command that reads some, with fresh seeds, for as long as it is told to.

`python -m tests.fuzz 10` goes on for ten minutes and prints a table. Whatever is read, a command ends with status 0, or
with 2, 3 or 4 and one line; within ten seconds unless it computes; with less than 1 GiB more memory; no file is lost.
"""

import contextlib
import io
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

from tests import damage

ROOT = Path(__file__).resolve().parents[1]
TINY = ["--algo", "cacla", "--physics", "kinematic", "--seeds", "2", "--episodes", "20", "--checkpoint-every", "0"]
STUDY = "[base]\nalgo = 'cacla'\nphysics = 'kinematic'\nseeds = 2\nepisodes = 10\n[grid]\ngamma = [0.8, 0.9]\n"
# An arm of whose goals something is kept between starts.
ANOTHER = ["train", "--algo", "cacla", "--arm", "nico4", "--physics", "kinematic", "--seeds", "1", "--episodes", "1"]
REPRODUCE = ["reproduce", "--quick", "--no-ablations", "--seeds", "2", "--episodes", "10", "--checkpoint-every", "0"]
COLUMNS = ("tried", "refused in one line", "accepted", "faults")
_SECONDS, _COMPUTING = 10, 120  # of a command that only reads, and of one that may go on and compile
_MEMORY = 2**20  # KiB


class HangError(BaseException):
    """A command took too long; no handler of the program catches it."""


def _late(*_):
    raise HangError


def call(*args, seconds=None):
    """Runs a command in this process; returns its status, what it said, and what is wrong with that, or None.

    The limit is that of a command that only reads, or so many seconds; 0 is no limit.
    """
    from icac_jax.cli import main

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    out, said = io.StringIO(), io.StringIO()
    signal.signal(signal.SIGALRM, _late)
    seconds = _SECONDS if seconds is None else seconds
    signal.alarm(seconds)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
            status = main.main([str(arg) for arg in args])
    except HangError:
        return None, "", f"took more than {seconds} s"
    except BaseException:
        return None, "", traceback.format_exc()
    finally:
        signal.alarm(0)
    more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    text = said.getvalue()
    if more > _MEMORY:
        return status, text, f"took {more >> 10} MiB more"
    if status not in (0, 2, 3, 4, 5):
        return status, text, f"status {status}: {text}"
    # Before a refusal these may have warned of a newer checkpoint, or begun to train.
    many = args[0] in ("resume", "evaluate", "export")
    one_line = text.startswith("icac") and text.count("\n") == 1
    last = text.splitlines()[-1:] or [""]
    if "Traceback" in text or (status in (2, 3, 4) and not (one_line or (many and last[0].startswith("icac")))):
        return status, text, f"said {text!r}"
    return status, text, None


def files_in(folder):
    """Every file, link and pipe below a folder."""
    return {Path(place) / name for place, _, names in os.walk(folder) for name in names}


def clean(place):
    """Removes the damaged copies."""
    for name in ("fuzzed", "own_arm"):
        shutil.rmtree(place / name, ignore_errors=True)
    for name in ("fuzzed.toml", "config.toml", "policy.npz"):
        path = place / name
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)


class Fuzzer:
    """Whole inputs to damage copies of.

    Args:
      place: an empty folder.
    """

    def __init__(self, place):
        self.place = place
        self.run, self.sweep, self.cache = place / "whole-run", place / "whole-sweep", place / "cache"
        self.reproduction = place / "whole-reproduction"
        for args in (
            ["train", *TINY, "--evaluate-every", "10", "--out", self.run],
            ["evaluate", self.run, "--pairs", "2"],
        ):
            assert call(*args, seconds=0)[0] == 0
        assert call(*ANOTHER, "--out", place / "another", seconds=0)[0] == 0  # fills the cache
        (place / "study.toml").write_text(STUDY)
        assert call("sweep", place / "study.toml", "--out", self.sweep, seconds=0)[0] == 0
        assert call(*REPRODUCE, "--out", self.reproduction, seconds=0)[0] == 0
        self.tally = {}
        self.faults = []

    def count(self, kind, rng, args, folder=None, seconds=None, what=""):
        """Calls a command on a damaged input and counts how that went."""
        before = files_in(folder) if folder else set()
        status, said, wrong = call(*args, seconds=seconds)
        lost = (
            {path.name for path in before - files_in(folder) if not path.name.endswith(".partial")} if folder else set()
        )
        # A damaged checkpoint is set aside, an old one rotated away, an end that is none any more removed.
        lost = {name for name in lost if not name.startswith(("checkpoint-", "part-", "summary.json"))}
        if wrong is None and lost and status != 0:
            wrong = f"lost {', '.join(sorted(lost))}"
        mine = self.tally.setdefault((kind, args[0]), Counter())
        mine["tried"] += 1
        if wrong is not None:
            mine["faults"] += 1
            self.faults.append(f"{kind}, {what}, icac {' '.join(map(str, args))}\n{wrong}")
            print(self.faults[-1], flush=True)
        else:
            taken = status in (0, 5) or "out: must be a new or empty folder" in said
            mine["accepted" if taken else "refused in one line"] += 1

    def study(self, rng):
        path = self.place / "fuzzed.toml"
        source = rng.choice([self.place / "study.toml", *sorted((ROOT / "sweeps").glob("*.toml"))])
        shutil.copy(source, path)
        how = self.damaged(path, rng)
        self.count("study", rng, ["sweep", path, "--dry-run"], seconds=_COMPUTING, what=how)  # traces every program

    def config(self, rng):
        path = self.place / "config.toml"
        shutil.copy(self.run / "config.toml", path)
        how = self.damaged(path, rng)
        self.count("configuration", rng, ["train", "--config", path, "--out", self.run], what=how)

    def arm(self, rng):
        folder = damage.copy(ROOT / "examples" / "own_arm", self.place / "own_arm")
        path = rng.choice([folder / "arm.toml", folder / "arm7.xml"])
        how = self.damaged(path, rng)
        args = ["train", "--arm", folder / "arm.toml", "--physics", "kinematic", "--out", self.run]
        self.count("arm", rng, args, what=f"{path.name} {how}")

    def folder(self, kind, whole, commands, rng):
        """A finished run or sweep with one damaged file, read by one of its commands."""
        copy = damage.copy(whole, self.place / "fuzzed")
        path = rng.choice(sorted(path for path in files_in(copy) if path.is_file()))
        how = self.damaged(path, rng)
        args = rng.choice(commands)
        seconds = _SECONDS if args[0] in ("runs", "best") else _COMPUTING
        args = [args[0], copy, *args[1:]]
        self.count(kind, rng, args, copy, seconds, f"{path.relative_to(copy)} {how}")

    def a_run(self, rng):
        self.folder("run", self.run, [["runs"], ["resume"], ["resume", "--episodes", "22"]], rng)

    def policy(self, rng):
        commands = [["evaluate", "--pairs", "2"], ["export", "--out", self.place / "policy.npz"]]
        self.folder("policy", self.run, commands, rng)

    def a_sweep(self, rng):
        self.folder("sweep", self.sweep, [["runs"], ["best"], ["resume"]], rng)

    def a_reproduction(self, rng):
        self.folder("reproduction", self.reproduction, [["runs"], ["runs"], ["runs"], ["resume"]], rng)

    def cached(self, rng):
        """What is kept between starts is computed anew where it is damaged."""
        path = rng.choice(sorted((self.cache / "icac_jax" / "kept").glob("*.json")))
        whole = path.read_bytes()
        how = self.damaged(path, rng)
        self.count("cache", rng, [*ANOTHER, "--out", self.place / "fuzzed"], seconds=_COMPUTING, what=how)
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)
        path.write_bytes(whole)

    def damaged(self, path, rng):
        hows = [damage.do(path, rng)]
        while rng.random() < 0.3 and path.is_file() and not path.is_symlink() and path.stat().st_size < 2**24:
            hows.append(damage.do(path, rng))
        return "+".join(hows)

    def once(self, rng):
        """One input of a kind that is drawn."""
        kinds = (self.study, self.study, self.config, self.arm, self.a_run, self.policy, self.a_sweep, self.cached)
        rng.choice((*kinds, self.a_reproduction))(rng)
        clean(self.place)

    def table(self):
        """What was tried, refused, accepted, and wrong, by kind of input and command."""
        lines = [f"{'input':15}{'command':12}" + "".join(f"{column:>22}" for column in COLUMNS)]
        for (kind, command), counts in sorted(self.tally.items()):
            lines.append(f"{kind:15}{command:12}" + "".join(f"{counts[column]:>22}" for column in COLUMNS))
        total = sum(self.tally.values(), Counter())
        return "\n".join([*lines, f"{'all':27}" + "".join(f"{total[column]:>22}" for column in COLUMNS)])


def main(minutes, seed=None, patience=1):
    """Goes on for some minutes; returns the number of faults.

    Args:
      minutes: how many.
      seed: of what is drawn; a fresh one by default.
      patience: factor on the limits of time, for a machine that has other work.
    """
    global _SECONDS, _COMPUTING
    _SECONDS, _COMPUTING = patience * _SECONDS, patience * _COMPUTING
    seed = random.randrange(10**9) if seed is None else seed
    print(f"seed {seed}", flush=True)
    with tempfile.TemporaryDirectory() as name:
        os.environ["XDG_CACHE_HOME"] = str(Path(name) / "cache")
        fuzzer, rng = Fuzzer(Path(name)), random.Random(seed)
        end = time.monotonic() + 60 * minutes
        while time.monotonic() < end:
            fuzzer.once(rng)
        print(fuzzer.table())
    return len(fuzzer.faults)


if __name__ == "__main__":
    given = [int(word) for word in sys.argv[1:]]
    sys.exit(main(given[0] if given else 10, *given[1:]) > 0)
