"""Several processes that share a run or a sweep, and other numbers of devices: the same records."""

import os
import shutil
import socket
import subprocess
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest

from icac_jax.cli import main
from icac_jax.fields import ConfigError
from icac_jax.runs import processes
from tests.conftest import CACHE, DEVICES, here

TINY = ["--algo", "icac", "--physics", "kinematic", "--map-capacity", "16", "--episodes", "12"]


def command(*args, devices=1, wait=True, cwd=None):
    environment = os.environ | {"XDG_CACHE_HOME": str(CACHE.parent), "JAX_NUM_CPU_DEVICES": str(devices)}
    process = subprocess.Popen(
        [sys.executable, "-m", "icac_jax", *map(str, args)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    if wait:
        said = process.communicate(timeout=300)
        assert process.returncode == 0, said[1]
    return process


def done_here(*args):
    """A command in this process."""
    done = here(*args)
    assert done.returncode == 0, done.stderr


def together(*args, number=2):
    """Runs a command in `number` processes that find each other on the loopback address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    started = [
        command(*args, "--coordinator", address, "--num-processes", number, "--process-id", index, wait=False)
        for index in range(number)
    ]
    for process in started:
        said = process.communicate(timeout=300)
        assert process.returncode == 0, said[1]


def episodes(folder):
    return pq.read_table(folder / "episodes.parquet").to_pandas()


def close(one, other):
    assert list(one.columns) == list(other.columns)
    assert len(one) == len(other)
    for name in one.columns:
        np.testing.assert_allclose(one[name].astype(float), other[name].astype(float), rtol=1e-3, atol=1e-3)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    folder = tmp_path_factory.mktemp("alone") / "run"
    command("train", *TINY, "--seeds", 4, "--out", folder)
    return folder


@pytest.mark.parametrize("devices", [2, 4])
def test_other_numbers_of_devices(alone, tmp_path, devices):
    train = ["train", *TINY, "--seeds", 4, "--out", tmp_path / "run"]
    if devices == DEVICES:
        done_here(*train)
    else:
        command(*train, devices=devices)
    close(episodes(alone), episodes(tmp_path / "run"))


def test_two_processes_share_a_run(alone, tmp_path):
    """The folder is then an ordinary one: the same records, and it can be made longer by one process."""
    folder = tmp_path / "run"
    together("train", *TINY, "--seeds", 4, "--out", folder)
    close(episodes(alone), episodes(folder))
    assert not (folder / "shares").exists()
    longer = tmp_path / "longer"
    shutil.copytree(alone, longer)
    for run in (folder, longer):
        done_here("resume", run, "--episodes", 15)
    close(episodes(longer), episodes(folder))


def test_two_processes_share_a_sweep(tmp_path):
    """Three learners a program over two processes: one of them has fewer."""
    file = tmp_path / "study.toml"
    file.write_text(
        'claim = "c"\n[base]\nphysics = "kinematic"\nseeds = 3\nepisodes = 8\nmap_capacity = 16\n'
        '[grid]\nalgo = ["cacla", "icac"]\n'
    )
    done_here("sweep", file, "--out", tmp_path / "one")
    together("sweep", file, "--out", tmp_path / "two")
    close(episodes(tmp_path / "one"), episodes(tmp_path / "two"))
    assert not (tmp_path / "two" / "groups").exists()


@pytest.mark.parametrize(
    ("given", "names"),
    [
        (("localhost:1", None, None), "coordinator"),
        ((None, 2, 0), "coordinator"),
        (("localhost:1", 2, 2), "process_id"),
        (("localhost:1", 2, -1), "process_id"),
        (("localhost:1", 0, 0), "num_processes"),
    ],
)
def test_wrong_numbers(given, names):
    with pytest.raises(ConfigError, match=f"^{names}: "):
        processes.connect(*given)


def test_one_process_is_alone():
    assert processes.connect(None, None, None) == processes.connect("localhost:1", 1, 0) == processes.ALONE


def test_processes_need_a_folder_and_leave_together(tmp_path, capsys):
    """Without --out each would choose a folder for itself: refused, and the other process does not wait for ever."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    both = [
        command("train", *TINY, "--coordinator", address, "--num-processes", 2, "--process-id", index, wait=False)
        for index in range(2)
    ]
    for process in both:
        _, said = process.communicate(timeout=120)
        assert process.returncode != 0
    assert "out: must be given" in said or "JAX distributed service" in said
    assert main.main(["train", "--num-processes", "2"]) == 2
    assert "coordinator: must be given" in capsys.readouterr().err
