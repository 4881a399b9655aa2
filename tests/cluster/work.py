"""The training and the study that each kind of cluster does, and whether what it wrote is what one process writes."""

import dataclasses
import functools
import itertools
import os
import subprocess
import sys

from tests import kill
from tests.cluster.nodes import CPU, until

# Some seconds of work each, and a checkpoint after each chunk.
TRAIN = ["train", "--algo", "icac", "--physics", "kinematic", "--map-capacity", "16", "--seeds", "4"]
TRAIN += ["--episodes", "4000", "--checkpoint-every", "0"]
STUDY = """claim = "c"
[base]
physics = "kinematic"
seeds = 2
episodes = 6000
map_capacity = 16
[grid]
algo = ["cacla", "icac"]
gamma = [0.8, 0.9]
"""


@dataclasses.dataclass(frozen=True)
class Trial:
    """What was killed while something was trained, and whether all is there that one process writes."""

    kind: str
    killed: str
    equal: bool


class Work:
    """What is trained, in folders of a place.

    Args:
      place: where to write.
    """

    def __init__(self, place):
        self.place = place
        self._numbers = itertools.count()
        self.file = place / "study.toml"
        self.file.write_text(STUDY)

    def folder(self):
        """A new one."""
        return self.place / f"trial-{next(self._numbers):02d}"

    def command(self, kind, folder):
        """The arguments of `icac` that begin a kind of work."""
        begin = TRAIN if kind == "train" else ["sweep", self.file, "--checkpoint-every", "0"]
        return [*begin, "--out", folder]

    @functools.cache  # noqa: B019 (lives as long as the program)
    def alone(self, kind, devices):
        """What one process with so many devices writes: as wide on each as the processes of a cluster are."""
        folder = self.place / f"alone-{kind}-{devices}"
        command = [sys.executable, "-m", "icac_jax", *map(str, self.command(kind, folder))]
        environment = os.environ | CPU | {"JAX_NUM_CPU_DEVICES": str(devices)}
        subprocess.run(command, env=environment, check=True, capture_output=True)
        return self.outcome(kind, folder)

    def outcome(self, kind, folder):
        """What is compared: records and final state of a training; a study's records and figures of its cells."""
        if kind == "train":
            return kill.outcome(folder)
        return (folder / "episodes.parquet").read_bytes(), (folder / "cells.csv").read_bytes()

    def equal(self, kind, devices, folder):
        """Whether a folder holds, bit for bit, what one process writes."""
        same = kill.same if kind == "train" else tuple.__eq__
        return (folder / "summary.json").exists() and same(self.alone(kind, devices), self.outcome(kind, folder))


def in_the_middle(folder):
    """Waits until each of the processes of a folder has saved something, and none has finished."""
    until(lambda: len(list(folder.rglob("checkpoints/*.npz"))) >= 1, f"a checkpoint in {folder}")
    if (folder / "summary.json").exists():
        raise AssertionError(f"{folder}: had finished before anything was killed")
