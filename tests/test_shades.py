"""Pages by day and by night: what is drawn stands out from the page; no part of a table is out of reach."""

import re

import matplotlib
import pytest

from icac_jax.reports import figures, html, shades, tables

GREYS = ["#000000", "#222222", "#303438", "#444444", "#555555"]


@pytest.mark.parametrize("colour", [*GREYS, *(look.colour for look in figures.looks_by_order(20))])
def test_what_stands_out_by_day_stands_out_by_night(colour):
    assert shades.contrast(shades.dark(colour), shades.PAPER) >= 3.4


def test_paper_and_ink_change_places():
    assert shades.dark("#ffffff") == shades.PAPER
    assert shades.dark("#000000") == shades.INK
    assert shades.contrast("#000000", "#ffffff") == pytest.approx(21)


def drawing(image):
    with matplotlib.rc_context(figures.STYLE):
        figure = figures.blank()
        axes = figure.add_subplot()
        axes.plot([0, 1], color="#0072B2", label="a line")
        axes.legend()
        if image:
            axes.imshow([[0.0, 1.0]])
    return figures.Drawing("one", "One", figure)


def test_every_colour_of_a_figure_has_a_night():
    part = html.picture(drawing(False), "test")
    assert not re.search(r"(fill|stroke): #", part)
    page = html.document("Title", [part])
    used = set(re.findall(r"var\(--x([0-9a-f]{6}),", part))
    assert {"ffffff", "0072b2"} <= used
    night = page[page.index("prefers-color-scheme: dark") :].partition("</style>")[0]
    assert used == set(re.findall(r"--x([0-9a-f]{6}):", night))
    assert f"--xffffff: {shades.PAPER};" in night


def test_pixels_stay_on_a_white_card():
    part = html.picture(drawing(True), "test")
    assert 'class="drawing white"' in part
    assert "var(--x" not in part


def test_the_column_that_names_the_rows_stays_in_sight():
    rows = [("0", "sigma=[1]", "40.0 [30.0, 50.0]"), ("1", "sigma=[2]", "41.0 [30.0, 50.0]")]
    text = tables.as_html(tables.Table("of <all>", ("cell", "what", "steps"), rows))
    assert text.count('class="name"') == 3  # of the second column: the first one is numbers only
    assert '<td class="name">sigma=' in text
    assert '40.0 <span class="interval">[30.0, 50.0]</span>' in text
    assert "of &lt;all&gt;" in text
