"""`icac compare`, `icac plot` and the report of a run: right numbers, pairs, colours; pages that need nothing else."""

import csv
import json
import re

import numpy as np
import pytest
from PIL import Image
from rliable import library, metrics

from icac_jax.analysis import compare, compare_figure, run_page, subjects
from icac_jax.cli import main
from icac_jax.reports import figures, results, statistics
from tests.conftest import here

TINY = ("--physics", "kinematic", "--seeds", 4, "--episodes", 40, "--algo", "cacla")
STUDY = '[base]\nalgo = "cacla"\nphysics = "kinematic"\nseeds = 4\nepisodes = 20\n[grid]\ngamma = [0.8, 0.9]\n'


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Three runs of one task, one of another root seed, and a sweep."""
    place = tmp_path_factory.mktemp("compare")
    for name, more in (("a", ()), ("b", ("--sigma", 1.0)), ("c", ("--gamma", 0.5)), ("other", ("--root-seed", 7))):
        assert here("train", *TINY, *more, "--out", name, cwd=place).returncode == 0
    (place / "study.toml").write_text(STUDY)
    assert here("sweep", "study.toml", "--out", "sweep", cwd=place).returncode == 0
    return place


def rows_of(done):
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_numbers_are_those_of_the_records(place):
    rows = rows_of(here("compare", "a", "b", "--metric", "steps", "--json", cwd=place))
    first, second = (results.last_tenth(results.read(place / name))["steps"] for name in "ab")
    assert [row["run"] for row in rows] == ["a", "b"]
    assert rows[0]["mean"] == pytest.approx(first.mean())
    assert rows[0]["difference"] is None
    assert rows[1]["difference"] == pytest.approx((second - first).mean())
    assert rows[1]["difference_low"] <= rows[1]["difference"] <= rows[1]["difference_high"]
    # Fewer steps are better.
    better = np.mean([(b < a) + 0.5 * (b == a) for b in second for a in first])
    assert rows[1]["p_better"] == pytest.approx(better)
    # More success is.
    names = ("a", "b", "c", "other")
    rows = rows_of(here("compare", *names, "--json", cwd=place))
    first, *others = (results.last_tenth(results.read(place / name))["success_rate"] for name in names)
    wanted = [np.mean([(b > a) + 0.5 * (b == a) for b in other for a in first]) for other in others]
    assert [row["p_better"] for row in rows[1:]] == pytest.approx(wanted)
    assert any(chance != 0.5 for chance in wanted)


def test_seeds_are_paired_where_they_saw_the_same_goals_and_not_otherwise(place):
    rows = rows_of(here("compare", "a", "b", "other", "--json", cwd=place))
    assert [row["paired"] for row in rows] == [None, True, False]
    paired, apart = rows[1], results.last_tenth(results.read(place / "other"))["success_rate"]
    reference = results.last_tenth(results.read(place / "a"))["success_rate"]
    assert paired["difference"] is not None
    assert rows[2]["difference"] == pytest.approx(apart.mean() - reference.mean())


def test_runs_patterns_and_sweeps_table_csv_and_figure(place):
    done = here("compare", "a", "[bc]", "sweep", "--png", "x.png", "--csv", "x.csv", cwd=place)
    assert done.returncode == 0, done.stderr
    names = ["a", "b", "c", "sweep: gamma=0.8", "sweep: gamma=0.9"]
    assert [line.split("  ")[0] for line in done.stdout.splitlines()[2:-1]] == names
    assert "written to x.png, x.csv" in done.stdout
    with (place / "x.csv").open() as file:
        assert [row["run"] for row in csv.DictReader(file)] == names
    with Image.open(place / "x.png") as image:
        assert image.width > 1200
    alone = rows_of(here("compare", "sweep", "--json", cwd=place))
    assert [row["run"] for row in alone] == ["gamma=0.8", "gamma=0.9"]
    assert alone[1]["paired"] is True


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ([], "runs: must be the folders"),
        (["a"], "runs: must be at least 2 runs"),
        (["a", "absent"], "runs: absent holds neither a run nor a sweep"),
        (["z*", "a"], "nothing that z* finds"),
        (["a", "b", "--metric", "sucess_rate"], "metric: must be one of success_rate"),
        (["a", "b", "--png", "none/x.png"], "out: cannot write none/x.png"),
    ],
)
def test_wrong_input_is_one_line(place, args, words):
    done = here("compare", *args, cwd=place)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert words in done.stderr


def test_no_two_runs_have_one_colour_whatever_they_are_called(place):
    looks = figures.looks_by_order(60)
    assert len({look.colour for look in looks}) == 60
    assert len({(look.line, look.marker) for look in looks[:8]}) == 8
    found = [results.read(place / "a", name) for name in ("cacla", "icac", "x", "y")]
    axes = compare_figure.draw(compare.compare(found)).axes[0]
    assert len({line.get_color() for line in axes.lines}) == 4


def test_many_runs_are_drawn_as_the_reference_and_the_best(place):
    found = [results.read(place / "abc"[number % 3], f"run {number}") for number in range(20)]
    comparison = compare.compare(found)
    drawn = compare_figure.chosen(comparison)
    assert len(drawn) == compare_figure.MOST_DRAWN
    assert drawn[0].result.name == "run 0"
    names = {row.result.name for row in drawn}
    left = [row.iqm.value for row in comparison.rows if row.result.name not in names]
    assert max(left) <= min(row.iqm.value for row in drawn[1:])
    assert min(left) < max(row.iqm.value for row in drawn[1:])


def test_different_tasks_are_said(place):
    assert here("train", *TINY, "--horizon", 20, "--out", "short", cwd=place).returncode == 0
    done = here("compare", "a", "short", cwd=place)
    assert "different tasks" in done.stderr
    assert "not paired" in done.stdout


def test_names_are_as_short_as_they_can_be(tmp_path):
    found = subjects.names([tmp_path / "x" / "run", tmp_path / "y" / "run", tmp_path / "z"])
    assert found == ["x/run", "y/run", "z"]


def test_profile_and_improvement_are_those_of_rliable():
    rng = np.random.default_rng(0)
    one, two = rng.normal(0.5, 0.2, 30), rng.normal(0.6, 0.2, 25)
    limits = np.linspace(0, 1, 11)
    wanted, _ = library.create_performance_profile({"one": one[:, None]}, limits, reps=10)
    np.testing.assert_allclose(statistics.performance_profile(one, limits).value, wanted["one"])
    assert statistics.performance_profile(one, limits, larger=False).value[-1] == np.mean(one < 1)
    assert statistics.probability_of_improvement(one, two).value == pytest.approx(
        metrics.probability_of_improvement(one[:, None], two[:, None])
    )
    difference = statistics.difference(one, two)
    error = np.sqrt(one.var() / 30 + two.var() / 25)
    np.testing.assert_allclose(difference.value, one.mean() - two.mean())
    np.testing.assert_allclose(difference.high - difference.low, 2 * 1.96 * error, rtol=0.1)


def test_every_finished_run_has_a_page_that_needs_nothing_else(place):
    text = (place / "a" / "report.html").read_text()
    summary = json.loads((place / "a" / "summary.json").read_text())
    rate = summary["last_tenth"]["success_rate"]
    assert f"In the last tenth of 40 episodes CACLA reached {rate:.1%} of its goals on planar2" in text
    assert text.count("<svg") >= 4
    assert re.search(r"20\d\d-\d\d-\d\d \d\d:\d\d UTC", text)
    assert "weight_scale" in text
    assert re.findall(r'(?:src|href)="(?!data:|#)', text) == []


def test_plot_writes_pictures_and_says_which(place, capsys):
    done = here("plot", place / "a", "--no-film")
    assert done.returncode == 0, done.stderr
    written = done.stdout.splitlines()
    assert written[0].endswith("report.html")
    assert len(written) >= 5
    for path in written[1:]:
        with Image.open(path) as image:
            assert image.width > 800
    refused = here("plot", place / "sweep")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "holds a sweep" in refused.stderr


def test_the_arm_is_on_the_page_where_it_can_be_drawn(place, monkeypatch):
    assert here("plot", place / "b").returncode == 0
    assert "data:image/png;base64," in (place / "b" / "report.html").read_text()

    def nothing(*_):
        raise run_page.ConfigError("nothing to draw with")

    monkeypatch.setattr("icac_jax.policies.film.strip", nothing)
    done = here("plot", place / "b")
    assert done.returncode == 0
    assert "no picture of the arm" in done.stderr
    assert "data:image/png" not in (place / "b" / "report.html").read_text()


def test_a_longer_run_gets_a_new_page_and_a_lost_one_comes_back(place):
    assert here("train", *TINY, "--out", "long", cwd=place).returncode == 0
    page = place / "long" / "report.html"
    page.unlink()
    assert main.main(["resume", str(place / "long")]) == 0
    assert "of 40 episodes" in page.read_text()
    assert main.main(["resume", str(place / "long"), "--episodes", "50"]) == 0
    assert "of 50 episodes" in page.read_text()
