"""Successive halving: which cells go on, what is left of the others, kills between and within rungs, wrong tables."""

import jax
import numpy as np
import pyarrow.parquet as pq
import pytest
import tomli_w

from icac_jax.cli import main
from icac_jax.fields import ConfigError
from icac_jax.runs import checkpoints, train
from icac_jax.settings.options import resolve
from icac_jax.sweeps import sweep, sweep_file
from icac_jax.sweeps.best import summary_of
from icac_jax.sweeps.halving import Halving, Promoting
from tests.sweeps_by_hand import trained
from tests.test_sweep import Compiles, Killed, killed_after, parsed, ran, written

RATES = [0.001, 0.01, 0.03, 0.1, 0.2, 0.3]
STUDY = {
    "claim": "c",
    "base": {"algo": "cacla", "physics": "kinematic", "seeds": 2, "episodes": 40},
    "grid": {"actor_rate": RATES},
    "halving": {"min_episodes": 10, "factor": 2},
}


@pytest.mark.parametrize(
    ("halving", "episodes", "cells", "rungs", "numbers"),
    [
        (
            Halving(1, 3, "steps"),
            81,
            81,
            [1, 3, 9, 27, 81],
            [81, 27, 9, 3, 1],
        ),  # the table of the Hyperband paper, s = 4
        (Halving(100, 3, "steps"), 1000, 20, [111, 333, 1000], [20, 6, 2]),
        (Halving(10, 2, "steps"), 40, 6, [10, 20, 40], [6, 3, 1]),
        (Halving(5, 4, "steps"), 100, 5, [6, 25, 100], [5, 1, 1]),
    ],
)
def test_rungs_and_how_many_train_in_each(halving, episodes, cells, rungs, numbers):
    assert halving.rungs(episodes) == rungs
    assert halving.numbers(cells, episodes) == numbers


def test_the_better_cells_go_on():
    """On made-up episodes, without training: those nearest to the best rate are left, in the order of the study."""
    promoting = Promoting(parsed(STUDY))
    assert promoting.total == 2 * (6 * 10 + 3 * 20 + 40)
    rng, seen = np.random.default_rng(0), []
    for cells in promoting.batches():
        seen.append([(cell.varied["actor_rate"], cell.settings.run.episodes) for cell in cells])
        promoting.tell([trained(cell, 5 + 150 * abs(cell.varied["actor_rate"] - 0.1), rng)[1] for cell in cells])
    assert [{episodes for _, episodes in rung} for rung in seen] == [{10}, {20}, {40}]
    assert [len(rung) for rung in seen] == [6, 3, 1]
    assert seen[-1][0][0] == 0.1


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    place = tmp_path_factory.mktemp("halving") / "whole"
    with Compiles() as compiles:
        ran(place, STUDY, lanes=4)
    return place, summary_of(place), compiles.number


def test_what_is_left_of_each_cell(whole):
    place, result, compiles = whole
    assert compiles <= 2  # four lanes at a time, and two for the last cell
    rows = result["cells"]
    assert [row["cell"] for row in rows] == list(range(6))
    assert sorted(row["varied"]["episodes"] for row in rows) == [10, 10, 10, 20, 20, 40]
    assert all(row["episodes_done"] == 2 * row["varied"]["episodes"] for row in rows)
    assert all(len(row["at_rungs"]) == row["rung"] + 1 for row in rows)
    # Who went on was not behind those who did not.
    for rung in (0, 1):
        there = [(row["at_rungs"][rung], row["rung"] > rung) for row in rows if row["rung"] >= rung]
        assert max(value for value, on in there if on) <= min(value for value, on in there if not on)
    assert pq.read_table(place / "episodes.parquet").num_rows == 2 * (3 * 10 + 2 * 20 + 40)
    assert result["lane_steps"] > sum(row["lane_steps"] for row in rows)  # those of the earlier rungs too
    assert (place / "figures" / "halving.png").exists()
    page = (place / "report.html").read_text()
    assert "6 for 10, 3 for 20, 1 for 40; 67% of what all of them to the end would be" in page


def test_the_best_trained_longest_and_is_the_run_of_its_options(whole, tmp_path, capsys):
    place, result, _ = whole
    assert main.main(["best", str(place)]) == 0
    said = capsys.readouterr().out
    (best,) = (row for row in result["cells"] if row["rung"] == 2)
    assert f"best by steps: {best['name']}" in said
    assert "episodes = 40" in said
    # With two lanes on as many devices as the last rung had.
    train.train(resolve(**STUDY["base"], actor_rate=best["varied"]["actor_rate"]), tmp_path / "single")
    episodes = pq.read_table(place / "episodes.parquet", filters=[("cell", "=", best["cell"])])
    alone = pq.read_table(tmp_path / "single" / "episodes.parquet")
    assert jax.device_count() > 1
    assert episodes.drop_columns(["cell"]).select(alone.column_names).equals(alone)


@pytest.mark.parametrize("saves", [0, 3, 7, 9])
def test_killed_in_any_rung_and_resumed(saves, whole, tmp_path, monkeypatch):
    place = tmp_path / "killed"
    with monkeypatch.context() as patch:
        killed_after(saves, patch, checkpoints, "save")
        with pytest.raises(Killed):
            ran(place, STUDY, lanes=4, checkpoint_every=0)
    sweep.resume(place, 0)
    assert written(place) == written(whole[0])


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"halving": {}}, "[halving] min_episodes: must be given, the least episodes that a cell trains for"),
        ({"halving": {"min_episodes": 10, "fator": 2}}, "[halving] fator: no such key; did you mean factor?"),
        ({"halving": {"min_episodes": 0}}, "[halving] min_episodes: must be a whole number at least 1"),
        ({"halving": {"min_episodes": 10, "factor": 1}}, "[halving] factor: must be a whole number at least 2"),
        (
            {"halving": {"min_episodes": 10, "factor": 7}},
            "[halving] factor: must be at most the number of cells, 6, got 7",
        ),
        (
            {"halving": {"min_episodes": 15, "factor": 3}},
            "[halving] min_episodes: must be at most 13, the episodes 40 over the factor 3, got 15",
        ),
        ({"halving": {"min_episodes": 10, "metric": "speed"}}, "[halving] metric: must be one of success_rate, steps"),
        ({"grid": {"seeds": [1, 2, 3]}, "base": {"episodes": 40}}, "[halving]: must be without varied seeds"),
        ({"expect": "no_gain", "reference": {"actor_rate": 0.1}}, "[halving]: must be without expect"),
    ],
)
def test_wrong_tables_are_one_line(changed, words):
    with pytest.raises(ConfigError) as error:
        parsed(STUDY | changed)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_a_plan_names_every_rung_and_a_job_array_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text(tomli_w.dumps(STUDY))
    assert sweep_file.read(tmp_path / "study.toml").metric == "steps"
    assert main.main(["sweep", "study.toml", "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert [int(line.split()[2]) for line in said.splitlines() if line.startswith("cacla planar2")] == [6, 3, 1]
    assert main.main(["sweep", "study.toml", "--slurm", "2"]) == 2
    assert "slurm: must be left out for halving" in capsys.readouterr().err
