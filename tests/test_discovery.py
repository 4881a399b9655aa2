"""Studies of discovery: who found the goal by which episode, what is compared with what, and what the report says."""

import json

import numpy as np
import pyarrow as pa
import pytest
import tomli_w

from icac_jax.reports import tables
from icac_jax.runs.records import SCHEMA
from icac_jax.sweeps import discovery, discovery_figures, dose_figure, sweep_file, where
from icac_jax.sweeps import tables as cells_tables
from icac_jax.sweeps.grid import Grid
from tests.conftest import here

STUDY = """
claim = "Who finds it?"
[base]
physics = "kinematic"
seeds = 40
episodes = 8
coverage_bins = 12
[grid]
task = ["door", "cup"]
[zip]
signal = ["none", "none", "constant", "icac", "counts"]
step_cost = [0.0, 0.6, 0.0, 0.0, 0.0]
curiosity = [1.0, 1.0, 0.35, 1.0, 3.0]
"""
SEEDS, EPISODES = 40, 8
# The episode in which every seed finds its goal, by task and cell; a tenth of the seeds never does.
FOUND_IN = {"door": (5, 4, 6, 2, 3), "cup": (5, 2, 6, 4, 3)}


def episodes(found_in):
    """Records of seeds that find their goal in that episode and have it from then on; every tenth never does."""
    seed, episode = (part.ravel() for part in np.meshgrid(np.arange(SEEDS), np.arange(EPISODES), indexing="ij"))
    reached = (episode + 1 >= found_in) & (seed % 10 != 0)
    columns = {field.name: np.zeros(len(seed)) for field in SCHEMA} | {
        "seed": seed,
        "episode": episode,
        "reached": reached,
        "steps": np.where(reached, 20, 80),
    }
    table = pa.table({field.name: pa.array(columns[field.name], field.type) for field in SCHEMA})
    return table.append_column("cells_visited", pa.array(episode + 1, pa.int32()))


@pytest.fixture(scope="module")
def grid():
    chosen = sweep_file.parse(STUDY)
    jobs = {"episodes_done": [EPISODES] * SEEDS, "failed": [False] * SEEDS}
    places = [found for task in FOUND_IN.values() for found in task]
    found = [
        cells_tables.result_of(cell, episodes(place), jobs) for cell, place in zip(chosen.cells(), places, strict=True)
    ]
    settings = [one.settings for one in found]
    return Grid(chosen, [{"varied": cell.varied} for cell in chosen.cells()], found, settings, [])


@pytest.fixture(scope="module")
def cells(grid):
    return discovery.cells(grid)


def test_signals_are_told_apart_in_words(cells):
    assert [cell.task for cell in cells] == ["door"] * 5 + ["cup"] * 5
    words = ["no bonus", "step cost 0.6", "constant bonus × 0.35", "ICAC (Eq. 10)", "visit counts × 3"]
    assert [cell.signal for cell in cells] == words * 2


def test_the_first_episode_that_reached_the_goal_counts(cells):
    wanted = np.full(SEEDS, 2.0)
    wanted[::10] = np.inf
    np.testing.assert_array_equal(cells[3].first, wanted)
    assert cells[3].found.value == 0.9
    np.testing.assert_array_equal(cells[3].by_episode(EPISODES).mean(0), [0] + [0.9] * 7)
    np.testing.assert_array_equal(cells[3].late, np.isfinite(wanted))


def test_a_signal_is_judged_against_every_control_of_its_task(cells):
    """On the door ICAC is first, in the cup counts and a step cost are before it; as many find it, so nothing pays."""
    assert [cell.judged is None for cell in cells] == [True, True, True, False, False] * 2
    icac, counts = cells[3].judged, cells[4].judged
    assert (icac.earlier.value, icac.lead) == (0.95, 0.0)
    assert counts.earlier.value == 0.95  # it is no control of itself
    assert (cells[8].judged.control, cells[8].judged.earlier.value) == ("step cost 0.6", 0.05)
    assert {cell.judged.outcome for cell in cells if cell.judged} == {"does not pay"}


def test_goals_are_told_apart_by_their_distance(cells):
    table = discovery.by_distance(cells)
    assert table.header[2:] == ("1 to 9 steps", "10 to 18 steps", "19 to 27 steps", "28 steps or more")
    task, name, *numbers = table.rows[0]
    assert (task, name) == ("door", "seeds")
    assert sum(map(int, numbers)) == SEEDS
    assert int(numbers[2]) + int(numbers[3]) > 10  # most of them need the door
    far = cells[0].distance >= 19
    in_words = f"{np.mean(np.isfinite(cells[0].first[far & (cells[0].distance < 28)])):.0%}"
    assert table.rows[1][:2] + table.rows[1][4:5] == ("", "no bonus", in_words)


def test_coverage_is_the_share_of_what_can_be_reached(cells, grid):
    from icac_jax.envs import oracle

    settings = grid.results[0].settings
    whole = oracle.reachable(settings.arm, settings.params, 12).sum()
    np.testing.assert_allclose(cells[0].coverage, EPISODES / whole)


def test_what_the_report_says(cells):
    table = discovery.table(cells)
    assert [row[0] for row in table.rows] == ["door", "", "", "", "", "cup", "", "", "", ""]
    assert "| ICAC (Eq. 10) | 90% [80%, 98%] | 2 | " in tables.as_markdown(table)
    said = json.loads(json.dumps(discovery.as_json(cells)))
    assert said[3]["verdict"]["outcome"] == "does not pay"
    assert said[0]["verdict"] is None
    names = [drawing.name for drawing in discovery_figures.all_of(cells, EPISODES)]
    assert names == ["where_curiosity_pays", "found", "visited"]


def test_the_leads_are_drawn(cells):
    drawing = where.it_pays(where.squares(discovery.as_json(cells)))
    texts = [text.get_text() for text in drawing.figure.axes[0].texts]
    assert texts == ["+0\n90%"] * 4
    (lines, *_) = [panel.get_lines() for panel in discovery_figures.found_by_episode(cells, EPISODES).figure.axes]
    assert {line.get_label() for line in lines} == {cell.signal for cell in cells}
    np.testing.assert_allclose(lines[3].get_ydata()[-1], 0.9)


def test_signals_whose_best_numbers_differ_share_a_line_of_the_legend(cells):
    more = [
        cell._replace(signal="ICAC (Eq. 10) × 3") if cell.task == "cup" and cell.kind == "icac" else cell
        for cell in cells
    ]
    lines = discovery_figures.found_by_episode(more, EPISODES).figure.axes[0].get_lines()
    assert [line.get_label() for line in lines].count("ICAC (Eq. 10)") == 1
    assert not [line for line in lines if "× 3" in str(line.get_label()) and "ICAC" in str(line.get_label())]


def test_what_was_visited_is_drawn(cells):
    drawing = discovery_figures.visited_by_episode(cells, EPISODES)
    lines = {line.get_label(): line.get_ydata() for line in drawing.figure.axes[0].get_lines()}
    assert set(lines) == {cell.signal for cell in cells}
    np.testing.assert_allclose(lines["no bonus"][[0, -1]], cells[0].coverage[0] * np.array([1 / EPISODES, 1]))


def test_doses_are_drawn(cells):
    """A line per signal with three weights or more, through the shares in order of the weights; controls across."""
    door = [cell for cell in cells if cell.task == "door"]
    (counts,) = [cell for cell in door if cell.kind == "counts"]
    worse = np.where(np.arange(SEEDS) < SEEDS // 2, np.inf, counts.first)
    more = [
        counts._replace(numbers=counts.numbers | {"curiosity": weight}, first=first)
        for weight, first in ((30.0, worse), (0.3, np.full(SEEDS, np.inf)))
    ]
    assert dose_figure.by_number(door, "curiosity") is None
    panel = dose_figure.by_number([*door, *more], "curiosity").figure.axes[0]
    lines = {line.get_label(): line for line in panel.get_lines()}
    (curve,) = [line for line in panel.get_lines() if len(line.get_xdata()) == 3 and line.get_linestyle() == "-"]
    np.testing.assert_allclose(curve.get_xdata(orig=False), [0.3, 3, 30])
    assert [tick.get_text() for tick in panel.get_xticklabels()] == ["0.3", "3", "30"]
    np.testing.assert_allclose(curve.get_ydata(orig=False), [0, counts.found.value, np.mean(np.isfinite(worse))])
    assert {"no bonus", "step cost"} <= set(lines)
    assert dose_figure.by_number([*door, *more], "e_max") is None


def test_several_studies_are_one_figure(cells, tmp_path, capsys):
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "discovery.json").write_text(json.dumps(discovery.as_json(cells)))
    other = [cell._replace(signal=f"{cell.signal} × 3") for cell in cells]
    (tmp_path / "two.json").write_text(json.dumps(discovery.as_json(other)))
    squares = where.squares(discovery.as_json(cells)) + where.squares(discovery.as_json(other), "servo")
    panel = where.it_pays(squares).figure.axes[0]
    assert [label.get_text() for label in panel.get_yticklabels()] == ["door", "cup", "door, servo", "cup, servo"]
    assert all("×" not in label.get_text() for label in panel.get_xticklabels())  # the numbers differ
    figure = tmp_path / "where.png"
    assert where.main([str(tmp_path / "one"), f"servo={tmp_path / 'two.json'}", "--out", str(figure)]) == 0
    assert figure.stat().st_size > 1000
    (tmp_path / "other.json").write_text('[{"cell": 1}]')
    assert where.main([str(tmp_path / "other.json"), "--out", str(figure)]) == 2
    assert "other.json: holds no study of discovery" in capsys.readouterr().err
    assert where.main([str(tmp_path), "--out", str(figure)]) == 2
    assert "holds no study of discovery (discovery.json) that is finished" in capsys.readouterr().err


def test_a_sweep_of_such_a_task_reports_it(tmp_path):
    study = {
        "base": {"task": "door", "physics": "kinematic", "seeds": 2, "episodes": 3, "coverage_bins": 12},
        "grid": {"curiosity": [1.0, 2.0]},
    }
    (tmp_path / "study.toml").write_text(tomli_w.dumps(study))
    done = here("sweep", "study.toml", "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "out" / "discovery.json").read_text())
    assert [cell["signal"] for cell in found] == ["ICAC (Eq. 10)", "ICAC (Eq. 10) × 2"]
    assert found[0]["coverage"]["value"] > 0
    assert found[0]["verdict"] is None  # there is no control
    assert "P(earlier)" in (tmp_path / "out" / "tables.md").read_text()
    assert "Who found the goal" in (tmp_path / "out" / "report.html").read_text()
    assert (tmp_path / "out" / "figures" / "found.png").exists()
