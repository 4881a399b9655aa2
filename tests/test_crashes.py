"""Trainings, sweeps, reproductions and evaluations that die at any act on the disk are completed by the next call."""

import contextlib
import io
import json
import os

import pytest
import tomli_w

from icac_jax.analysis import run_figures
from icac_jax.cli import main
from icac_jax.paper import figures as paper_figures
from icac_jax.reports import figures
from icac_jax.runs import loop
from icac_jax.sweeps import figures as sweep_figures
from tests import crashes, kill

BASE = {"algo": "cacla", "physics": "kinematic", "seeds": 2, "episodes": 6}
STUDY = {"base": BASE, "grid": {"gamma": [0.8, 0.9]}}
RUN = ["train", *(word for name, value in BASE.items() for word in (f"--{name}", str(value)))]
REPRODUCE = ["reproduce", "--quick", "--no-ablations", "--seeds", "2", "--episodes", "4", "--checkpoint-every", "0"]


def one_drawing(*args):
    """Drawing takes seconds and no part in what is tested."""
    return [figures.Drawing("one", "one", figures.blank(1, 1))]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(loop, "CHUNK_STEPS", 100)
    monkeypatch.setattr(sweep_figures, "all_of", one_drawing)
    monkeypatch.setattr(paper_figures, "all_of", one_drawing)
    monkeypatch.setattr(run_figures, "all_of", one_drawing)


def called(*args):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as said:
        status = main.main([str(arg) for arg in args])
    assert status == 0, said.getvalue()


def begun(folder, name):
    return (folder / name).is_file()


class Training:
    """A training from its first act, killed and resumed, or called again where it had not begun."""

    base = None

    def __init__(self, place):
        self.begin(place / "whole")
        self.wanted = kill.outcome(place / "whole")

    def begin(self, folder):
        called(*RUN, "--evaluate-every", 3, "--checkpoint-every", 0, "--out", folder)

    def again(self, folder):
        called("resume", folder) if begun(folder, "config.toml") else self.begin(folder)

    def check(self, folder, number):
        assert kill.same(kill.outcome(folder), self.wanted), f"differs after a crash at act {number}"
        assert json.loads((folder / "status.json").read_text())["state"] == "finished"
        assert json.loads((folder / "summary.json").read_text())["episodes_recorded"] == 12
        assert (folder / "report.html").is_file()
        assert not (folder / "records").exists()
        assert not list(folder.rglob("*.partial"))


class Sweep:
    """A sweep, killed and resumed, or called again where it had not begun."""

    base = None

    def __init__(self, place):
        self.file = place / "study.toml"
        self.file.write_text(tomli_w.dumps(STUDY))
        self.begin(place / "whole")
        self.wanted = self.left(place / "whole")

    def begin(self, folder):
        called("sweep", self.file, "--out", folder, "--checkpoint-every", 0)

    def again(self, folder):
        called("resume", folder) if begun(folder, "sweep.toml") else self.begin(folder)

    def left(self, folder):
        names = ("cells.csv", "episodes.parquet", "figures/one.svg", "figures/one.png")
        return [(folder / name).read_bytes() for name in names]

    def check(self, folder, number):
        assert self.left(folder) == self.wanted, f"differs after a crash at act {number}"
        assert json.loads((folder / "status.json").read_text())["state"] == "finished"
        assert "One cell" not in (folder / "report.html").read_text()
        assert (folder / "tables.md").is_file()
        assert not (folder / "groups").exists()
        assert not list(folder.rglob("*.partial"))


class Reproduction:
    """A reproduction of three runs, killed and called again or resumed."""

    base = None

    def __init__(self, place):
        self.begin(place / "whole")
        self.wanted = self.left(place / "whole")

    def begin(self, folder):
        called(*REPRODUCE, "--out", folder)

    def again(self, folder):
        called("resume", folder) if begun(folder, "reproduction.json") else self.begin(folder)

    def left(self, folder):
        runs = [folder / "planar2" / name for name in ("cacla", "cacla_var", "icac")]
        records = [(run / name).read_bytes() for run in runs for name in ("episodes.parquet", "evaluation.json")]
        return records, json.loads((folder / "claims.json").read_text())["claims"]

    def check(self, folder, number):
        assert self.left(folder) == self.wanted, f"differs after a crash at act {number}"
        assert json.loads((folder / "reproduction.json").read_text())["state"] == "finished"
        for name in ("report.html", "tables.md", "planar2/figures/one.svg"):
            assert (folder / name).is_file()


class Evaluation:
    """An evaluation of a run, killed and called again; the run is as it was."""

    def __init__(self, place):
        self.base = place / "base"
        called(*RUN, "--out", self.base)
        self.run = self.files(self.base)
        called("evaluate", self.base, "--pairs", 3)
        self.wanted = (self.base / "evaluation.json").read_bytes()
        os.unlink(self.base / "evaluation.json")

    def files(self, folder):
        return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}

    def begin(self, folder):
        called("evaluate", folder, "--pairs", 3)

    again = begin

    def check(self, folder, number):
        left = self.files(folder)
        there = {path: data for path, data in left.items() if path.name != "evaluation.json"}
        assert there == self.run, f"the run differs after a crash at act {number}"
        assert (folder / "evaluation.json").read_bytes() == self.wanted


CASES = {
    "train": (Training, (9, -3)),
    "sweep": (Sweep, (40, -9)),
    "reproduce": (Reproduction, (-4,)),
    "evaluate": (Evaluation, (1, 4)),
}


@pytest.mark.parametrize("name", CASES)
def test_a_crash_at_some_acts_loses_nothing(name, tmp_path, monkeypatch):
    kind, some = CASES[name]
    case = kind(tmp_path)
    _, acts = crashes.every(monkeypatch, case.base, tmp_path, case.begin, case.again, case.check, [10**6])
    numbers = [number % acts for number in some]
    made, _ = crashes.every(monkeypatch, case.base, tmp_path, case.begin, case.again, case.check, numbers)
    assert made == len(numbers)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_crash_at_any_act_loses_nothing(name, tmp_path, monkeypatch):
    case = CASES[name][0](tmp_path)
    made, acts = crashes.every(monkeypatch, case.base, tmp_path, case.begin, case.again, case.check)
    print(f"{name}: {made} crashes, each at another act of {acts}; none lost anything")
    assert made > 3
