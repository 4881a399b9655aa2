"""Sweeps on Ray: the same results as here, also when a worker is killed in the middle. A cluster on this machine."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import tomli_w

from icac_jax.cli import main
from tests.conftest import CACHE

pytest.importorskip("ray")

BASE = {"physics": "kinematic", "seeds": 2, "map_capacity": 16}
STUDY = {"claim": "c", "base": BASE, "grid": {"algo": ["cacla", "icac"], "gamma": [0.8, 0.9]}}


def start(file, out, *options, **environment):
    """A worker has one device; with one device here too, the same bits can be expected."""
    command = [sys.executable, "-m", "icac_jax", "sweep", str(file), "--out", str(out), *options]
    more = {"XDG_CACHE_HOME": str(CACHE.parent), "JAX_NUM_CPU_DEVICES": "1"}
    return subprocess.Popen(
        command, env=os.environ | more | environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def finish(process):
    out, said = process.communicate(timeout=500)
    assert process.returncode == 0, said
    return out


def written(place):
    return (place / "cells.csv").read_bytes(), (place / "episodes.parquet").read_bytes()


@pytest.fixture
def study(tmp_path):
    def write(episodes):
        file = tmp_path / "study.toml"
        file.write_text(tomli_w.dumps(STUDY | {"base": BASE | {"episodes": episodes}}))
        return file

    return write


@pytest.mark.slow
def test_the_same_results_as_here(study, tmp_path):
    file = study(200)
    finish(start(file, tmp_path / "here"))
    said = finish(start(file, tmp_path / "ray", "--engine", "ray"))
    assert "4 cells in 2 programs, 8 learners" in said
    assert written(tmp_path / "here") == written(tmp_path / "ray")
    assert (tmp_path / "ray" / "report.html").is_file()


def descendants(root):
    """Processes below one, with their command lines."""
    parents, commands = {}, {}
    for place in Path("/proc").iterdir():
        if place.name.isdigit():
            try:
                stat, command = (place / "stat").read_text(), (place / "cmdline").read_text()
            except OSError:
                continue
            parents[int(place.name)] = int(stat.rpartition(")")[2].split()[1])
            commands[int(place.name)] = command
    found, new = set(), {root}
    while new:
        new = {process for process, parent in parents.items() if parent in new} - found
        found |= new
    return {process: commands[process] for process in found}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").is_dir(), reason="finds the workers in /proc")
def test_a_worker_that_is_killed_in_the_middle(study, tmp_path):
    file = study(12_000)
    finish(start(file, tmp_path / "here"))
    process = start(file, tmp_path / "ray", "--engine", "ray")
    end = time.monotonic() + 200
    workers: list[int] = []
    while not workers and time.monotonic() < end:
        assert process.poll() is None, process.communicate()
        workers = [one for one, command in descendants(process.pid).items() if "train_here" in command]
        time.sleep(0.1)
    time.sleep(3)  # it compiles, or trains already
    assert not (tmp_path / "ray" / "summary.json").exists()
    os.kill(workers[0], signal.SIGKILL)
    finish(process)
    assert written(tmp_path / "here") == written(tmp_path / "ray")


@pytest.mark.slow
def test_stopped_and_gone_on_with_here(study, tmp_path):
    """Finished tasks are kept; `icac resume` needs no Ray."""
    file = study(12_000)
    process = start(file, tmp_path / "ray", "--engine", "ray")
    end = time.monotonic() + 200
    while not list((tmp_path / "ray").rglob("done.json")) and time.monotonic() < end:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 143, said
    assert "resume with: icac resume" in said
    command = [sys.executable, "-m", "icac_jax", "resume", str(tmp_path / "ray")]
    environment = os.environ | {"XDG_CACHE_HOME": str(CACHE.parent), "JAX_NUM_CPU_DEVICES": "1"}
    subprocess.run(command, check=True, env=environment, capture_output=True, timeout=500)
    finish(start(file, tmp_path / "here"))
    assert written(tmp_path / "here") == written(tmp_path / "ray")


def test_no_cluster_answers(study, tmp_path, capsys):
    """At once: Ray would try for minutes."""
    file = str(study(2))
    for address in ("127.0.0.1:1", "ray://127.0.0.1:1", "127.0.0.1:many"):
        assert main.main(["sweep", file, "--engine", "ray", "--address", address, "--out", str(tmp_path / "o")]) == 2
        error = capsys.readouterr().err
        assert f"address: no Ray cluster answers at '{address}'" in error
        assert error.count("\n") == 1
    assert not (tmp_path / "o").exists()
