"""Figures and pages of made-up sweeps: chosen by the shape of the grid, their data read back from the axes."""

import itertools
import json
import re

import numpy as np
import pytest

from icac_jax.reports import results
from icac_jax.sweeps import effects, figures, report, summary, verdicts
from icac_jax.sweeps.grid import groups_of
from tests.sweeps_by_hand import grid

GAMMA = '[grid]\nalgo = ["cacla_var", "icac"]\ngamma = [0.8, 0.99, 0.9]\n'
WITH_VERDICT = 'expect = "no_difference"\n' + GAMMA + "[reference]\ngamma = 0.9\n"
RATES = "[zip]\nactor_rate = [0.1, 0.01]\ncritic_rate = [0.1, 0.01]\n[grid]\nbeta = [0.001, 0.01, 0.1]\n"
FOUR = "[grid]\nsigma = [0.1, 1]\nmu = [20, 40]\nT = [5, 10]\nbootstrap_at_goal = [true, false]\n"
SEARCH = '[search]\nsigma = {low = 0.1, high = 2, log = true}\nalgo = {choices = ["icac", "cacla"]}\n'
RANDOM = "[random]\ndraws = 9\nsigma = {low = 0.1, high = 2, log = true}\ngamma = {low = 0.1, high = 0.9}\n"


def flat(varied):
    return 12.0


def searched():
    rng = np.random.default_rng(2)
    cells = [{"sigma": float(rng.uniform(0.1, 2)), "algo": ("icac", "cacla")[place % 2]} for place in range(12)]
    return grid(SEARCH, lambda varied: 10 + 5 * varied["sigma"], cells=cells)


def drawn(made):
    return {drawing.name: drawing.figure for drawing in figures.all_of(made)}


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (GAMMA, ["values", "cells", "curves"]),
        ("[grid]\nhidden_units = [6, 12]\n", ["values", "cells", "curves"]),
        (RATES, ["heat_map", "cells", "curves"]),
        (
            '[grid]\nalgo = ["cacla", "icac"]\nmu = [20, 40]\nT = [5, 10]\n',
            ["heat_map", "importance", "cells", "curves"],
        ),
        (FOUR, ["slices", "importance", "cells"]),
        ('[grid]\naction_clipping = ["executed", "both"]\n', ["cells", "curves"]),
        (RANDOM, ["slices", "importance", "cells"]),
        ("", ["curves"]),
    ],
    ids=["numeric and words", "numeric", "two numeric", "two numeric and words", "four", "words", "random", "one cell"],
)
def test_chosen_by_the_shape_of_the_grid(text, names):
    made = grid(text, flat, seeds=3, episodes=12)
    assert list(drawn(made)) == names
    for drawing in figures.all_of(made):
        drawing.figure.canvas.draw()


def test_a_search_shows_its_way():
    made = searched()
    found = drawn(made)
    assert list(found) == ["search", "slices", "importance", "cells"]
    dots, best, *_ = found["search"].axes[0].lines
    steps = [row["steps"] for row in made.rows]
    np.testing.assert_allclose(dots.get_ydata(), steps)
    np.testing.assert_allclose(best.get_ydata(), np.minimum.accumulate(steps))


def test_values_are_those_of_the_table():
    made = grid(WITH_VERDICT, lambda varied: 30 - 20 * varied["gamma"])
    success, steps, nodes = drawn(made)["values"].axes
    for place, name in enumerate(("CACLA+Var", "ICAC")):
        (bars,) = [one for one in steps.containers if one.get_label() == name]
        order = [3 * place, 3 * place + 2, 3 * place + 1]  # by value
        np.testing.assert_allclose(bars[0].get_xdata(), [0.8, 0.9, 0.99])
        np.testing.assert_allclose(bars[0].get_ydata(), [made.rows[cell]["steps_iqm"] for cell in order])
        ends = np.array([segment[:, 1] for segment in bars[2][0].get_segments()])
        wanted = [[made.rows[cell][f"steps_{end}"] for end in ("low", "high")] for cell in order]
        np.testing.assert_allclose(ends, wanted)
    assert success.get_ylim() == (0, 1.03)
    assert len(nodes.containers) == 1  # CACLA has no map
    for panel in (success, steps, nodes):
        assert [line.get_xdata()[0] for line in panel.lines if line.get_label() == "reference"] == [0.9]


def test_heat_map_numbers_and_the_reference():
    text = RATES + "[reference]\nactor_rate = 0.01\ncritic_rate = 0.01\nbeta = 0.1\n"
    made = grid(text, lambda varied: 10 + 100 * varied["actor_rate"] + 10 * varied["beta"])
    _, steps = drawn(made)["heat_map"].axes
    shown = {tuple(round(at) for at in text.get_position()): text.get_text() for text in steps.texts}
    for row in made.rows:
        at = [0.001, 0.01, 0.1].index(row["varied"]["beta"]), [0.01, 0.1].index(row["varied"]["actor_rate"])
        assert shown[at] == f"{row['steps_iqm']:.1f}"
    assert (steps.get_xlabel(), steps.get_ylabel()) == ("beta", "actor_rate = critic_rate")
    (frame,) = steps.patches
    assert frame.get_xy() == (1.5, -0.5)


def test_slices_average_over_the_other_options():
    made = grid(FOUR, lambda varied: 10 + 10 * varied["sigma"])
    panels = [panel for panel in drawn(made)["slices"].axes if panel.get_visible()]
    (sigma,) = [panel for panel in panels if panel.get_xlabel() == "sigma" and panel.get_ylabel().startswith("steps")]
    line = sigma.containers[0][0]
    for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True):
        assert y == pytest.approx(np.mean([row["steps"] for row in made.rows if row["varied"]["sigma"] == x]))


def test_importance_of_an_additive_landscape():
    made = grid(FOUR, flat)
    rows = [
        row | {"steps": 10 + 3 * row["varied"]["mu"] / 20 + 4 * row["varied"]["bootstrap_at_goal"]} for row in made.rows
    ]
    shares = {title: share for title, share, _ in effects.explained(made._replace(rows=rows), "steps")}
    # Two levels each, 3 and 4 apart: shares as 9 to 16.
    assert shares == pytest.approx({"sigma": 0, "mu": 9 / 25, "T": 0, "bootstrap_at_goal": 16 / 25}, abs=1e-9)
    equal = [row | {"steps": 10.0} for row in made.rows]
    assert {share for _, share, _ in effects.explained(made._replace(rows=equal), "steps")} == {0.0}


def test_drawn_values_are_averaged_in_groups_of_equal_size():
    made = searched()
    (sigma,) = [axis for axis in made.axes if axis.title == "sigma"]
    groups = groups_of(sigma)
    assert [mine.sum() for _, mine in groups] == [3, 3, 3, 3]
    values = np.array([row["varied"]["sigma"] for row in made.rows])
    for (_, mine), (_, after) in itertools.pairwise(groups):
        assert values[mine].max() < values[after].min()


def test_learning_curves_have_a_column_an_algorithm():
    made = grid(GAMMA, flat)
    panels = [panel for panel in drawn(made)["curves"].axes if panel.get_visible()]
    assert [panel.get_title() for panel in panels] == ["CACLA+Var", "ICAC", "", ""]
    (line,) = [line for line in panels[3].lines if line.get_label() == "gamma 0.99"]
    values = results.by_seed(made.results[4], "steps")
    length = 6  # a tenth of the episodes
    np.testing.assert_allclose(line.get_ydata(), values.reshape(len(values), -1, length).mean(axis=(0, 2)), rtol=1e-6)


def test_cells_without_any_figure():
    """Learners that all failed have no nodes; a warning would fail the test."""
    made = grid(GAMMA, flat, seeds=2, episodes=3)
    empty = {name: None for name in made.rows[0] if name.endswith(("_iqm", "_low", "_high"))}
    lost = made.rows[1] | empty | {"steps": None, "success_rate": None, "live_nodes": None}
    lost |= {"by_seed": {name: [None, None] for name in lost["by_seed"]}}
    for drawing in figures.all_of(made._replace(rows=[made.rows[0], lost, *made.rows[2:]])):
        drawing.figure.canvas.draw()


def result_of(made, verdict):
    return {
        "claim": made.chosen.claim,
        "cells": made.rows,
        "seconds": 12.0,
        "seconds_training": 10.0,
        "lanes": 64,
        "programs": 2,
        "lane_steps": 100_000,
        "failed_lanes": 1,
        "lanes_trained": 48,
        "verdict": verdicts.as_json(verdict),
    }


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    place = tmp_path_factory.mktemp("report")
    made = grid(WITH_VERDICT, lambda varied: 12 + 10 * (varied["gamma"] == 0.99))
    verdict = verdicts.judge(made.rows, made.chosen.expect, made.chosen.reference)
    result = result_of(made, verdict)
    report.write(made, result, verdict, place)
    return place, made, result


def test_the_page_stands_alone_and_has_everything(written):
    place, made, _ = written
    text = (place / "report.html").read_text()
    assert not re.findall(r'(?:src|href)="(?!data:)[^"#]', text)
    assert "<script" not in text
    assert text.count("<svg") == 3
    assert '<span class="verdict no">not reproduced</span> (no difference was expected)' in text
    for row in made.rows:
        assert f'<td class="name">{row["name"]}</td>' in text
    assert f"icac sweep {place}/sweep.toml --out NEW" in text
    assert "within noise of it" in text or "Best by steps" in text
    assert "1 learners diverged" in text
    assert "gamma = [\n" in text.partition("Configuration")[2]


def test_figures_and_tables_are_files_too(written):
    place, *_ = written
    names = {path.name for path in (place / "figures").iterdir()}
    assert names == {f"{name}.{kind}" for name in ("values", "cells", "curves") for kind in ("png", "svg")}
    text = (place / "tables.md").read_text()
    assert "**Not reproduced** (no difference was expected)." in text
    assert sum(line.startswith("| ") and "gamma=" in line for line in text.splitlines()) == 6 + 8
    assert "Repeat with `icac sweep " in text


def test_the_printed_summary_is_short(written):
    _, made, result = written
    said = summary.as_text(json.loads(json.dumps(result))).splitlines()
    assert said[0] == "What is it that matters?"
    best = min(made.rows, key=lambda row: row["steps"])
    assert said[2].startswith(best["name"])
    assert any(line.startswith("verdict: NOT REPRODUCED (no difference expected against gamma 0.9)") for line in said)
    assert len(said) < 16
    many = result | {"cells": made.rows * 10, "verdict": None}
    assert "... and 45 more, all in cells.csv" in summary.as_text(many)
