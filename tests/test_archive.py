"""Records, states and folders of before, to the bit.

Each folder of `tests/archive` is one run of version 0.1.0, made before learners went behind a seam, on one device with
the instruction set AVX2 at most, which every processor with AVX2 gives the same bits for. `arrays.json` holds checksums
of its last checkpoint; the folders `half-*` hold the checkpoint itself. With lanes first, as on a GPU, today's runs are
those to the bit. With lanes last, as on a CPU, sums have another order: `lanes_last.json` has checksums of the same
runs as they have been since then (see the changelog). `python -m tests.test_archive` writes it anew.
"""

import contextlib
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

ARCHIVE = Path(__file__).parent / "archive"
# The others take the same path; `.ci/run` has them too.
QUICK = {"planar2-icac", "planar2-cacla", "planar2-cacla_var", "nico4-icac", "half-planar2-icac"}


def marked(names):
    return [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in sorted(names)]


LANES_LAST = ARCHIVE / "lanes_last.json"
RUNS = [path.name for path in ARCHIVE.iterdir() if (path / "arrays.json").exists()]
HALVES = [path.name for path in ARCHIVE.glob("half-*")]
# What a lane summed up without having it: learners without curiosity.
NOT_REPORTED = {"intrinsic_reward", "learning_progress", "perception_error", "live_nodes"}

pytestmark = pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="the archive was made with x86 instructions"
)


# Runs the commands that it is told, a line each, and answers with exit status and what was said.
COMMANDS = """
import contextlib, io, json, sys
from icac_jax.cli import main
from icac_jax.runs import devices
if sys.argv[1] == "first":
    devices.lanes_last, devices.keep_loops = (lambda large=False: False), (lambda: None)
for line in sys.stdin:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as said:
        status = main.main(json.loads(line))
    print(json.dumps([status, said.getvalue()]), flush=True)
"""


@contextlib.contextmanager
def command_line(layout):
    """The command line in one process that computes as the archive was computed, with lanes `first` or `last`."""
    env = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=1 --xla_cpu_max_isa=AVX2"}
    with subprocess.Popen(
        [sys.executable, "-c", COMMANDS, layout], env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:

        def run(*args):
            process.stdin.write(json.dumps([str(arg) for arg in args]) + "\n")
            process.stdin.flush()
            status, said = json.loads(process.stdout.readline())
            assert status == 0, said

        yield run
        process.stdin.close()


@pytest.fixture(scope="module")
def icac():
    with command_line("first") as run:
        yield run


@pytest.fixture(scope="module")
def icac_now():
    with command_line("last") as run:
        yield run


def same_rows(former, now):
    """Every column of the one is in the other, to the bit, or was nothing but zeros for want of curiosity."""
    for name in former.column_names:
        if name in now.column_names:
            assert former[name].equals(now[name]), name
        else:
            assert name in NOT_REPORTED
            assert not former[name].to_numpy().any()


def arrays(run):
    """Arrays of the newest checkpoint by the names that version 0.1.0 gave them."""
    with np.load(sorted((run / "checkpoints").glob("*.npz"))[-1]) as archive:
        named = {name: archive[name] for name in archive.files if name != "meta"}
    curious = any(name.startswith("agent.curiosity.") for name in named)

    def former(name):
        inside = "agent.agent." if curious else "agent."
        mine = name.startswith(inside) and not name.startswith("agent.curiosity.")
        return "agent.cacla." + name.removeprefix(inside) if mine else name

    return {former(name): value for name, value in named.items()}


@pytest.mark.parametrize("name", marked(RUNS))
def test_a_run_is_that_of_before_to_the_bit(name, icac, tmp_path):
    out = tmp_path / "run"
    icac("train", "--config", ARCHIVE / name / "config.toml", "--out", out)
    same_rows(pq.read_table(ARCHIVE / name / "episodes.parquet"), pq.read_table(out / "episodes.parquet"))
    wanted = json.loads((ARCHIVE / name / "arrays.json").read_text())
    found = {
        key: hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest() for key, value in arrays(out).items()
    }
    absent = wanted.keys() - found.keys()
    assert absent <= {f"totals.{column}" for column in NOT_REPORTED}
    assert {key: found[key] for key in found.keys() & wanted.keys()} == {k: wanted[k] for k in wanted.keys() - absent}


def checksums(run):
    """Of every array of the last checkpoint and every column of the record."""
    table = pq.read_table(run / "episodes.parquet")
    found = arrays(run) | {f"record.{name}": table[name].to_numpy() for name in table.column_names}
    return {key: hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest() for key, value in found.items()}


@pytest.mark.parametrize("name", marked(RUNS))
def test_a_run_with_lanes_last_has_the_bits_that_it_had(name, icac_now, tmp_path):
    out = tmp_path / "run"
    icac_now("train", "--config", ARCHIVE / name / "config.toml", "--out", out)
    assert checksums(out) == json.loads(LANES_LAST.read_text())[name]


@pytest.mark.parametrize("name", marked(HALVES))
def test_an_old_folder_is_resumed_as_if_never_stopped(name, icac, tmp_path):
    old, whole = tmp_path / "old", tmp_path / "whole"
    shutil.copytree(ARCHIVE / name, old)
    icac("resume", old, "--episodes", 90)
    icac("train", "--config", ARCHIVE / name / "config.toml", "--episodes", 90, "--out", whole)
    resumed, straight = (pq.read_table(run / "episodes.parquet") for run in (old, whole))
    assert resumed.num_rows == 3 * 90
    same_rows(straight, resumed)
    for key, value in arrays(whole).items():
        np.testing.assert_array_equal(arrays(old)[key], value, err_msg=key)


@pytest.mark.parametrize("name", marked(HALVES))
def test_an_old_folder_goes_on_with_lanes_last(name, icac_now, tmp_path):
    old = tmp_path / "old"
    shutil.copytree(ARCHIVE / name, old)
    icac_now("resume", old, "--episodes", 90)
    former, resumed = (pq.read_table(run / "episodes.parquet") for run in (ARCHIVE / name, old))
    assert resumed.num_rows == 3 * 90
    before = resumed.filter(resumed["episode"].to_numpy() < 60)
    keys = [("seed", "ascending"), ("episode", "ascending")]
    same_rows(former.sort_by(keys), before.sort_by(keys))


def test_an_altered_bit_is_seen(tmp_path):
    """The comparison can fail: one changed reward is found."""
    former = pq.read_table(ARCHIVE / RUNS[0] / "episodes.parquet")
    values = former["extrinsic_reward"].to_numpy().copy()
    values[3] = np.nextafter(values[3], np.float32(np.inf))
    place = former.schema.get_field_index("extrinsic_reward")
    changed = former.set_column(place, former.schema.field(place), [values])
    with pytest.raises(AssertionError, match="extrinsic_reward"):
        same_rows(former, changed)


if __name__ == "__main__":
    with command_line("last") as icac_of_today, tempfile.TemporaryDirectory() as folder:
        for name in RUNS:
            icac_of_today("train", "--config", ARCHIVE / name / "config.toml", "--out", Path(folder) / name)
        written = {name: checksums(Path(folder) / name) for name in sorted(RUNS)}
    LANES_LAST.write_text(json.dumps(written, indent=1) + "\n")
