"""Files of strangers and names of any kind: read whole or refused in one line, never waited for, never trusted."""

import json
import os
import socket
import subprocess
import sys
import threading
import zipfile

import numpy as np
import pytest

from icac_jax import console, reading
from icac_jax.cli import main
from icac_jax.errors import ConfigError, DamagedError
from icac_jax.runs import checkpoints, evaluations, files, folder, session, store
from icac_jax.runs.loop import Training
from icac_jax.settings.options import resolve
from icac_jax.sweeps import sweep_file

TINY = ["--physics", "kinematic", "--seeds", "2", "--episodes", "4", "--map-capacity", "16"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(capsys, *args):
    capsys.readouterr()
    status = main.main([str(arg) for arg in args])
    return status, capsys.readouterr()


def pipe(path):
    os.mkfifo(path)


def to_zeros(path):
    path.symlink_to("/dev/zero")


def a_socket(path):
    socket.socket(socket.AF_UNIX).bind(os.path.relpath(path))


NO_FILES = {"pipe": pipe, "device": to_zeros, "socket": a_socket, "folder": os.mkdir}


@pytest.mark.parametrize("kind", NO_FILES)
def test_what_is_no_file_is_refused_at_once(kind, here, capsys):
    path = here / "c.toml"
    NO_FILES[kind](path)
    with pytest.raises(OSError, match=r"Not a regular file|Is a directory|No such device"):
        reading.text(path)
    for args in (["train", "--config", path], ["sweep", path], ["train", "--arm", path]):
        status, said = call(capsys, *args)
        assert (status, said.err.count("\n")) == (2, 1), said.err
        assert "c.toml" in said.err or "/dev/zero" in said.err


@pytest.mark.parametrize("name", ["status.json", "summary.json", "history.jsonl", "evaluations.jsonl", "lock"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_listing_waits_for_nothing(name, kind, here, capsys):
    (here / "config.toml").write_text("seeds = 2")
    NO_FILES[kind](here / name)
    status, said = call(capsys, "runs", here)
    assert status == 0
    assert "stopped" in said.out
    assert folder.history(here) == []


def test_a_pipe_in_the_place_of_a_log_is_not_waited_for(here):
    pipe(here / "log.txt")
    done = threading.Thread(target=folder.note, args=(here, "line"), daemon=True)
    done.start()
    done.join(5)
    assert not done.is_alive()


def test_size_depth_and_digits_have_bounds(here):
    (here / "big").write_bytes(b"x" * 2000)
    with pytest.raises(OSError, match="Larger than"):
        reading.data(here / "big", 1000)
    for text in ("[" * 5000 + "]" * 5000, "[" * 200 + "]" * 200, "1" * 5000, "1" * 3000):
        with pytest.raises(ValueError, match=r"nested|digits"):
            reading.parsed_json(text)
        with pytest.raises(ValueError, match=r"nested|digits"):
            reading.parsed_toml(f"x = {text}")
    for text in (".".join("a" * 300) + " = 1", "gamma = 0x" + "f" * 5000):
        (here / "c.toml").write_text(text)
        with pytest.raises(ConfigError, match=r"c\.toml is not valid TOML"):
            folder.read_options(here / "c.toml")


def test_lines_that_cannot_be_read_are_left_out(here):
    lines = [
        b'{"a": 1}',
        b"1" * 5000,
        b'{"b": ' + b"1" * 5000 + b"}",
        b"[" * 9000,
        b"\xff\xfe",
        b"[1]",
        b'{"a": 2}',
        b'{"a"',
    ]
    (here / "history.jsonl").write_bytes(b"\n".join(lines))
    assert folder.history(here) == [{"a": 1}, {"a": 2}]


def test_text_is_utf8_whatever_the_locale(here):
    (here / "s.toml").write_text('claim = "γ is what σ is not"\n[grid]\ngamma = [0.5, 0.9]\n', encoding="utf-8")
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    code = """
from pathlib import Path
from icac_jax.runs import files
from icac_jax.sweeps import sweep_file
files.write_text(Path("copy"), sweep_file.read(Path("s.toml")).claim)
files.append_line(Path("more"), "\\u03b3")
"""
    subprocess.run([sys.executable, "-c", code], cwd=here, env=os.environ | plain, check=True)
    assert (here / "copy").read_text("utf-8") == "γ is what σ is not"
    assert (here / "more").read_text("utf-8") == "γ\n"
    (here / "s.toml").write_bytes("\ufeffclaim = 'BOM'\n[grid]\ngamma = [0.5, 0.9]".encode())
    assert sweep_file.read(here / "s.toml").claim == "BOM"
    (here / "s.toml").write_bytes("claim = 'é'\n[grid]\ngamma = [0.5, 0.9]".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"s\.toml"):
        sweep_file.read(here / "s.toml")


@pytest.mark.parametrize("name", ["run:1", "s3://x", "a b%20", "x\udcffy", "z\x1b[31m\nq", "~"])
def test_a_run_may_have_any_name(name, here, capsys):
    status, said = call(capsys, "train", *TINY, f"--out={here}/{name}")
    assert status == 0, said.err
    assert store.read(here / name / "episodes.parquet").num_rows == 8
    status, said = call(capsys, "resume", here / name)
    assert (status, said.err.count("\n")) == (0, 1), said.err
    status, said = call(capsys, "runs", here)
    assert (status, said.out.count("\n")) == (0, 1)
    assert "finished" in said.out
    assert said.out.strip().isprintable()
    assert call(capsys, "runs", here, "--json")[0] == 0


def test_home_is_found_also_where_the_shell_does_not_expand_it(here, capsys, monkeypatch):
    monkeypatch.setenv("HOME", str(here))
    (here / "c.toml").write_text("gamma = 2")
    for args in (["--config=~/c.toml"], ["--config", "~/c.toml"]):
        assert f"{here}/c.toml" in call(capsys, "train", *args)[1].err
    for option in ("config", "out"):
        status, said = call(capsys, "train", f"--{option}=")
        assert (status, said.err.count("\n")) == (2, 1)
        assert said.err.startswith(f"icac train: {option}: must")


def test_what_a_stranger_wrote_is_shown_in_one_harmless_line(here, capsys):
    for name, note in (("a\x1b[2Jb", "all\nwell"), ("c\u202ed", "\x07" * 5000)):
        (here / name).mkdir()
        (here / name / "config.toml").write_text("seeds = 2")
        facts = {"state": "stopped", "note": note, "episodes_done": 10**1000, "episodes": 3}
        (here / name / "status.json").write_text(json.dumps(facts))
    status, said = call(capsys, "runs", here)
    assert (status, said.out.count("\n")) == (0, 2)
    assert all(line.isprintable() and len(line) < 1000 for line in said.out.splitlines())
    assert "a\\x1b[2Jb" in said.out
    assert "all\\nwell" in said.out
    for args in (["train", "--algo", "\x1b[31m" + "x" * 5000], ["train", "--\x1b[0m"], ["runs", "a\nb\x07"], ["\x1bx"]):
        status, said = call(capsys, *args)
        assert status == 2
        assert said.err.strip().isprintable()
        assert (said.err.count("\n"), len(said.err) < 400) == (1, True)


def test_shown_keeps_both_ends():
    assert console.shown("x\udcffy\n") == "x\\xffy\\n"
    assert console.shown("é γ") == "é γ"
    long = console.shown("begin" + "\x00" * 10**6 + "end", 60)
    assert len(long) == 60
    assert (long[:5], long[-3:]) == ("begin", "end")


def test_checkpoints_are_counted_beyond_eight_digits(here):
    for number in (99_999_998, 99_999_999, 100_000_000):
        (here / f"checkpoint-{number:08d}.npz").touch()
    (here / "checkpoint-1.npz").touch()
    assert [checkpoints.number(path) for path in checkpoints.listed(here)] == [99_999_998, 99_999_999, 100_000_000]
    (here / "records").mkdir()
    for name in ("part-99999999.parquet", "part-100000000.parquet", "part-x.parquet"):
        (here / "records" / name).touch()
    assert [path.name for path in store.Store(here)._parts()] == ["part-99999999.parquet", "part-100000000.parquet"]


def test_a_compressed_checkpoint_is_not_unpacked(here):
    with zipfile.ZipFile(here / "checkpoint-00000001.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("meta.npy", bytes(10**7))
    with pytest.raises(DamagedError, match="compressed"):
        checkpoints.read_meta(here / "checkpoint-00000001.npz")


def test_a_checkpoint_removed_while_it_was_looked_for_is_looked_for_again(here, monkeypatch):
    settings = resolve(seeds=2, episodes=4, physics="kinematic", map_capacity=16)
    training = Training.of_run(settings)
    meta = {"seconds": 0.0, "options": {}}
    old = checkpoints.save(here / "checkpoints", training.start(), meta)
    real, times = checkpoints.read_meta, []

    def rotated(path):
        times.append(path)
        if len(times) == 1:
            checkpoints.save(here / "checkpoints", training.start(), meta, keep=1)
        return real(path)

    monkeypatch.setattr(checkpoints, "read_meta", rotated)
    found, problems = session.latest(here, training, lambda _: None, records=False)
    assert (found[0].path.name, problems) == ("checkpoint-00000002.npz", [])
    assert not old.exists()


def test_half_written_files_of_a_killed_process_are_removed(here):
    for name in ("", "checkpoints", "records"):
        (here / name).mkdir(exist_ok=True)
        (here / name / f"x{files.PARTIAL}").touch()
    with folder.locked(here):
        assert list(here.rglob(f"*{files.PARTIAL}")) == []


@pytest.mark.parametrize("text", [None, b"", b"\xff\n", b'{"evaluate_every": ' + b"9" * 5000 + b"}"])
def test_evaluations_go_on_without_a_history(text, here, capsys):
    args = ["--episodes", "40", "--evaluate-every", "20"]
    assert call(capsys, "train", *TINY, *args, "--out", "run")[0] == 0
    before = len(evaluations.read(here / "run"))
    history = here / "run" / "history.jsonl"
    history.unlink() if text is None else history.write_bytes(text)
    assert call(capsys, "resume", "run", "--episodes", "80")[0] == 0
    rows = evaluations.read(here / "run")
    assert before > 0
    assert len(rows) > before
    assert {row["every"] for row in rows} == {20}


def test_records_are_read_through_an_opened_file(here):
    os.mkfifo(here / "episodes.parquet")
    with pytest.raises(DamagedError, match="Not a regular file"):
        store.read(here / "episodes.parquet")
    np.savez(here / "a.npz", x=np.zeros(3))
    with pytest.raises(DamagedError):
        store.read(here / "a.npz")


def test_an_arm_below_a_folder_that_is_no_utf8_is_refused_before_training(here, capsys):
    settings = resolve(seeds=1, physics="kinematic")
    bad = settings.__class__(**vars(settings) | {"run": settings.run.__class__(arm="/x\udcff/arm.toml")})
    with pytest.raises(ConfigError, match="arm: must be a path in UTF-8"):
        folder.config_text(bad)
