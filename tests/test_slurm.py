"""A study as a Slurm job array: scripts, tasks in any order, the same records. Slurm itself: `make test-cluster`."""

import os
import shlex
import subprocess

import pyarrow.parquet as pq
import pytest

from icac_jax.cli import listing
from icac_jax.runs import folder as run_folder
from icac_jax.sweeps import slurm
from tests.conftest import CACHE, here
from tests.test_hosts import close

STUDY = """claim = "c"
[base]
physics = "kinematic"
algo = "cacla"
seeds = 3
episodes = 8
[grid]
gamma = [0.8, 0.9]
"""


def done(*args):
    ended = here(*args)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    file = tmp_path_factory.mktemp("slurm") / "study.toml"
    file.write_text(STUDY)
    return file


def test_tasks_in_any_order_and_all_together(study, tmp_path):
    """A task by its script, as Slurm runs it; the other is lacking, and is trained by what puts all together."""
    folder = tmp_path / "a folder"
    line = done("sweep", study, "--out", folder, "--slurm", 2)
    inner, outer = folder / slurm.ARRAY, folder / slurm.COLLECT
    assert line.strip() == f"sbatch --dependency=afterany:$(sbatch --parsable '{inner}') '{outer}'"
    assert "#SBATCH --array=0-1\n" in inner.read_text()
    assert "#SBATCH --requeue\n" in inner.read_text()
    environment = os.environ | {"SLURM_ARRAY_TASK_ID": "1", "XDG_CACHE_HOME": str(CACHE.parent)}
    subprocess.run(["sh", inner], check=True, env=environment, capture_output=True, timeout=300)
    assert len(list(folder.rglob("host-0001-of-0002/done.json"))) == 1
    assert not (folder / "summary.json").exists()
    half = listing.describe(folder)
    assert (half["state"], half["episodes_done"], half["episodes"]) == ("stopped", 24, 48)
    (task,) = folder.glob("groups/*/task-0001")
    with run_folder.locked(task):
        running = listing.describe(folder)
    assert (running["state"], running["note"]) == ("running", "1 of 2 tasks run")
    command = outer.read_text().splitlines()[-1].removeprefix("exec ")
    done(*shlex.split(command)[3:])
    done("resume", folder, "--task", 0)  # as if requeued after all was done
    done("sweep", study, "--out", tmp_path / "one")
    close(*(pq.read_table(one / "episodes.parquet").to_pandas() for one in (folder, tmp_path / "one")))


@pytest.mark.parametrize(
    ("command", "options", "line"),
    [
        ("sweep", ["--slurm", "0"], "slurm: must be a whole number at least 1"),
        ("sweep", ["--slurm", "2", "--coordinator", "a:1"], "slurm: must be left out"),
        ("resume", ["--task", "2"], "task: must be a whole number at least 0 and less than 2, got 2"),
        ("resume", ["--task", "0", "--episodes", "9"], "task: must be given with a sweep"),
        ("resume", ["--coordinator", "a:1", "--num-processes", "1", "--process-id", "0", "--task", "0"], "task: must"),
    ],
)
def test_what_is_refused(study, tmp_path, command, options, line):
    folder = tmp_path / "prepared"
    done("sweep", study, "--out", folder, "--slurm", 2)
    ended = here(command, study if command == "sweep" else folder, *options)
    assert ended.returncode == 2
    assert line in ended.stderr
