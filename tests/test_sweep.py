"""Sweeps from end to end, tiny: compiles, records, refilled lanes, kills, searches, the command line."""

import csv
import dataclasses
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import tomli_w

from icac_jax.cli import main
from icac_jax.fields import ConfigError
from icac_jax.runs import checkpoints, devices, folder, loop, programs, records, session, train
from icac_jax.settings.options import resolve
from icac_jax.sweeps import collect, groups, report, stages, sweep, sweep_file, tables
from icac_jax.sweeps.best import summary_of
from tests.conftest import CACHE, DEVICES, here
from tests.tables_by_hand import REPORTED

SWEEPS = Path(__file__).resolve().parents[1] / "sweeps"
BASE = {"physics": "kinematic", "seeds": 2, "episodes": 20, "map_capacity": 16}
GRID = {"claim": "c", "base": BASE, "grid": {"algo": ["cacla", "icac"], "gamma": [0.8, 0.9, 0.95]}}
WITHOUT_MAP = {name: BASE[name] for name in ("physics", "seeds", "episodes")} | {"algo": "cacla"}
ONE_PROGRAM = {"claim": "c", "base": WITHOUT_MAP, "grid": {"gamma": [0.8, 0.9, 0.95]}}
COUNTS = ["cell", "seed", "episode", "steps", "reached", "live_nodes"]


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch):
    """Many chunks in a tiny run."""
    shorten(monkeypatch)


def shorten(monkeypatch):
    monkeypatch.setattr(loop, "CHUNK_STEPS", 50)


class Compiles:
    """Counts the compiles of the training program in a block."""

    def __enter__(self):
        self.number = 0
        jax.monitoring.register_event_duration_secs_listener(self._note)
        return self

    def _note(self, event, seconds, **facts):
        self.number += "backend_compile" in event and "run_chunk" in facts.get("fun_name", "")

    def __exit__(self, *error):
        jax.monitoring.unregister_event_duration_listener(self._note)


def parsed(tables):
    return sweep_file.parse(tomli_w.dumps(tables))


def ran(place, tables=GRID, **options):
    return sweep.sweep(parsed(tables), place, **options)


def written(place):
    """The bytes of the table and of the records."""
    return (place / "cells.csv").read_bytes(), (place / "episodes.parquet").read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """All cells of a program at once: folder, summary, compiles."""
    place = tmp_path_factory.mktemp("whole") / "sweep"
    with pytest.MonkeyPatch.context() as patch, Compiles() as compiles:
        shorten(patch)
        result = ran(place)
    return place, result, compiles.number


@pytest.fixture(scope="module")
def refilled(tmp_path_factory):
    """Two lanes for six learners a program: folder, summary, compiles."""
    place = tmp_path_factory.mktemp("refilled") / "sweep"
    with pytest.MonkeyPatch.context() as patch, Compiles() as compiles:
        shorten(patch)
        result = ran(place, lanes=2)
    return place, result, compiles.number


def test_one_compile_a_program(whole, refilled):
    """However many lanes: both fill one block with padding."""
    assert [result["programs"] for _, result, _ in (whole, refilled)] == [2, 2]
    assert [compiles for *_, compiles in (whole, refilled)] == [2, 0]
    assert (whole[1]["lanes"], refilled[1]["lanes"]) == (6, 2)


def test_what_a_sweep_leaves_behind(whole):
    place, result, _ = whole
    table = pq.read_table(place / "episodes.parquet")
    assert table.schema.equals(pa.schema([pa.field("cell", pa.int32()), *records.SCHEMA, *REPORTED]))
    places = list(zip(*(table[name].to_pylist() for name in ("cell", "seed", "episode")), strict=True))
    assert places == [(cell, seed, episode) for cell in range(6) for seed in range(2) for episode in range(20)]
    rows = list(csv.DictReader((place / "cells.csv").open()))
    assert [(row["algo"], row["gamma"]) for row in rows] == [
        (algo, gamma) for algo in ("cacla", "icac") for gamma in ("0.8", "0.9", "0.95")
    ]
    for number, row in enumerate(rows):
        mine = table.filter(np.array(table["cell"]) == number)
        last = np.array(mine["episode"]) >= 18
        assert float(row["steps"]) == pytest.approx(np.array(mine["steps"])[last].mean())
        assert float(row["success_rate"]) == pytest.approx(np.array(mine["reached"])[last].mean())
        assert int(row["lane_steps"]) == np.array(mine["steps"]).sum()
        assert int(row["episodes_done"]) == 40
        assert (row["live_nodes"] == "") == (row["algo"] == "cacla")
    status = json.loads((place / "status.json").read_text())
    assert (status["state"], status["episodes_done"], status["episodes"]) == ("finished", 240, 240)
    assert result == json.loads((place / "summary.json").read_text())
    assert {path.name for path in place.iterdir()} == {
        *("sweep.toml", "plan.json", "history.jsonl", "log.txt", "status.json", "lock"),
        *("summary.json", "cells.csv", "episodes.parquet", "report.html", "tables.md", "figures"),
    }


def test_a_cell_is_the_single_run_to_the_bit(refilled, tmp_path):
    """The lanes are as many as the run's, two."""
    table = pq.read_table(refilled[0] / "episodes.parquet")
    for cell in parsed(GRID).cells()[1::3]:
        train.train(cell.settings, tmp_path / str(cell.number))
        alone = pq.read_table(tmp_path / str(cell.number) / "episodes.parquet")
        mine = table.filter(np.array(table["cell"]) == cell.number).drop_columns("cell")
        assert mine.select(alone.column_names).equals(alone)
        others = set(mine.column_names) - set(alone.column_names)
        assert len(others) == (5 if cell.settings.algo == "cacla" else 0)
        assert all(mine[name].null_count == mine.num_rows > 0 for name in others)  # cacla reports no such thing


def test_refilled_lanes_give_the_same_episodes(whole, refilled):
    """Another width of the program: the same numbers up to rounding."""
    one, two = (pq.read_table(place / "episodes.parquet").to_pandas() for place, *_ in (whole, refilled))
    assert one[COUNTS].equals(two[COUNTS])
    np.testing.assert_allclose(one.drop(columns=COUNTS), two.drop(columns=COUNTS), rtol=1e-3, atol=1e-5)


class Killed(BaseException):
    """No handler of the program catches it."""


def killed_after(number, patch, owner, name):
    """Lets a function return `number` times and then raises."""
    calls, function = [], getattr(owner, name)

    def counted(*args, **more):
        if len(calls) == number:
            raise Killed
        calls.append(1)
        return function(*args, **more)

    patch.setattr(owner, name, counted)


MOMENTS = [
    (checkpoints, "save", 0),
    (checkpoints, "save", 7),
    (checkpoints, "save", 40),  # in the second program
    (session.Store, "compact", 1),
    (collect.tables, "as_csv", 0),
    (stages.session, "write_status", 60),
    (stages, "Recorded", 0),  # before the report is drawn
    (report.files, "write_text", 9),
    (stages.shutil, "rmtree", 2),
]


@pytest.mark.parametrize(("owner", "name", "number"), MOMENTS, ids=[f"{name}-{n}" for _, name, n in MOMENTS])
def test_killed_anywhere_and_gone_on_with(owner, name, number, refilled, tmp_path, monkeypatch):
    place = tmp_path / "sweep"
    with monkeypatch.context() as patch:
        killed_after(number, patch, owner, name)
        with pytest.raises(Killed):
            ran(place, lanes=2, checkpoint_every=0)
    result = sweep.resume(place, 0)
    assert written(place) == written(refilled[0])
    assert result["cells"] == refilled[1]["cells"]
    assert not (place / sweep.GROUPS).exists()


def test_sigkill_and_resume_from_the_command_line(tmp_path, monkeypatch):
    monkeypatch.undo()  # chunks as long as those of the process that is killed
    file, killed, alone = (str(tmp_path / name) for name in ("study.toml", "killed", "alone"))
    Path(file).write_text(tomli_w.dumps(ONE_PROGRAM))
    options = [file, "--episodes", "1000", "--lanes", "4", "--checkpoint-every", "0"]

    process = subprocess.Popen(
        [sys.executable, "-m", "icac_jax", "sweep", *options, "--out", killed],
        env=os.environ | {"XDG_CACHE_HOME": str(CACHE.parent), "JAX_NUM_CPU_DEVICES": str(DEVICES)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 120
    while not list(Path(killed).rglob("*.npz")) and time.monotonic() < end:
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not (Path(killed) / "summary.json").exists()
    for command in (["resume", killed], ["sweep", *options, "--out", alone]):
        done = here(*command)
        assert done.returncode == 0, done.stderr
        assert done.stdout.rstrip().endswith(f"written to {command[-1]}")
    assert written(Path(killed)) == written(Path(alone))


def test_a_finished_sweep_is_left_alone(whole):
    place, result, _ = whole
    before = {path: path.stat().st_mtime_ns for path in place.iterdir()}
    told = []
    with Compiles() as compiles:
        assert ran(place, tell=told.append) == result
    assert told == ["the sweep has finished already"]
    assert compiles.number == 0
    after = {path: path.stat().st_mtime_ns for path in place.iterdir()}
    assert {path.name for path in before if before[path] != after[path]} <= {"lock"}


def test_a_changed_file_says_what_differs(whole):
    place, *_ = whole
    changed = GRID | {"base": BASE | {"seeds": 3}, "grid": GRID["grid"] | {"gamma": [0.8]}}
    with pytest.raises(ConfigError, match=r"holds another sweep, it differs in \[base\] seeds, \[grid\] gamma$"):
        ran(place, changed)


def test_a_wrong_cell_leaves_no_folder(tmp_path):
    with pytest.raises(ConfigError, match=r"cell 1 \(mu=5\): T: must be at most mu = 5"):
        ran(tmp_path / "sweep", {"claim": "c", "grid": {"mu": [20, 5]}})
    assert not (tmp_path / "sweep").exists()


def test_lanes_that_fail_are_counted(tmp_path):
    """Rates that make every number overflow, in one of two cells."""
    file = tmp_path / "study.toml"
    rates = {"critic_rate": [0.01, 1e38], "actor_rate": [0.01, 1e38]}
    file.write_text(tomli_w.dumps({"claim": "c", "base": ONE_PROGRAM["base"], "zip": rates}))
    assert main.main(["sweep", str(file), "--out", str(tmp_path / "sweep")]) == 0
    good, bad = summary_of(tmp_path / "sweep")["cells"]
    assert (good["failed_lanes"], bad["failed_lanes"]) == (0, 2)
    assert bad["episodes_done"] < 40 == good["episodes_done"]
    assert (bad["success_rate"], bad["steps"]) == (0.0, 50.0)
    file.write_text(tomli_w.dumps({"claim": "c", "base": ONE_PROGRAM["base"] | {"critic_rate": 1e38}}))
    assert main.main(["sweep", str(file), "--out", str(tmp_path / "all")]) == 5


def test_best_is_a_configuration_that_trains(whole, tmp_path, capsys):
    place, result, _ = whole
    assert main.main(["best", str(place), "--metric", "success_rate"]) == 0
    said = capsys.readouterr().out
    cells = result["cells"]
    most = max(cells, key=lambda row: (row["success_rate"], -row["cell"]))
    assert f"# best by success_rate: {most['name']}, " in said
    (tmp_path / "best.toml").write_text(said)
    assert folder.settings_of(tmp_path / "best.toml") == parsed(GRID).cells()[most["cell"]].settings
    out = tmp_path / "run"
    assert main.main(["train", "--config", str(tmp_path / "best.toml"), "--episodes", "3", "--out", str(out)]) == 0
    assert pq.read_table(out / "episodes.parquet").num_rows == 6


def test_best_needs_a_finished_sweep(tmp_path, capsys):
    assert main.main(["best", str(tmp_path)]) == 2
    assert "holds no sweep (no sweep.toml)" in capsys.readouterr().err
    (tmp_path / "sweep.toml").write_text(tomli_w.dumps(GRID))
    assert main.main(["best", str(tmp_path)]) == 2
    assert "has not finished (icac resume continues it)" in capsys.readouterr().err
    (tmp_path / "summary.json").write_text("{")
    assert main.main(["best", str(tmp_path)]) == 3


def test_dry_run_trains_nothing_and_writes_nothing(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(loop.Training, "chunks", lambda *args: pytest.fail("it trained"))
    (tmp_path / "study.toml").write_text(tomli_w.dumps(GRID))
    assert main.main(["sweep", "study.toml", "--dry-run", "--json", "--lanes", "4"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert [cell["name"] for cell in facts["cells"]][:2] == ["algo=cacla gamma=0.8", "algo=cacla gamma=0.9"]
    assert [(one["title"], one["cells"], one["learners"], one["lanes"]) for one in facts["programs"]] == [
        ("cacla planar2", 3, 6, 4),
        ("icac planar2", 3, 6, 4),
    ]
    assert facts["programs"][0]["memory"] < facts["programs"][1]["memory"] < 2**30
    (tmp_path / "study.toml").write_text(tomli_w.dumps(GRID | {"base": {"preset": "best", "seeds": 2}, "grid": {}}))
    assert main.main(["sweep", "study.toml", "--dry-run", "--json"]) == 0
    (best,) = json.loads(capsys.readouterr().out)["programs"]
    # Two updates of three layers are 34 Mflop: some 1,500 steps of a lane per second.
    assert best["seconds_at_most"] == pytest.approx(2 * 1000 * 50 / 1500, rel=0.5)
    (tmp_path / "study.toml").write_text(tomli_w.dumps(GRID))
    assert main.main(["sweep", "study.toml", "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "on two cores, if" in said
    assert main.main(["sweep", "study.toml", "--dry-run", "--json", "--nodes", "3"]) == 0
    spread = json.loads(capsys.readouterr().out)["programs"]
    assert [one["lanes"] for one in spread] == [2, 2]  # of six learners
    assert main.main(["sweep", "study.toml", "--dry-run", "--nodes", "3"]) == 0
    assert "on 3 nodes of two cores each" in capsys.readouterr().out
    for nodes, word in (("0", "at least 1"), ("2", "--dry-run")):
        assert main.main(["sweep", "study.toml", "--nodes", nodes]) == 2
        assert word in capsys.readouterr().err
    assert "    5  algo=icac gamma=0.95" in said
    assert "icac planar2                      3         6       6" in said
    assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]


def test_cells_share_a_program_only_if_they_differ_in_nothing_that_is_static():
    settings = resolve(arm="planar2")
    other = {"physics": "kinematic", "algo": "cacla", "arm": "other", "tip": "hand", "arm_sha256": "0"}
    traced = {"seeds", "episodes", "preset", "task"}
    for field in dataclasses.fields(settings.run):
        value = getattr(settings.run, field.name)
        changed = {field.name: other.get(field.name, value + 1 if isinstance(value, int) else f"not {value}")}
        again = dataclasses.replace(settings, run=dataclasses.replace(settings.run, **changed))
        assert (loop.program(again) == loop.program(settings)) == (field.name in traced), field.name
    cells = sweep_file.parse('claim = "c"\n[grid]\ncoverage_bins = [0, 8]\nsigma = [0.1, 0.2]\n').cells()
    assert [[cell.number for cell in group.cells] for group in groups.grouped(cells)] == [[0, 1], [2, 3]]


# Their programs are those of `curiosity` and `open_points` but for a few; each takes a second to trace.
ALIKE = ("curiosity_dose", "curiosity_gate", "curiosity_nico4", "curiosity_search", "curiosity_servo", "readings")


@pytest.mark.parametrize(
    "file",
    [
        pytest.param(file, marks=[pytest.mark.slow] if file.stem in ALIKE else [])
        for file in sorted(SWEEPS.glob("*.toml"))
    ],
    ids=lambda file: file.stem,
)
def test_shipped_sweeps_can_be_planned(file, capsys, monkeypatch):
    monkeypatch.setattr(loop.Training, "chunks", lambda *args: pytest.fail("it trained"))
    assert main.main(["sweep", str(file), "--dry-run", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert sum(one["cells"] for one in facts["programs"]) == len(facts["cells"]) == len(sweep_file.read(file).cells())


# One program, quick to compile; the others run with the slow tests.
QUICK = ("calibrate_planar2",)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(file.stem, marks=() if file.stem in QUICK else pytest.mark.slow)
        for file in sorted(SWEEPS.glob("*.toml"))
    ],
)
def test_shipped_sweeps_run(name, tmp_path, capsys):
    options = ["--seeds", "2", "--episodes", "2", "--physics", "kinematic", "--out", str(tmp_path / "sweep")]
    programs.PROGRAMS.clear()
    with Compiles() as compiles:
        assert main.main(["sweep", str(SWEEPS / f"{name}.toml"), *options, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    cells = sweep_file.read(SWEEPS / f"{name}.toml").cells()
    assert [row["name"] for row in result["cells"]] == [cell.name for cell in cells]
    assert compiles.number == result["programs"] == len(groups.grouped(cells))
    assert all(row["episodes_done"] == 4 for row in result["cells"])


SEARCH = {
    "claim": "c",
    "base": ONE_PROGRAM["base"],
    "search": {
        "trials": 5,
        "batch": 2,
        "seed": 4,
        "gamma": {"low": 0.5, "high": 0.99},
        "actor_rate": {"low": 0.001, "high": 0.5, "log": True},
        "max_actor_updates": {"low": 5, "high": 20},
        "bootstrap_at_goal": {"choices": [True, False]},
    },
}


def test_a_search_is_the_same_again_and_after_a_kill(tmp_path, monkeypatch):
    pytest.importorskip("optuna")
    with Compiles() as compiles:
        ran(tmp_path / "one", SEARCH)
    assert compiles.number <= 2  # four lanes at a time, and two for the last cell
    ran(tmp_path / "two", SEARCH)
    assert written(tmp_path / "one") == written(tmp_path / "two")
    with monkeypatch.context() as patch:
        killed_after(30, patch, checkpoints, "save")
        with pytest.raises(Killed):
            ran(tmp_path / "killed", SEARCH, checkpoint_every=0)
    assert len(list((tmp_path / "killed" / sweep.GROUPS).iterdir())) > 1
    sweep.resume(tmp_path / "killed")
    assert written(tmp_path / "one") == written(tmp_path / "killed")
    rows = summary_of(tmp_path / "one")["cells"]
    assert len(rows) == 5
    assert len({json.dumps(row["varied"]) for row in rows}) == 5
    ran(tmp_path / "other", SEARCH | {"search": SEARCH["search"] | {"seed": 5}})
    assert summary_of(tmp_path / "other")["cells"][0]["varied"] != rows[0]["varied"]


def test_a_search_goes_where_it_is_better():
    """On a made-up landscape, without training: the later half of the trials is nearer to the best than the first."""
    pytest.importorskip("optuna")
    from icac_jax.sweeps.search import Asking

    asking = Asking(parsed(SEARCH | {"search": SEARCH["search"] | {"trials": 60, "batch": 4}}))
    tried = []
    for cells in asking.batches():
        rates = [np.log10(cell.varied["actor_rate"]) for cell in cells]
        tried += [abs(rate + 1) for rate in rates]
        asking.tell([{"steps": 50.0 if rate < -2.9 else 10 * abs(rate + 1)} for rate in rates])
    assert np.mean(tried[30:]) < 0.5 * np.mean(tried[:10])


def test_wrong_options(tmp_path, capsys, monkeypatch):
    (tmp_path / "study.toml").write_text(tomli_w.dumps(GRID))
    monkeypatch.chdir(tmp_path)
    for args, said in (
        ([], "file: must be a sweep file or the name of a shipped one, got nothing"),
        (["gama"], "file: there is no file gama, and no such study among best, calibrate_nico4, calibrate_planar2, "),
        (["gama"], "; did you mean gamma?"),
        (["none.toml"], "file: cannot read none.toml: No such file or directory"),
        (["study.toml", "--lanes", "0"], "lanes: must be a whole number at least 1"),
        (["study.toml", "--checkpoint-every", "-1"], "checkpoint_every: must be a number at least 0"),
        (["study.toml", "--physics", "soft"], "[base] physics: must be one of servo, kinematic, got 'soft'"),
    ):
        assert main.main(["sweep", *args]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["study.toml"]


def test_shipped_studies_are_found_by_name(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main.main(["sweep", "gamma", "--dry-run"]) == 0
    assert capsys.readouterr().out.startswith("C6: the discount factor does not matter\n")
    (tmp_path / "gamma").write_text(tomli_w.dumps(GRID))
    assert main.main(["sweep", "gamma", "--dry-run"]) == 0
    assert capsys.readouterr().out.startswith("c\n")


def test_the_table_of_cells_as_csv():
    figures = {name: 1.0 for name in tables.ESTIMATED}
    rows = [
        {"cell": 0, "name": "a", "varied": {"gamma": 0.5, "joint_low": (0.0, 1.0)}, "by_seed": {}, **figures},
        {"cell": 1, "name": "b", "varied": {"gamma": 0.9}, "by_seed": {}, **figures | {"steps": None}},
    ]
    read = list(csv.DictReader(io.StringIO(tables.as_csv(rows))))
    assert [(row["cell"], row["gamma"], row["joint_low"], row["steps"]) for row in read] == [
        ("0", "0.5", "0.0 1.0", "1.0"),
        ("1", "0.9", "", ""),
    ]


def test_devices_of_these_tests():
    """Two, so that lanes are spread and padded."""
    assert devices.lane_mesh(6).size == 2
