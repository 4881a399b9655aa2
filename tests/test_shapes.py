"""Shapes of JSON files: whatever a reader lets through can be shown, compared and judged, whoever altered the file."""

import copy
import json
import math
from pathlib import Path

import pytest

from icac_jax import shapes
from icac_jax.cli import listing
from icac_jax.errors import DamagedError
from icac_jax.policies import evaluate, saved
from icac_jax.reports import results
from icac_jax.runs import folder, jobs, stored_summary, summary
from icac_jax.sweeps import best, stages, sweep, sweep_file
from icac_jax.sweeps import summary as sweep_summary
from tests.damage import SCALARS

ARCHIVED = Path(__file__).parent / "archive" / "half-planar2-icac"
STUDY = """
claim = "c"
expect = "no_gain"
base = {algo = "icac", physics = "kinematic", seeds = 5, episodes = 10, map_capacity = 16}
grid = {gamma = [0.8, 0.9]}
reference = {gamma = 0.8}
"""


def altered(facts, inside=()):
    """Every copy of a JSON value with one part of it gone, or something else."""
    parts = facts.items() if isinstance(facts, dict) else enumerate(facts) if isinstance(facts, list) else ()
    for key, part in parts:
        for other in (*SCALARS, -(10**400), math.inf, 1.5, 2**63):
            changed = copy.copy(facts)
            changed[key] = other
            yield (*inside, key, other), changed
        if isinstance(facts, dict):
            yield (*inside, key, "gone"), {name: one for name, one in facts.items() if name != key}
        for where, changed_part in altered(part, (*inside, key)):
            changed = copy.copy(facts)
            changed[key] = changed_part
            yield where, changed


def check(path, whole, use):
    """Reads each altered file; returns how many of them were refused, each with one line."""
    refused = tried = 0
    for where, facts in altered(whole):
        path.write_text(json.dumps(facts))
        tried += 1
        try:
            use()
        except DamagedError as error:
            assert "\n" not in str(error), where
            refused += 1
        except Exception as error:
            raise AssertionError(f"{where[:-1]} as {str(where[-1])[:40]}") from error
    return refused, tried


@pytest.fixture
def run(tmp_path):
    """What is needed of a run that has finished, with the summary as this version writes it."""
    for name in ("config.toml", "episodes.parquet"):
        (tmp_path / name).write_bytes((ARCHIVED / name).read_bytes())
    settings = folder.load(tmp_path)
    table = results.read(tmp_path).table
    facts = summary.summarise(settings, table, {1: 7}, 100, 1.5, 6.5)
    (tmp_path / "summary.json").write_text(json.dumps(facts))
    (tmp_path / "status.json").write_text('{"state": "finished"}')
    return tmp_path


def test_a_run_that_is_read_can_be_shown(run):
    path, settings = run / "summary.json", folder.load(run)
    whole = json.loads(path.read_text())
    assert stored_summary.read(run, settings) == whole

    def use():
        assert listing.as_text([listing.describe(run)])
        found = stored_summary.read(run, settings)
        assert summary.as_text(found).startswith("icac on planar2 (kinematic")
        assert results.last_tenth(results.read(run))["steps"].shape == (3,)
        assert saved._best(run, settings) in range(3)

    refused, tried = check(path, whole, use)
    assert (refused > tried / 2, tried > 500) == (True, True)


def test_summaries_of_earlier_versions_are_read():
    settings = folder.load(ARCHIVED)
    found = stored_summary.read(ARCHIVED, settings)
    assert found["live_nodes"] == 5
    assert summary.as_text(found).splitlines()[0].startswith("icac on planar2")


def test_without_a_summary_there_is_none(tmp_path):
    assert stored_summary.read(tmp_path) is None
    (tmp_path / "summary.json").write_text("{")
    with pytest.raises(DamagedError, match=r"summary\.json: not a readable summary of a run .*resume writes it anew"):
        stored_summary.read(tmp_path)


def test_records_of_another_run_are_refused(run):
    text = (run / "config.toml").read_text()
    (run / "config.toml").write_text(text.replace("seeds = 3", "seeds = 2"))
    (run / "summary.json").unlink()
    with pytest.raises(DamagedError, match=r"episodes\.parquet: not the record of this run \(a seed of 2\)"):
        results.read(run)


def test_a_sweep_that_is_read_can_be_shown(tmp_path):
    place = tmp_path / "sweep"
    sweep.sweep(sweep_file.parse(STUDY), place)
    path = place / "summary.json"
    whole = json.loads(path.read_text())
    assert whole["verdict"]["comparisons"]
    refused, tried = check(path, whole, lambda: [sweep_summary.as_text(stages.trained(place))])
    assert (refused > tried / 2, tried > 500) == (True, True)
    path.write_text(json.dumps(whole))
    assert best.best(place)


def test_an_evaluation_that_is_read_can_be_shown(tmp_path):
    figure = {"value": 0.5, "low": None, "high": 1}
    metrics = ("success_rate", "steps", "steps_over_oracle", "final_distance")
    whole = {"arm": "planar2", "algo": "icac", "pairs": 3, "pair_seed": 0, "horizon": 50, "episodes_trained": [3, 4]}
    whole |= {
        "policy": "newest",
        "oracle_steps": 6.5,
        **dict.fromkeys(metrics, figure),
        "by_seed": {name: [0.5, None] for name in metrics},
    }
    path = tmp_path / "evaluation.json"
    path.write_text(json.dumps(whole))
    assert evaluate.read(tmp_path) == whole

    def use():
        found = evaluate.read(tmp_path)
        if found is None:
            raise DamagedError("none")
        assert evaluate.as_text(found)
        assert sum(found["episodes_trained"]) >= 0

    refused, tried = check(path, whole, use)
    assert (refused > tried / 2, tried > 500) == (True, True)


def test_finished_jobs_are_read_whole_or_not_at_all(tmp_path):
    whole = {"episodes_done": [3, 4], "failed": [False, True], "steps": [5, 6], "seconds": 1.5, "lanes": 2}
    path = tmp_path / "done.json"
    path.write_text(json.dumps(whole))
    assert jobs.read_done(tmp_path) == whole
    for _, facts in altered(whole):
        path.write_text(json.dumps(facts))
        found = jobs.read_done(tmp_path)
        if found:
            assert sum(found["episodes_done"]) + sum(found["failed"]) + sum(found["steps"]) + found["seconds"] >= 0


def test_shapes_name_what_is_wrong():
    shape = shapes.record({"a": shapes.whole, "b": shapes.several(shapes.number, most=2)}, later={"c": shapes.text})
    shape({"a": 3, "b": [1.5, 2], "d": None}, "it")
    wrong = {
        "it is []": [],
        "a is missing": {"b": []},
        "a is True": {"a": True, "b": []},
        "a is -1": {"a": -1, "b": []},
        "b is nan": {"a": 1, "b": [math.nan]},
        "b is [1, 2, 3]": {"a": 1, "b": [1, 2, 3]},
        "c is None": {"a": 1, "b": [], "c": None},
        "a is '\\x1b'": {"a": "\x1b"},
    }
    for line, value in wrong.items():
        with pytest.raises(ValueError) as caught:  # noqa: PT011
            shape(value, "it")
        assert str(caught.value) == line
    assert not shapes.fits(shapes.one_of(("x",)), ["x"])
    assert shapes.fits(shapes.number, 10**100)
    assert not shapes.fits(shapes.number, 10**400)
    assert not shapes.fits(shapes.amount, -0.5)
