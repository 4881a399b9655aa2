"""`icac reproduce` end to end with tiny runs: killed, stopped, gone on with, and its page in a browser."""

import contextlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pyarrow.parquet as pq
import pytest

from icac_jax.cli import main
from icac_jax.paper import reproduce
from icac_jax.reports import results, titles
from tests.conftest import CACHE

TINY = ["--arm", "planar2", "--quick", "--seeds", "2", "--episodes", "30"]
NAMES = ["cacla", "cacla_var", "icac", "icac-single_predictor", "icac-learning_progress", "icac-perception_error"]
FIGURES = ["reward", "steps", "steps_when_reached", "success", "seeds", "nodes", "intrinsic", "ablations"]


def wait_for(what, process, seconds=200):
    end = time.monotonic() + seconds
    while not what() and time.monotonic() < end:
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """The folder after a kill during the second run, Ctrl-C during the third, and a last call; what each said."""
    place = tmp_path_factory.mktemp("reproduce")
    out = place / "all"
    arm = out / "planar2"

    def start():
        return subprocess.Popen(
            [sys.executable, "-m", "icac_jax", "reproduce", *TINY, "--out", str(out)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"XDG_CACHE_HOME": str(CACHE.parent)},
        )

    killed = start()
    wait_for(lambda: (arm / "cacla_var" / "config.toml").exists(), killed)
    killed.kill()
    killed.communicate()
    first = (arm / "cacla" / "episodes.parquet").stat().st_mtime_ns

    stopped = start()
    wait_for(lambda: (arm / "icac" / "status.json").exists(), stopped)
    stopped.send_signal(signal.SIGINT)
    _, said = stopped.communicate(timeout=200)
    assert stopped.returncode == 130, said

    with contextlib.redirect_stdout(io.StringIO()) as printed, contextlib.redirect_stderr(io.StringIO()) as told:
        assert main.main(["reproduce", *TINY, "--out", str(out)]) == 0
    assert (arm / "cacla" / "episodes.parquet").stat().st_mtime_ns == first
    return out, said, printed.getvalue(), told.getvalue()


def test_stopping_says_how_to_go_on(done):
    out, said, _, _ = done
    assert said.strip().splitlines()[-1] == (
        f"icac reproduce: stopped, nothing is lost; resume with: icac reproduce {' '.join(TINY)} --out {out}"
    )
    assert "run 1 of 6: cacla on planar2: finished already" in said


def test_every_run_is_an_ordinary_run(done):
    out, *_ = done
    for name in NAMES:
        result = results.read(out / "planar2" / name, name)
        assert result.table.num_rows == 60
        assert json.loads((out / "planar2" / name / "status.json").read_text())["state"] == "finished"
        greedy = json.loads((out / "planar2" / name / "evaluation.json").read_text())
        assert greedy["pairs"] == 100
        assert 5.5 < result.summary["oracle_steps"] < 7.5
        assert result.summary["steps_over_oracle"] > 1
    spec = {name: results.read(out / "planar2" / name).settings for name in NAMES}
    assert spec["icac-single_predictor"].spec.predictors == "single"
    assert spec["icac-learning_progress"].hyper.perception_error_weight == 0
    assert spec["icac-perception_error"].hyper.learning_progress_weight == 0
    alone = results.read(out / "planar2" / "icac-perception_error")
    assert not results.by_seed(alone, "learning_progress").any()


def test_stopping_and_killing_changed_nothing(done, tmp_path):
    """The run that Ctrl-C fell into is the one that nobody disturbed, to the bit."""
    out, *_ = done
    config = str(out / "planar2" / "icac" / "config.toml")
    assert main.main(["train", "--config", config, "--out", str(tmp_path / "alone"), "--json"]) == 0
    again, first = (pq.read_table(p / "episodes.parquet") for p in (tmp_path / "alone", out / "planar2" / "icac"))
    assert again.equals(first)


def test_what_is_printed_and_told(done):
    out, _, printed, told = done
    assert printed.startswith("A quick trial")
    for title in titles.RUNS.values():
        assert title in printed
    for id in ("C1", "C2", "C9", "C9a", "C9b", "C10", "C11"):
        assert re.search(rf"^{id} +planar2 +undecided", printed, re.M)
    assert f"report: {out / 'report.html'}" in printed
    assert "run 6 of 6: icac-perception_error on planar2" in told
    assert re.search(r"run 5 of 6: .*; \d+:\d\d spent, about \d+:\d\d left in all", told)


def test_files(done):
    out, *_ = done
    names = {path.name for path in (out / "planar2" / "figures").iterdir()}
    assert names == {f"{name}.{suffix}" for name in FIGURES for suffix in ("png", "svg")}
    facts = json.loads((out / "claims.json").read_text())
    assert facts["quick"] is True
    assert [claim["verdict"] for claim in facts["claims"]] == ["undecided"] * 7
    text = (out / "tables.md").read_text()
    assert text.startswith("**A quick trial")
    for line in text.splitlines():
        if line.startswith("|"):
            assert line.count("|") in (13, 10)
    assert set(json.loads((out / "times.json").read_text())) == {f"planar2/{name}" for name in NAMES}


def browser():
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.mark.skipif(browser() is None, reason="no Chromium here")
def test_the_page_in_a_browser(done, tmp_path):
    out, *_ = done
    page = tmp_path / "alone.html"  # away from the other files: it needs none of them
    page.write_bytes((out / "report.html").read_bytes())
    head = [browser(), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    look = [*head, "--enable-logging=stderr", "--window-size=1200,900"]
    shown = subprocess.run(
        [*look, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=200, check=True
    )
    assert "CONSOLE" not in shown.stderr
    for name in FIGURES:
        figure = re.search(rf'<figure id="planar2-{name}".*?</figure>', shown.stdout, re.S)
        assert figure, name
        assert figure[0].count("<path") > 20
    assert shown.stdout.count("undecided") >= 5
    assert "A quick trial" in shown.stdout
    assert "icac train --config" in shown.stdout
    assert "seeds = 2" in shown.stdout  # the configuration
    assert "mujoco" in shown.stdout  # the versions
    assert not re.findall(r"<script|(?:src|href)=\"(?!#|data:)[^\"]*", shown.stdout)
    subprocess.run(
        [*head, f"--screenshot={tmp_path / 'page.png'}", page.as_uri()], capture_output=True, timeout=200, check=True
    )
    import matplotlib.image

    pixels = matplotlib.image.imread(tmp_path / "page.png")[..., :3]
    assert np.mean(pixels.min(axis=2) < 0.95) > 0.01  # something is drawn


def test_all_runs_in_the_folder_are_reported_if_they_compare(done, tmp_path, capsys):
    """Called again for less, it reports what was there before; a run with other seeds is left out."""
    out, *_ = done
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    other = copy / "planar2" / "icac-single_predictor"
    shutil.rmtree(other)
    few = ["train", "--seeds", "1", "--episodes", "30", "--physics", "kinematic", "--predictors", "single"]
    assert main.main([*few, "--out", str(other)]) == 0
    capsys.readouterr()
    assert main.main(["reproduce", *TINY, "--no-ablations", "--out", str(copy), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert set(facts["summaries"]["planar2"]) == set(NAMES) - {"icac-single_predictor"}
    assert [claim["id"] for claim in facts["claims"]] == ["C1", "C2", "C9a", "C9b", "C10", "C11"]
    assert facts["quick"] is True


def refused(args, capsys):
    capsys.readouterr()
    try:
        status = main.main(["reproduce", *map(str, args)])
    except SystemExit as stop:
        status = stop.code
    said = capsys.readouterr()
    assert (status, said.out, said.err.count("\n")) == (2, "", 1), said.err
    return said.err


def test_other_settings_are_refused_and_nothing_is_touched(done, capsys):
    out, *_ = done
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()}
    said = refused([*TINY, "--out", out, "--root-seed", 1], capsys)
    assert f"root_seed: must be 0 as in the run in {out / 'planar2' / 'cacla'}, got 1" in said
    said = refused(["--arm", "planar2", "--quick", "--seeds", 3, "--episodes", 30, "--out", out], capsys)
    assert "seeds: must be 2 as in the run" in said
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["--arm", "puma"], "arm: must be one of planar2, nico4, both, got 'puma'"),
        (["--seeds", "0"], "seeds: must be a whole number at least 1"),
        (["--preset", "x"], "preset: must be one of"),
        (["--quik"], "--quik: no such option"),
        (["--out", "file/x"], "out: cannot write to"),
    ],
)
def test_wrong_input(args, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert words in refused(args, capsys)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_killed_while_the_report_is_drawn_and_gone_on_with(done, tmp_path, monkeypatch, capsys):
    """The same command, or `icac resume`, draws what is missing; only then is "finished" written."""
    out, *_ = done
    assert json.loads((out / "reproduction.json").read_text())["state"] == "finished"

    class Killed(BaseException):
        """No handler of the program catches it."""

    def killed(*args):
        raise Killed

    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    for name in ("report.html", "tables.md", "claims.json"):
        (copy / name).unlink()
    with monkeypatch.context() as patch:
        patch.setattr(reproduce.page, "page", killed)
        with pytest.raises(Killed):
            main.main(["reproduce", *TINY, "--out", str(copy)])
    assert json.loads((copy / "reproduction.json").read_text())["state"] == "running"
    assert not (copy / "report.html").exists()
    capsys.readouterr()
    assert main.main(["resume", str(copy), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["quick"] is True
    assert json.loads((copy / "reproduction.json").read_text())["state"] == "finished"
    for name in ("report.html", "tables.md", "claims.json"):
        assert (copy / name).is_file()
    assert (copy / "tables.md").read_bytes().replace(b"--out copy", b"--out all") == (out / "tables.md").read_bytes()


@pytest.mark.parametrize(
    "change", ["", "[]", {"arms": ["puma"]}, {"options": {"seeds": "x"}}, {"pairs": 0}, {"command": 1}]
)
def test_a_plan_that_is_none_is_one_line(change, done, tmp_path, capsys):
    facts = json.loads((done[0] / "reproduction.json").read_text())
    text = change if isinstance(change, str) else json.dumps(facts | change)
    (tmp_path / "reproduction.json").write_text(text)
    assert main.main(["resume", str(tmp_path)]) == 3
    said = capsys.readouterr().err
    assert (said.count("\n"), "not a readable plan of a reproduction" in said) == (1, True), said


def test_what_is_altered_in_its_runs_is_made_anew(done, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(done[0], copy)
    runs = copy / "planar2"
    wanted = {
        path: json.loads(path.read_text()) for path in (runs / "cacla/evaluation.json", runs / "icac/summary.json")
    }
    claims = (copy / "claims.json").read_text()
    for (path, facts), change in zip(wanted.items(), ({"episodes_trained": "x"}, {"live_nodes": []}), strict=True):
        path.write_text(json.dumps(facts | change))
    (copy / "times.json").write_text(json.dumps({"planar2/cacla": 10**400, "planar2/icac": float("nan")}))
    # In a process of its own: XLA_FLAGS, on which last digits depend, are read once per process.
    again = [sys.executable, "-m", "icac_jax", "resume", str(copy)]
    subprocess.run(again, check=True, capture_output=True, env=os.environ | {"XDG_CACHE_HOME": str(CACHE.parent)})
    for path, facts in wanted.items():
        assert (
            json.loads(path.read_text()).items()
            >= {name: facts[name] for name in facts if "second" not in name}.items()
        )
    assert json.loads((copy / "claims.json").read_text())["claims"] == json.loads(claims)["claims"]
    assert np.isfinite(list(json.loads((copy / "times.json").read_text()).values())).all()
