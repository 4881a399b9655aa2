"""What people and files call things is shown as it is, and values of options so that they can be told apart."""

import io
import json
import tomllib
from html.parser import HTMLParser

import markdown
import matplotlib
import pytest

from icac_jax.reports import figures, html, tables
from icac_jax.runs import files
from icac_jax.sweeps import axes, best, report, summary, sweep_file
from icac_jax.sweeps import figures as sweep_figures
from icac_jax.sweeps import tables as cells_tables
from tests.sweeps_by_hand import grid

NASTY = ["m$x^{$/a.toml", r"\frac{", "$$", "a_b_{c", "_first", "<script>alert(1)</script>", "x|y", "`*_[a](b)", "&amp;"]


def result_of(made):
    facts = {"claim": made.chosen.claim, "metric": made.chosen.metric, "cells": made.rows, "seconds": 1.0}
    facts |= {"seconds_training": 1.0, "lanes": 2, "programs": 1, "lane_steps": 9, "failed_lanes": 0}
    return facts | {"lanes_trained": 4, "verdict": None}


def renamed(made, names):
    """A grid whose cells, values and claim are called something else."""
    rows = [row | {"name": f"arm={name}"} for row, name in zip(made.rows, names, strict=True)]
    places = made.axes[0]._replace(labels=tuple(names), title="arm $x^{$")
    return made._replace(rows=rows, axes=[places], chosen=made.chosen._replace(claim=f"Is {names[0]} # $ better?"))


@pytest.fixture(scope="module")
def nasty():
    text = f"[grid]\noptimizer = ['sgd', 'adam', 'rmsprop']\nsigma = {[0.1, 0.2, 0.3]}\n"
    made = grid(text, lambda varied: 12.0, seeds=2, episodes=20)
    return renamed(made._replace(rows=made.rows[:9], results=made.results[:9]), NASTY)


def test_no_text_of_a_person_is_a_formula(nasty, tmp_path):
    with matplotlib.rc_context(figures.STYLE):
        words = nasty._replace(axes=[nasty.axes[0]._replace(values=None, places=sorted(range(9)))])
    for drawing in sweep_figures.all_of(words):
        figures.save(drawing.figure, tmp_path / drawing.name)
        texts = [text.get_text() for text in drawing.figure.findobj(matplotlib.text.Text)]
        if drawing.name == "cells":
            assert {f"arm={name}" for name in NASTY} <= set(texts)
        assert not any(text.get_parse_math() for text in drawing.figure.findobj(matplotlib.text.Text))


def test_labels_that_begin_with_an_underscore_are_in_the_legend():
    assert figures.title_of("_first") == " _first"
    assert figures.title_of("icac") == "ICAC"


class Seen(HTMLParser):
    """The tags of a page and the text between them."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text = set(), ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)

    def handle_data(self, data):
        self.text += data


def test_pages_show_texts_as_they_are(nasty, tmp_path):
    files.append_line(tmp_path / "history.jsonl", json.dumps({"event": "started", "platform": {"python": "<script>"}}))
    page = Seen(report.page(nasty, result_of(nasty), None, tmp_path, []))
    assert "script" not in page.tags
    for name in NASTY:
        assert f"arm={name}" in page.text
    assert nasty.chosen.claim in page.text


def test_markdown_shows_texts_as_they_are(nasty, tmp_path):
    made = nasty._replace(chosen=nasty.chosen._replace(claim="two\nlines and *stars* # `x` <b>"))
    text = report.markdown(made, result_of(made), None, tmp_path / "a`b``c")
    shown = Seen(markdown.markdown(text, extensions=["tables"]))
    assert {"script", "em", "a", "b"}.isdisjoint(shown.tags)
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert len({row.count("|") for row in rows}) == 1
    for name in NASTY:
        assert f"arm={name}" in shown.text
    assert "two lines and *stars* # `x` <b>" in shown.text
    assert "a`b``c/sweep.toml" in shown.text


def test_ordinary_words_are_not_escaped():
    table = tables.Table("steps [95 %]", ("cell", "P(better)"), [("actor_rate=0.1", "12.3 [10.1, 14.0]")])
    assert "\\" not in tables.as_markdown(table)


CLOSE = [0.999, 0.99995, 0.99999, 0.1 + 0.2, 1e-7, 0.5]


def test_a_value_reads_back_from_its_text():
    for value in [*CLOSE, 1.0, 20.0, 1e22, -3.5, 123456.75]:
        assert float(axes.short(value)) == value
        assert axes.short(value) in (repr(value), repr(value).removesuffix(".0"))
    assert [axes.short(value) for value in (True, 3, (0.0, 90.5), 1.0)] == ["true", "3", "(0,90.5)", "1"]
    assert axes.short("a\nb\x1b") == "a\\nb\\x1b"


def test_close_values_are_told_apart_everywhere(tmp_path):
    made = grid(f"[grid]\ngamma = {CLOSE[:3]}\n", lambda varied: 12.0, seeds=2, episodes=20)
    words = ["0.999", "0.99995", "0.99999"]
    assert [row["name"] for row in made.rows] == [f"gamma={word}" for word in words]
    drawn = {drawing.name: drawing.figure for drawing in sweep_figures.all_of(made)}
    for panel in drawn["values"].axes:
        assert [label.get_text() for label in panel.get_xticklabels()] == ["0.999", "0.99995", "0.99999"]
    result = result_of(made)
    for text in (summary.as_text(result), report.markdown(made, result, None, tmp_path)):
        assert all(f"gamma={word} " in text for word in words)


def finished(place, made):
    place.mkdir()
    (place / "sweep.toml").write_text(made.chosen.text)
    (place / "summary.json").write_text(json.dumps(result_of(made)))
    return place


SEARCH = "[search]\nmetric = '{}'\ngamma = {{low = 0.5, high = 0.999999}}\n"


def searched(metric):
    """Four seeds: by the mean of any metric the second cell is best, by steps the third, by what is shown the first."""
    cells = [{"gamma": 0.999}, {"gamma": 0.99995}, {"gamma": 0.99999}]
    made = grid(SEARCH.format(metric), lambda varied: 12.0, seeds=4, episodes=20, cells=cells)
    rows = [
        made.rows[0] | {metric: 0.5, f"{metric}_iqm": 0.9, "steps": 30.0, "steps_iqm": 30.0},
        made.rows[1] | {metric: 0.6, f"{metric}_iqm": 0.8, "steps": 20.0, "steps_iqm": 20.0},
        made.rows[2] | {metric: 0.4, f"{metric}_iqm": 0.7, "steps": 10.0, "steps_iqm": 10.0},
    ]
    return made._replace(rows=rows)


@pytest.mark.parametrize("metric", ["success_rate", "extrinsic_reward"])
def test_the_metric_of_the_study_is_that_of_every_report(metric, tmp_path):
    made = searched(metric)
    title = {"success_rate": "success", "extrinsic_reward": "reward per episode"}[metric]
    order = ["gamma=0.999", "gamma=0.99995", "gamma=0.99999"]
    said = summary.as_text(result_of(made))
    assert [line.split()[0] for line in said.splitlines()[2:5]] == order
    assert f"best by {title}: gamma=0.999, " in said
    assert f"{title}, IQM [95 %]" in said.splitlines()[1]
    table = report.cells_table(made)
    assert [row[1] for row in table.rows] == order
    assert f"interquartile mean over seeds [95 % interval], the best first by the interquartile mean of {title}" in (
        table.title
    )
    place = finished(tmp_path / "sweep", made)
    assert f"best by {metric}: gamma=0.999, " in best.best(place)
    assert "best by steps: gamma=0.99999, " in best.best(place, "steps")
    for drawing in sweep_figures.all_of(made):
        drawing.figure.canvas.draw()
        if drawing.name == "cells":
            assert [label.get_text() for label in drawing.figure.axes[0].get_yticklabels()] == order
            assert title in [panel.get_xlabel() for panel in drawing.figure.axes]


def test_equals_by_what_is_shown_are_ranked_by_the_mean():
    rows = [{"cell": n, "steps": mean, "steps_iqm": 5.0} for n, mean in enumerate((7.0, 6.0))]
    rows.append({"cell": 2, "steps": None, "steps_iqm": None})
    assert [row["cell"] for row in cells_tables.ranked(rows)] == [1, 0, 2]


def test_the_best_cell_is_valid_toml_whatever_the_claim(tmp_path):
    made = searched("success_rate")
    claim = "line one\ngamma = 0.1\n[x]\x1b"
    tables_of = made.chosen.tables | {"claim": claim}
    made = made._replace(chosen=made.chosen._replace(claim=claim, tables=tables_of))
    options = tomllib.loads(best.best(finished(tmp_path / "sweep", made)))
    assert options["gamma"] == 0.999
    assert "x" not in options


def test_a_claim_is_optional():
    made = sweep_file.parse("[grid]\ngamma = [0.5, 0.9]\nsigma = [0.1, 0.2]\n")
    assert made.claim == "Sweep over gamma, sigma"
    assert sweep_file.parse(made.text) == made
    assert "claim" not in made.text
    assert sweep_file.parse("[base]\nseeds = 2").claim == "One cell"


def test_figures_in_pages_need_no_font_for_every_sign():
    with matplotlib.rc_context(figures.STYLE):
        figure = figures.blank()
        figure.add_subplot().set_title("腕 $x^{$ --> <script>")
    text = html.picture(figures.Drawing("a", "<b>", figure), "sweep")
    assert "<script>" not in text
    assert "<b>" not in text
    assert io.StringIO(text).read()
