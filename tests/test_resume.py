"""Stopping, killing and resuming; full disks, read-only folders, two processes; determinism."""

import contextlib
import functools
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from icac_jax.runs import checkpoints, store, train
from icac_jax.settings.options import resolve
from tests import crashes, kill
from tests.conftest import CACHE, DEVICES, also_on_path, here

TINY = ["--physics", "kinematic", "--seeds", "3", "--map-capacity", "32", "--checkpoint-every", "0"]
SHORT = [*TINY, "--episodes", "40"]
LONG = [*TINY, "--episodes", "100000"]
STOPPED = [*TINY, "--episodes", "1200"]  # long enough to be stopped, short enough to be finished


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The folder of a short run that nobody disturbed."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    launch("train", *SHORT, "--out", folder, check=0)
    return folder


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """The folder of a run that Ctrl-C stopped, and its process with what it said."""
    folder = tmp_path_factory.mktemp("stopped") / "run"
    return folder, *sent(signal.SIGINT, "train", *STOPPED, "--out", folder)


def sent(asked, *args):
    """A process to which a signal was sent, at its end, with what it said."""
    with running(*args) as process:
        process.send_signal(asked)
        out, said = process.communicate(timeout=60)
    return process, out, said


def environment(**more):
    """That of a process with as many devices as this one has: the same programs, and so the same bits."""
    devices = {} if "XLA_FLAGS" in more else {"JAX_NUM_CPU_DEVICES": str(DEVICES)}
    return os.environ | {"XDG_CACHE_HOME": str(CACHE.parent)} | devices | more


def launch(*args, check=None, env=None, preexec_fn=None):
    """Runs a command: in this process, unless it needs another environment or other limits."""
    if env is None and preexec_fn is None:
        done = here(*args)
    else:
        done = subprocess.run(
            [sys.executable, "-m", "icac_jax", *map(str, args)],
            capture_output=True,
            text=True,
            env=environment(**(env or {})),
            timeout=300,
            check=False,
            preexec_fn=preexec_fn,
        )
    if check is not None:
        assert done.returncode == check, done.stderr
    return done


@contextlib.contextmanager
def running(*args):
    """A training in the background that has saved at least twice."""
    process = subprocess.Popen(
        [sys.executable, "-m", "icac_jax", *map(str, args)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    folder = Path(args[args.index("--out") + 1])
    deadline = time.monotonic() + 120
    while len(checkpoints.listed(folder / "checkpoints")) < 2 and time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stderr.close()


def last_line(done):
    return done.stderr.strip().splitlines()[-1]


def no_traceback(said):
    assert "Traceback" not in said, said


@pytest.mark.parametrize(
    ("kind", "runs", "seed"),
    [
        (functools.partial(kill.Train, episodes=500), 1, 13),
        pytest.param(functools.partial(kill.Train, episodes=500), 2, 1, marks=pytest.mark.slow),
        pytest.param(kill.Replay, 2, 1, marks=pytest.mark.slow),
    ],
)
def test_killed_runs_are_equal_to_the_bit(kind, runs, seed, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(CACHE.parent))
    lines = []
    equal = kill.main(runs, kind, seed=seed, report=lines.append)
    print("\n".join(lines))
    assert equal == runs


@pytest.mark.parametrize("asked", [signal.SIGINT, signal.SIGTERM])
def test_a_first_signal_saves_and_says_how_to_go_on(asked, request, tmp_path):
    if asked == signal.SIGINT:
        folder, process, out, said = request.getfixturevalue("stopped")
    else:
        folder = tmp_path / "run"
        process, out, said = sent(asked, "train", *LONG, "--out", folder)
    assert process.returncode == 128 + asked
    assert out == ""
    assert said.strip().endswith(f"stopped and saved; resume with: icac resume {folder}")
    no_traceback(said)
    assert json.loads((folder / "status.json").read_text())["state"] == "stopped"
    assert (folder / "episodes.parquet").is_file()
    listed = launch("runs", folder.parent, check=0).stdout
    assert "stopped" in listed
    assert "icac planar2 kinematic x 3" in listed


def test_a_second_signal_ends_at_once(tmp_path):
    """Both signals come while the program compiles, which the interpreter's own handlers would sit out."""
    process = subprocess.Popen(
        [sys.executable, "-m", "icac_jax", "train", *LONG, "--out", str(tmp_path / "run"), "--no-cache"],
        stderr=subprocess.PIPE,
        text=True,
        env=environment(),
    )
    said = ""
    while "compiling" not in said:
        said += process.stderr.readline()
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    _, said = process.communicate(timeout=60)
    assert time.monotonic() - began < 2
    assert process.returncode == 130
    no_traceback(said)


def test_a_stopped_run_goes_on_to_the_same_bits_and_further(stopped, tmp_path):
    """Stopped in one process and gone on with in another."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    launch("train", *TINY, "--episodes", 1500, "--out", whole, check=0)
    shutil.copytree(stopped[0], parts)
    assert stopped[1].returncode == 130
    before = json.loads((parts / "status.json").read_text())["episodes_done"]
    assert 0 < before < 3600
    launch("resume", parts, check=0)
    launch("resume", parts, "--episodes", 1500, check=0)
    assert kill.same(kill.outcome(whole), kill.outcome(parts))
    events = [json.loads(line)["event"] for line in (parts / "history.jsonl").read_text().splitlines()]
    assert events == ["started", "stopped", "resumed", "finished", "resumed", "finished"]
    summaries = [json.loads((folder / "summary.json").read_text()) for folder in (whole, parts)]
    for each in summaries:
        del each["seconds"], each["lane_steps_per_second"]
    assert summaries[0] == summaries[1]


def test_only_two_checkpoints_are_kept(alone):
    assert len(checkpoints.listed(alone / "checkpoints")) == 2


def test_a_finished_run_is_left_as_it_is(alone, tmp_path):
    shutil.copytree(alone, tmp_path / "run")
    done = launch("resume", tmp_path / "run", check=0)
    assert "has finished already" in done.stderr
    assert kill.same(kill.outcome(alone), kill.outcome(tmp_path / "run"))


def test_another_device_count_goes_on_and_says_so(stopped, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(stopped[0], folder)
    done = launch("resume", folder, check=0, env={"XLA_FLAGS": "--xla_force_host_platform_device_count=3"})
    assert "bits may differ in the last digits" in done.stderr
    assert "-> 3 devices" in done.stderr
    assert any("3 devices" in str(json.loads(line).get("changes")) for line in (folder / "history.jsonl").open())
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["episodes_recorded"] == 3600


def test_other_versions_are_named(alone, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(alone, run)
    (run / "history.jsonl").write_text((run / "history.jsonl").read_text().replace('"3.17.0"', '"3.16.0"'))
    done = launch("resume", run, "--episodes", 41, check=0)
    assert "mujoco 3.16.0 -> 3.17.0" in done.stderr


def test_full_disk(alone, tmp_path):
    """No file may grow beyond 40 kB: the checkpoint does not fit, nothing else is lost, and resuming works."""
    folder = tmp_path / "run"

    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))

    done = launch("train", *SHORT, "--out", folder, preexec_fn=small_files)
    assert done.returncode == 4, done.stderr
    assert "cannot write" in last_line(done)
    assert f"icac resume {folder}" in last_line(done)
    no_traceback(done.stderr)
    assert not list(folder.rglob("*.partial"))
    launch("resume", folder, check=0)
    assert kill.same(kill.outcome(alone), kill.outcome(folder))


@contextlib.contextmanager
def mounted(place, *options):
    place.mkdir()
    done = subprocess.run(["mount", "-t", "tmpfs", *options, "tmpfs", str(place)], capture_output=True, check=False)
    if done.returncode:
        pytest.skip("this user cannot mount a file system")
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


def test_full_file_system(alone, tmp_path):
    with mounted(tmp_path / "small", "-o", "size=200k") as disk:
        done = launch("train", *SHORT, "--out", disk / "run")
        assert done.returncode == 4, done.stderr
        assert "No space left on device" in last_line(done)
        no_traceback(done.stderr)
        subprocess.run(["mount", "-o", "remount,size=20m", str(disk)], check=True)
        launch("resume", disk / "run", check=0)
        assert kill.same(kill.outcome(alone), kill.outcome(disk / "run"))


def test_read_only_folder(alone, tmp_path):
    with mounted(tmp_path / "disk") as disk:
        shutil.copytree(alone, disk / "run")
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        for args in (["resume", disk / "run", "--episodes", 50], ["train", *SHORT, "--out", disk / "new"]):
            done = launch(*args)
            assert done.returncode == 2, done.stderr
            assert done.stderr.count("\n") == 1
            assert "cannot write to" in done.stderr
        assert "finished" in launch("runs", disk, check=0).stdout


def test_two_processes_on_one_folder(tmp_path):
    folder = tmp_path / "run"
    with running("train", *LONG, "--out", folder) as process:
        for args in (["resume", folder], ["train", *SHORT, "--out", folder]):
            done = launch(*args)
            assert done.returncode == 2
            assert done.stderr.count("\n") == 1
        assert f"in use by process {process.pid}" in launch("resume", folder).stderr
        assert "running" in launch("runs", folder, check=0).stdout
        process.kill()
        process.communicate()
    # A dead process holds no lock.
    assert "stopped" in launch("runs", folder, check=0).stdout
    with_more = launch("resume", folder, "--episodes", 5)
    assert "episodes: must be at least 100000" in with_more.stderr


def test_store_counts_each_episode_once(tmp_path):
    """Parts written after the checkpoint, rows that stand twice, and rows beyond the count are all cut back."""
    from icac_jax.runs.records import SCHEMA

    def rows(pairs):
        columns = {name: np.zeros(len(pairs)) for name in SCHEMA.names}
        columns |= {"seed": [seed for seed, _ in pairs], "episode": [episode for _, episode in pairs]}
        import pyarrow as pa

        return pa.table({name: pa.array(columns[name]).cast(SCHEMA.field(name).type) for name in SCHEMA.names}, SCHEMA)

    records = store.Store(tmp_path)
    for pairs in ([(0, 0), (1, 0)], [(0, 1), (0, 2)], [(1, 0), (1, 1), (0, 3)]):
        records.add(rows(pairs))
        records.flush()
    records.compact(np.array([3, 1]))
    table = store.read(tmp_path / store.EPISODES)
    assert list(zip(table["seed"].to_pylist(), table["episode"].to_pylist(), strict=True)) == [
        (0, 0),
        (0, 1),
        (0, 2),
        (1, 0),
    ]
    assert not (tmp_path / "records").exists()
    with pytest.raises(checkpoints.DamagedError, match="1 episodes of the checkpoint are missing"):
        records.table(np.array([4, 1]))


@pytest.mark.parametrize("step", [5, pytest.param(1, marks=pytest.mark.slow)])
def test_a_crash_at_any_act_on_the_disk_loses_nothing(step, tmp_path, monkeypatch):
    """A finished run made longer, dying at the 1st, 2nd, 3rd ... act on the file system, resumed in between.

    With a step of 5 at the 1st, 6th, 11th ... only.
    """
    settings = resolve(physics="kinematic", seeds=2, episodes=20, map_capacity=16)
    longer = resolve(**settings.flat() | {"episodes": 40})
    train.train(longer, tmp_path / "whole", checkpoint_every=0)
    wanted = kill.outcome(tmp_path / "whole")
    train.train(settings, tmp_path / "base", checkpoint_every=0)

    def resume(run):
        train.resume(run, episodes=40, checkpoint_every=0)

    def check(run, number):
        assert kill.same(wanted, kill.outcome(run)), f"differs after a crash at act {number}"
        assert json.loads((run / "summary.json").read_text())["episodes"] == 40
        assert json.loads((run / "status.json").read_text())["state"] == "finished"
        assert not (run / "records").exists()

    made, _ = crashes.every(monkeypatch, tmp_path / "base", tmp_path, resume, resume, check, step=step)
    print(f"{made} crashes, each at another act")
    assert made * step > 40


def test_a_reader_that_goes_away_does_not_stop_a_run(tmp_path):
    """Standard error is a pipe whose other end is closed, as when `tee` dies of the same Ctrl-C."""
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [sys.executable, "-m", "icac_jax", "train", *SHORT, "--out", str(tmp_path / "run")],
        stdout=subprocess.DEVNULL,
        stderr=writer,
        env=environment(),
        timeout=300,
        check=False,
    )
    os.close(writer)
    assert done.returncode == 0
    assert (tmp_path / "run" / "summary.json").is_file()


def test_a_disk_that_is_still_full_at_the_resume(alone, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(alone, run)

    def tiny_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))

    done = launch("resume", run, "--episodes", 50, preexec_fn=tiny_files)
    assert done.returncode == 4, done.stderr
    assert "make room and resume with" in last_line(done)
    no_traceback(done.stderr)
    launch("resume", run, "--episodes", 50, check=0)
    assert kill.outcome(run)[0].num_rows == 150


def test_tensorboard_is_off_unless_asked_for(alone, tmp_path):
    assert not (alone / "tensorboard").exists()
    launch("train", *SHORT, "--out", tmp_path / "run", "--tensorboard", check=0)
    assert list((tmp_path / "run" / "tensorboard").glob("events.*"))


def test_tensorboard_of_a_learner_without_curiosity(tmp_path):
    few = ["--algo", "cacla", "--physics", "kinematic", "--seeds", "2", "--episodes", "3", "--tensorboard"]
    done = here("train", *few, "--out", tmp_path / "run")
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "run" / "tensorboard").glob("events.*"))


def test_missing_tensorboard_is_one_line(tmp_path):
    (tmp_path / "tensorboardX.py").write_text("raise ImportError")
    done = launch("train", *SHORT, "--out", tmp_path / "run", "--tensorboard", env=also_on_path(tmp_path))
    assert done.returncode == 2
    assert done.stderr == "icac train: tensorboard: needs the extra, pip install 'icac_jax[tensorboard]'\n"
    assert not (tmp_path / "run").exists()
