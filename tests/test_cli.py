"""The command line as a user meets it: its output, its exit status, its files; some of it in a process of its own."""

import json
import tomllib

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from icac_jax.cli import main
from icac_jax.runs import records
from icac_jax.settings import options
from tests.conftest import DEVICES, apart

TINY = ("--seeds", 3, "--episodes", 5, "--physics", "kinematic", "--map-capacity", 32)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """One tiny run that several tests look at."""
    folder = tmp_path_factory.mktemp("run")
    devices = {"JAX_NUM_CPU_DEVICES": str(DEVICES)}  # as in this process, where the run is repeated
    done = apart("train", *TINY, "--out", "here", "--json", cwd=folder, env=devices)
    assert done.returncode == 0, done.stderr
    return folder, done


def test_json_is_all_there_is_on_standard_output(finished):
    folder, done = finished
    summary = json.loads(done.stdout)
    assert summary == json.loads((folder / "here" / "summary.json").read_text())
    assert summary["episodes_recorded"] == 15
    assert summary["failed_seeds"] == {}
    assert set(summary["first_tenth"]) == {"episodes", "success_rate", "steps", "steps_when_reached"}
    assert "episodes" in done.stderr  # progress goes to standard error


def test_run_folder(finished):
    folder, _ = finished
    run = folder / "here"
    assert sorted(p.name for p in run.iterdir()) == [
        *["checkpoints", "config.toml", "episodes.parquet", "history.jsonl", "lock"],
        *["log.txt", "report.html", "status.json", "summary.json"],
    ]
    table = pq.read_table(run / "episodes.parquet")
    terms = [pa.field(name, pa.float32()) for name in ("intrinsic_reward", "learning_progress", "perception_error")]
    counts = [pa.field(name, pa.int32()) for name in ("live_nodes", "overflow")]
    assert table.schema.equals(pa.schema([*records.SCHEMA, *terms, *counts]))
    rows = table.to_pylist()
    assert [(row["seed"], row["episode"]) for row in rows] == [(s, e) for s in range(3) for e in range(5)]
    assert all(1 <= row["steps"] <= 50 and row["live_nodes"] >= 2 for row in rows)
    assert all(row["extrinsic_reward"] == 50 * row["reached"] for row in rows)
    started, ended = map(json.loads, (run / "history.jsonl").read_text().splitlines())
    assert started["platform"]["versions"]["mujoco"] == "3.17.0"
    assert (started["event"], ended["event"]) == ("started", "finished")
    assert tomllib.loads((run / "config.toml").read_text())["seeds"] == 3


def test_config_file_repeats_the_run_bit_by_bit(finished, icac):
    folder, _ = finished
    icac("train", "--config", folder / "here" / "config.toml", "--out", folder / "again", check=0)
    first, second = (pq.read_table(folder / name / "episodes.parquet") for name in ("here", "again"))
    assert first.equals(second)


def test_text_summary_and_numbered_folders(icac, tmp_path):
    for number, env in (("001", {}), ("002", None)):
        done = icac("train", *TINY[:-2], "--algo", "cacla", check=0, env=env)  # a learner without a map
        assert "success" in done.stdout
        assert "steps when reached" in done.stdout
        assert "lane-steps per second" in done.stdout
        assert f"runs/planar2-cacla-{number}" in done.stdout
        assert (tmp_path / "runs" / f"planar2-cacla-{number}" / "summary.json").is_file()


def test_diverging_lanes_are_named_and_do_not_stop_the_run(icac):
    done = icac("train", *TINY, "--critic-rate", 1e30, "--out", "x", "--json", check=5)
    summary = json.loads(done.stdout)
    assert sorted(summary["failed_seeds"]) == ["0", "1", "2"]
    assert done.stderr.splitlines()[-1] == "icac: every learner diverged"


def one_line(done, *words):
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1, done.stderr
    for word in words:
        assert word in done.stderr


WRONG = [
    (["--gama", "0.9"], ["--gama", "--gamma"]),
    (["--gamma", "2"], ["gamma: must be", "less than 1", "2.0"]),
    (["--gamma", "x"], ["gamma: must be a number", "'x'"]),
    (["--gamma"], ["gamma"]),
    (["--actor-rate", "-1"], ["actor_rate: must be a number greater than 0", "-1"]),
    (["--horizon", "0"], ["horizon: must be a whole number at least 1"]),
    (["--horizon", "1.5"], ["horizon: must be a whole number at least 1", "1.5"]),
    (["--e-max", "0"], ["e_max: must be a number greater than 0"]),
    (["--map", "gng", "--e-max", "0.5"], ["e_max: no option of the map gng, only of itm"]),
    (["--map", "web"], ["map: must be one of itm, gng, som, grid, got 'web'"]),
    (["--T", "41"], ["T: must be at most mu"]),
    (["--algo", "sac"], ["algo: must be one of cacla, cacla_var, icac, ddpg, td3", "'sac'"]),
    (["--arm", "puma"], ["arm: must be one of planar2, nico4", "'puma'"]),
    (["--preset", "x"], ["preset: must be one of paper, paper-literal", "'x'"]),
    (["--physics", "magic"], ["physics: must be one of servo, kinematic", "'magic'"]),
    (["--joint-low", "1"], ["joint_low: must be 2 numbers"]),
    (["--seeds", "0"], ["seeds: must be a whole number at least 1"]),
    (["--bootstrap-at-goal", "maybe"], ["bootstrap_at_goal: must be true or false", "'maybe'"]),
    (["stray"], ["stray"]),
    (["--config", "absent.toml"], ["config: cannot read absent.toml"]),
]


@pytest.mark.parametrize(("args", "words"), WRONG, ids=[" ".join(args) for args, _ in WRONG])
def test_wrong_input_is_one_line_and_status_2(args, words, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    try:
        status = main.main(["train", *args])
    except SystemExit as stop:
        status = stop.code
    said = capsys.readouterr()
    assert status == 2
    assert said.out == ""
    assert said.err.startswith("icac train: ")
    assert said.err.count("\n") == 1, said.err
    for word in words:
        assert word in said.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("gama = 1", ["gama: no such option", "gamma"]),
        ("gamma = 'x'", ["gamma: must be"]),
        ("gamma =", ["not valid TOML"]),
        ("[hyper]\ngamma = 0.9", ["hyper: no such option"]),
        ("seeds = 1.5", ["seeds: must be a whole number"]),
    ],
)
def test_wrong_config_file(text, words, icac, tmp_path):
    (tmp_path / "c.toml").write_text(text)
    one_line(icac("train", "--config", "c.toml"), *words)


def test_a_folder_with_a_run_is_refused_and_kept(finished, icac):
    folder, _ = finished
    before = (folder / "here" / "episodes.parquet").read_bytes()
    one_line(icac("train", *TINY, "--out", folder / "here"), "out: must be a new or empty folder", "holds a run")
    assert (folder / "here" / "episodes.parquet").read_bytes() == before


def test_unwritable_folder(icac, tmp_path):
    (tmp_path / "file").write_text("")
    one_line(icac("train", *TINY, "--out", tmp_path / "file" / "run"), "out: cannot write to")
    one_line(icac("train", *TINY, "--out", "/proc/run"), "out: cannot write to")


def test_help_and_version(icac):
    short = icac("--help", check=0).stdout
    assert "train" in short
    assert len(short.splitlines()) < 20
    assert icac("--version", check=0).stdout.startswith("icac_jax ")
    page = icac("train", "--arm", "nico4", "--help", check=0).stdout
    for word in ("--sigma", "--T", "action bound", "Eq. 10", "Sec. IV", "--out", "--joint-low", "-140"):
        assert word in page
    choices = icac("train", "--help-choices", check=0).stdout
    task = icac("train", "--help-task", check=0).stdout
    for text in (page, choices, task):
        assert len(text.splitlines()) <= 55
        assert max(map(len, text.splitlines())) <= 120
    for name, field in options.options_of("icac").items():  # every option is on one of the pages
        there = f"--{name.replace('_', '-')} " in page + choices + task
        assert there == options.applies(field, {}), name
    gas = icac("train", "--map", "gng", "--help", check=0).stdout
    assert "--gng-interval " in gas
    assert "--e-max " not in gas
    one_line(icac("walk", env={}), "unknown command 'walk'", "train")
    assert icac().returncode == 2
