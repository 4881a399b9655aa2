"""Several processes that share a run or a sweep, and other numbers of devices: the same records."""

import json
import os
import queue
import shutil
import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyarrow.parquet as pq
import pytest

from icac_jax.cli import main
from icac_jax.fields import ConfigError
from icac_jax.runs import links, loop, processes, session, shares
from icac_jax.settings.options import resolve
from tests.conftest import CACHE, DEVICES, here

TINY = ["--algo", "icac", "--physics", "kinematic", "--map-capacity", "16", "--episodes", "12"]


def free_address():
    """Of a port on this machine that nobody listens at."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{free.getsockname()[1]}"


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
    for process in begun(*args, number=number):
        said = process.communicate(timeout=300)
        assert process.returncode == 0, said[1]


def begun(*args, number=2):
    """Starts it only."""
    address = free_address()
    return [
        command(*args, "--coordinator", address, "--num-processes", number, "--process-id", index, wait=False)
        for index in range(number)
    ]


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


@pytest.mark.parametrize("victim", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_process_that_is_killed(alone, tmp_path, victim):
    """The other ends at once, with a line that says who has ended and how to go on."""
    folder = tmp_path / "run"
    both = begun("train", *TINY, "--seeds", 4, "--out", folder)
    while len(list(folder.glob("shares/host-*"))) != 2:
        assert all(process.poll() is None for process in both)
        time.sleep(0.02)
    both[victim].kill()
    _, said = both[1 - victim].communicate(timeout=60)
    both[victim].communicate()
    assert both[1 - victim].returncode == 128 + signal.SIGTERM
    last = said.splitlines()[-1]
    assert f"process {victim} of 2 ({socket.gethostname()}) has ended; " in last
    assert f"resume with: icac resume {folder}" in last
    assert "***" not in said
    together("resume", folder)
    close(episodes(alone), episodes(folder))


def test_each_process_says_how_far_all_are(tmp_path):
    """What the others say is added to its own where `icac runs` reads it, and stands beside its share for them."""
    work = loop.Training(loop.jobs_of(resolve(algo="cacla", physics="kinematic", seeds=2, episodes=8)))
    share, other = tmp_path / "0", tmp_path / "1"
    for folder in (share, other):
        folder.mkdir()
    session.write_status(other, "running", 11, 16)
    mine = shares.Share(share, (other, tmp_path / "not begun"), leads=True)
    session.Session(work, share, tmp_path, "", {}, 60.0, total=32, share=mine).run(work.start(), work.first())
    said = [json.loads((folder / "status.json").read_text()) for folder in (share, tmp_path)]
    assert [(one["episodes_done"], one["episodes"]) for one in said] == [(16, 16), (27, 32)]


def test_each_process_sees_its_own_devices():
    """As one of several JAX would compile another program in each, and keep that of process 0 alone."""
    address = free_address()
    code = "import sys, jax; from icac_jax.runs import processes; "
    code += "mine = processes.connect(sys.argv[1], 2, int(sys.argv[2])); "
    code += "print(mine.index, mine.count, jax.process_index(), jax.process_count(), len(jax.devices()))"
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "JAX_NUM_CPU_DEVICES": "3"}
    both = [
        subprocess.Popen([sys.executable, "-c", code, address, str(index)], env=environment, stdout=subprocess.PIPE)
        for index in range(2)
    ]
    said = [process.communicate(timeout=120)[0].split() for process in both]
    assert said == [[b"0", b"2", b"0", b"1", b"3"], [b"1", b"2", b"0", b"1", b"3"]]


def joined(facts):
    """Links of processes that are threads here: what each gets, by index; an error where it raises one."""
    address = free_address()
    with ThreadPoolExecutor(len(facts)) as threads:
        started = [threads.submit(links.join, address, index, mine, len(facts)) for index, mine in enumerate(facts)]
        return [one.result(timeout=60) for one in started]


def test_links_tell_who_has_ended():
    """Also those that have no connection to it; and nobody where it said that it was done."""
    mine = [{"host": name} for name in "abcd"]
    told = [queue.Queue() for _ in mine]
    everyone, connections = zip(*joined(mine), strict=True)
    assert everyone == (mine,) * 4
    for index in (0, 1, 3):
        links.watch(connections[index], told[index].put)
    connections[3][0].say("done")
    connections[2][0].close()
    assert [told[index].get(timeout=30) for index in (0, 1)] == [2, 2]
    connections[3][0].close()
    time.sleep(0.2)
    assert told[0].empty()
    for index in (0, 1):
        for link in connections[index].values():
            link.close()


def test_versions_that_differ():
    here = {"host": "one", "versions": {"jax": "1", "python": "3"}}
    processes.need_same_versions([here, here])
    other = {"host": "two", "versions": {"jax": "2", "python": "3"}}
    with pytest.raises(ConfigError, match=r"^versions: jax must .* process 0 \(one\) has 1, process 2 \(two\) has 2$"):
        processes.need_same_versions([here, here, other])


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
    address = free_address()
    both = [
        command("train", *TINY, "--coordinator", address, "--num-processes", 2, "--process-id", index, wait=False)
        for index in range(2)
    ]
    for process in both:
        _, said = process.communicate(timeout=120)
        assert process.returncode != 0
    assert "out: must be given" in said or "has ended" in said
    assert main.main(["train", "--num-processes", "2"]) == 2
    assert "coordinator: must be given" in capsys.readouterr().err
