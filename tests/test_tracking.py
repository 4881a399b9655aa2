"""Observers and trackers: what a chunk tells, what each tracker writes, and that they change nothing in a training."""

import csv
import json
import sqlite3
import sys
from types import ModuleType

import numpy as np
import pyarrow.parquet as pq
import pytest

import icac_jax
from icac_jax import ConfigError, tracking
from icac_jax.runs import loop
from tests.conftest import here

TINY = ("--algo", "cacla", "--physics", "kinematic", "--seeds", 2, "--episodes", 30)


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch):
    monkeypatch.setattr(loop, "CHUNK_STEPS", 200)


def trained(folder, *more):
    done = here("train", *TINY, *more, "--out", folder)
    assert done.returncode == 0, done.stderr
    return done


class Notebook(icac_jax.Observer):
    def __init__(self):
        self.run, self.told, self.summary = None, [], "not called"

    def start(self, run):
        self.run = run

    def see(self, told):
        self.told.append(told)

    def end(self, summary):
        self.summary = summary


def test_what_a_chunk_tells_is_what_the_record_says():
    book, chunks = Notebook(), []
    run = icac_jax.train(
        "planar2", "icac", seeds=3, episodes=30, sigma=[[0.2], [0.6]], physics="kinematic", map_capacity=32,
        observers=[book], callback=chunks.append, progress=False,
    )  # fmt: skip
    assert len(book.told) == len(chunks) > 1
    names = {"success", "steps", "extrinsic_reward", "intrinsic_reward", "learning_progress", "live_nodes"}
    counts = {"episodes", "lane_steps", "lane_steps_per_second", "diverged"}
    assert names | counts <= set(book.told[0].scalars)
    weights = np.diff([0, *(told.scalars["episodes"] for told in book.told)])
    success = [told.scalars.get("success", 0.0) for told in book.told]
    assert np.average(success, weights=weights) == pytest.approx(np.nanmean(run.episodes["reached"]))
    assert book.told[-1].scalars["lane_steps"] == np.nansum(run.episodes["steps"])
    assert all(told.scalars["lane_steps_per_second"] > 0 for told in book.told)
    assert set(book.told[0].by_seed["success"]) <= set(range(6))
    assert (book.run.folder, book.run.options["gamma"], book.summary) == (None, pytest.approx(0.9), None)
    assert np.ravel(book.run.options["sigma"]) == pytest.approx([0.2] * 3 + [0.6] * 3)


def test_observers_of_a_run_in_a_folder(tmp_path):
    book = Notebook()
    icac_jax.train(
        "planar2", "cacla", seeds=2, episodes=10, physics="kinematic", out=tmp_path / "x", observers=[book, "csv"]
    )
    assert book.run.folder == tmp_path / "x"
    assert book.run.options["algo"] == "cacla"
    assert book.summary == json.loads((tmp_path / "x" / "summary.json").read_text())
    assert (tmp_path / "x" / "progress.csv").exists()
    with pytest.raises(ConfigError, match="observers: must be objects without out"):
        icac_jax.train("planar2", observers=["csv"])


def test_trackers_change_nothing_in_the_records(tmp_path):
    trained(tmp_path / "plain")
    trained(tmp_path / "watched", "--track", "csv,tensorboard")
    first, second = (pq.read_table(tmp_path / name / "episodes.parquet") for name in ("plain", "watched"))
    assert first.equals(second)
    assert not (tmp_path / "plain" / "tracking.json").exists()


def rows_of(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_csv_and_a_resumed_run_goes_on_without_a_row_twice(tmp_path):
    trained(tmp_path / "run", "--track", "csv")
    before = rows_of(tmp_path / "run" / "progress.csv")
    assert [float(row["lane_steps"]) for row in before] == sorted({float(row["lane_steps"]) for row in before})
    assert here("resume", tmp_path / "run", "--episodes", 60).returncode == 0
    after = rows_of(tmp_path / "run" / "progress.csv")
    assert after[: len(before)] == before
    assert len(after) > len(before)
    assert float(after[-1]["episodes"]) == 120
    steps = [float(row["lane_steps"]) for row in after]
    assert steps == sorted(set(steps))


def events(folder):
    from tensorboardX.proto import event_pb2

    found = []
    for path in folder.glob("events.*"):
        data = path.read_bytes()
        while data:
            length = int.from_bytes(data[:8], "little")
            found.append(event_pb2.Event.FromString(data[12 : 12 + length]))
            data = data[16 + length :]
    return found


def test_tensorboard_has_rewards_speed_and_options(tmp_path):
    trained(tmp_path / "run", "--track", "tensorboard")
    values = [value for event in events(tmp_path / "run" / "tensorboard") for value in event.summary.value]
    tags = {value.tag for value in values}
    assert {"success/mean", "success/seed_0", "success/seed_1", "steps/mean", "extrinsic_reward/mean"} <= tags
    assert "speed/lane_steps_per_second" in tags
    assert any(value.metadata.plugin_data.plugin_name == "hparams" for value in values)


class FakeRun:
    def __init__(self, facts):
        self.facts, self.logged, self.summary, self.finished = facts, [], {}, False

    def log(self, scalars, step):
        self.logged.append((step, scalars))

    def finish(self):
        self.finished = True


@pytest.fixture
def wandb(monkeypatch):
    """A module in the place of wandb that keeps what it is told."""
    module = ModuleType("wandb")
    module.runs = []
    module.init = lambda **facts: module.runs.append(FakeRun(facts)) or module.runs[-1]
    monkeypatch.setitem(sys.modules, "wandb", module)
    monkeypatch.delitem(sys.modules, "icac_jax.tracking.wandb", raising=False)
    yield module
    sys.modules.pop("icac_jax.tracking.wandb", None)


def test_wandb_is_told_options_scalars_and_summary_and_goes_on_in_one_run(wandb, tmp_path):
    trained(tmp_path / "run", "--track", "wandb")
    (run,) = wandb.runs
    assert run.facts["name"] == "run"
    assert run.facts["config"]["gamma"] == 0.9
    assert run.facts["resume"] == "allow"
    steps = [step for step, _ in run.logged]
    assert steps == sorted(set(steps))
    assert {"success", "steps", "lane_steps_per_second", "episode"} <= set(run.logged[-1][1])
    assert run.summary["last_tenth/success_rate"] is not None
    assert run.finished
    assert here("resume", tmp_path / "run", "--episodes", 40).returncode == 0
    assert wandb.runs[1].facts["id"] == run.facts["id"]


def test_a_server_that_is_away_does_not_stop_a_training(wandb, tmp_path):
    def away(**_):
        raise OSError("no route to the server\nmore")

    wandb.init = away
    done = trained(tmp_path / "run", "--track", "wandb,csv")
    assert done.stderr.count("track: wandb gets nothing more of this run (no route to the server)") == 1
    assert rows_of(tmp_path / "run" / "progress.csv")


@pytest.mark.filterwarnings("ignore")  # of what W&B stands on
def test_the_real_wandb_offline(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    done = trained(tmp_path / "run", "--track", "wandb")
    assert "gets nothing more" not in done.stderr
    assert list((tmp_path / "run" / "wandb").glob("offline-run-*/*.wandb"))


@pytest.mark.filterwarnings("ignore")  # of what MLflow stands on
def test_the_real_mlflow_without_a_server(tmp_path, monkeypatch):
    pytest.importorskip("mlflow")
    pytest.importorskip("sqlalchemy")
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    done = trained(tmp_path / "run", "--track", "mlflow")
    assert "gets nothing more" not in done.stderr
    with sqlite3.connect(tmp_path / "mlflow.db") as database:
        metrics = dict(database.execute("select key, count(*) from metrics group by key").fetchall())
        params = dict(database.execute("select key, value from params").fetchall())
        assert database.execute("select status from runs").fetchall() == [("FINISHED",)]
    assert metrics["success"] > 1
    assert params["gamma"] == "0.9"


@pytest.mark.parametrize("name", ["tensorboard", "wandb", "mlflow"])
def test_a_missing_extra_is_one_line_and_no_folder(name, tmp_path, monkeypatch):
    for module in ("tensorboardX", "tensorboardX.event_file_writer", "wandb", "mlflow", "mlflow.entities"):
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, f"icac_jax.tracking.{name}", raising=False)
    done = here("train", *TINY, "--track", name, "--out", tmp_path / "run")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"icac train: {name}: needs the extra, pip install 'icac_jax[{name}]'\n"
    assert not (tmp_path / "run").exists()


def test_unknown_trackers_are_named(tmp_path):
    done = here("train", *TINY, "--track", "tensorbord", "--out", tmp_path / "run")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "track: must be some of tensorboard, wandb, mlflow, csv with commas, got 'tensorbord'" in done.stderr
    assert tracking.names_of(" csv, tensorboard,csv") == ["csv", "tensorboard"]
