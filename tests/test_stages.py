"""A sweep is trained, then reported, then finished: whatever is missing of these is made by the next call."""

import json
import shutil

import pytest
import tomli_w

from icac_jax.cli import main
from icac_jax.errors import DamagedError
from icac_jax.reports import figures
from icac_jax.runs import loop
from icac_jax.sweeps import report, stages, sweep, sweep_file

BASE = {"algo": "cacla", "physics": "kinematic", "seeds": 2, "episodes": 10}
STUDY = {"claim": "c", "base": BASE, "grid": {"gamma": [0.8, 0.9]}}
REPORT = ("report.html", "tables.md", "figures/values.svg", "figures/values.png", "figures/cells.svg")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    place = tmp_path_factory.mktemp("stages") / "sweep"
    sweep.sweep(sweep_file.parse(tomli_w.dumps(STUDY)), place)
    return place


@pytest.fixture
def place(whole, tmp_path, monkeypatch):
    shutil.copytree(whole, tmp_path / "sweep")
    monkeypatch.setattr(loop.Training, "chunks", lambda *args: pytest.fail("it trained"))
    return tmp_path / "sweep"


def state(place):
    return json.loads((place / "status.json").read_text())["state"]


def same_report(whole, place):
    return all((whole / name).read_bytes() == (place / name).read_bytes() for name in REPORT)


class Killed(BaseException):
    """No handler of the program catches it."""


MOMENTS = [(figures, "save"), (report, "markdown"), (report, "page"), (stages, "_end")]


@pytest.mark.parametrize(("owner", "name"), MOMENTS)
def test_finished_is_said_last(owner, name, tmp_path, monkeypatch, whole):
    """Killed while the report is drawn: not finished yet, and the next call draws it without any training."""
    place = tmp_path / "sweep"

    def killed(*args):
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(owner, name, killed)
        with pytest.raises(Killed):
            sweep.sweep(sweep_file.parse(tomli_w.dumps(STUDY)), place)
    assert state(place) == "running"
    assert (place / "summary.json").is_file()
    monkeypatch.setattr(loop.Training, "chunks", lambda *args: pytest.fail("it trained"))
    told = []
    result = sweep.resume(place, tell=told.append)
    assert (state(place), told) == ("finished", [])
    assert result == json.loads((place / "summary.json").read_text())
    assert (place / "figures" / "values.svg").read_bytes() == (whole / "figures" / "values.svg").read_bytes()
    assert not (place / "groups").exists()
    assert [json.loads(line)["event"] for line in (place / "history.jsonl").open()] == ["started", "finished"]
    sweep.resume(place, tell=told.append)
    assert told == ["the sweep has finished already"]


@pytest.mark.parametrize("missing", ["report.html", "tables.md", "figures"])
@pytest.mark.parametrize("again", ["resume", "sweep"])
def test_a_report_that_is_missing_is_drawn(missing, again, place, whole, tmp_path, capsys):
    """Also that of a sweep of an earlier version, which said "finished" before it had a report."""
    gone = place / missing
    shutil.rmtree(gone) if gone.is_dir() else gone.unlink()
    (tmp_path / "s.toml").write_text(tomli_w.dumps(STUDY))
    args = ["resume", str(place)] if again == "resume" else ["sweep", str(tmp_path / "s.toml"), "--out", str(place)]
    assert main.main(args) == 0
    assert "finished already" not in capsys.readouterr().err
    assert (place / "report.html").is_file()
    assert all((whole / name).read_bytes() == (place / name).read_bytes() for name in REPORT if "figures" in name)
    assert main.main(args) == 0
    assert "finished already" in capsys.readouterr().err


def test_a_report_needs_the_records_it_is_drawn_from(place, capsys):
    (place / "report.html").unlink()
    data = (place / "episodes.parquet").read_bytes()
    summary = json.loads((place / "summary.json").read_text())
    for bad in (b"", data[: len(data) // 2]):
        (place / "episodes.parquet").write_bytes(bad)
        assert main.main(["resume", str(place)]) == 3
        said = capsys.readouterr().err
        assert (said.count("\n"), "episodes.parquet" in said) == (1, True), said
    (place / "episodes.parquet").write_bytes(data)
    summary["cells"][0]["episodes_done"] += 1
    (place / "summary.json").write_text(json.dumps(summary))
    assert main.main(["resume", str(place)]) == 3
    assert "cell 0 has other episodes than the summary says" in capsys.readouterr().err


BAD = ["", "{", "[]", "{}", '{"cells": 3}', '{"cells": [3]}', '{"cells": [{"cell": 0}]}', '{"cells": {"a": 1}}']


@pytest.mark.parametrize("text", BAD)
@pytest.mark.parametrize("command", ["resume", "best"])
def test_a_summary_that_is_none_is_one_line(text, command, place, capsys):
    (place / "summary.json").write_text(text)
    assert main.main([command, str(place)]) == 3
    said = capsys.readouterr().err
    assert (said.count("\n"), "summary.json: not a readable summary" in said) == (1, True), said


@pytest.mark.parametrize("change", [{"steps_iqm": "x"}, {"name": 3}, {"varied": []}, {"by_seed": {}}, {"cell": 1.5}])
def test_a_summary_with_a_wrong_cell_is_one_line(change, place):
    summary = json.loads((place / "summary.json").read_text())
    summary["cells"][1] |= change
    (place / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(DamagedError, match="not a readable summary"):
        stages.trained(place)
