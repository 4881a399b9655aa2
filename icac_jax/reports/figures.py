"""How all figures look, and how they are written: style, colours, titles, files.

Colours are those of Okabe and Ito, which the colour-blind can tell apart; line style and marker differ too, so that
prints in grey can be read.
"""

import colorsys
import contextlib
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from icac_jax.reports import titles
from icac_jax.runs import files

FOLDER = "figures"  # of the figures' files in the folder of a report
_DOTS_PER_INCH = 200
_SIZE = (4.8, 3.2)


STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "axes.grid.axis": "y",
    "axes.labelsize": 10,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 10,
    "figure.facecolor": "white",
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "legend.columnspacing": 1.2,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "legend.handletextpad": 0.5,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "svg.fonttype": "path",
    # Names of arms, options and folders are anybody's: no dollar sign in them begins a formula.
    "text.parse_math": False,
    "text.usetex": False,
    "svg.hashsalt": "icac_jax",
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
}


class Look(NamedTuple):
    """How a run is drawn.

    Attributes:
      colour: of line, marker and interval.
      line: Matplotlib's line style.
      marker: Matplotlib's marker.
    """

    colour: str
    line: Any
    marker: str


LOOKS = {
    "cacla": Look("#D55E00", (0, (1, 1.2)), "s"),
    "cacla_var": Look("#009E73", (0, (5, 2)), "^"),
    "icac": Look("#0072B2", "-", "o"),
    "icac-single_predictor": Look("#CC79A7", (0, (5, 2)), "D"),
    "icac-learning_progress": Look("#E69F00", (0, (4, 1.5, 1, 1.5)), "v"),
    "icac-perception_error": Look("#56B4E9", (0, (1, 1.2)), "P"),
}


_OTHERS = [Look("#555555", "-", "x"), Look("#999999", (0, (5, 2)), "+")]


# Okabe and Ito's colours without the yellow, which is lost on white; then darker ones of hues as far apart as can be.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#222222", "#7A5C00")
_LINES = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (4, 1.5, 1, 1.5)))
_MARKERS = "o^sDvPX*"
_GOLDEN = 0.618034  # of the circle of hues: whatever their number, neighbours are far apart


def looks_by_order(number: int) -> list[Look]:
    """How runs of any names are drawn side by side: no two in one colour, and other lines and markers too.

    Args:
      number: of runs.
    """
    more = (
        colorsys.hls_to_rgb(place * _GOLDEN % 1, 0.35 + 0.1 * (place % 3), 0.7)
        for place in range(len(_COLOURS), number)
    )
    colours = [*_COLOURS, *(to_hex(colour) for colour in more)][:number]
    return [
        Look(colour, _LINES[place % len(_LINES)], _MARKERS[place % len(_MARKERS)])
        for place, colour in enumerate(colours)
    ]


def look_of(name: str) -> Look:
    """How a run or an algorithm of that name is drawn; names without a look of their own share some."""
    return LOOKS.get(name) or _OTHERS[sum(map(ord, name)) % len(_OTHERS)]


def title_of(name: str) -> str:
    """What figures call a run or an algorithm; the name itself where it has no title."""
    # Matplotlib leaves labels that begin with an underscore out of legends.
    return titles.RUNS.get(name, f" {name}" if name.startswith("_") else name)


class Drawing(NamedTuple):
    """A figure and how a page shows it.

    Attributes:
      name: of its files.
      caption: what it shows.
      figure: the figure.
      broad: whether a page gives it its whole width.
    """

    name: str
    caption: str
    figure: Figure
    broad: bool = False


def legend_columns(figure: Figure, labels: Sequence[str]) -> int:
    """In how many columns a legend of these labels fits above a figure, its rows as full as each other."""
    fits = int(figure.get_figwidth() / (0.075 * max(map(len, labels)) + 0.5))
    rows = -(-len(labels) // max(fits, 1))
    return -(-len(labels) // rows)


def blank(width: float = _SIZE[0], height: float = _SIZE[1]) -> Figure:
    """An empty figure, in inches; within `matplotlib.rc_context(STYLE)`."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def percent_axis(axes: Axes, top: float = 1.0) -> None:
    """A share on the vertical axis, from 0 to `top`, in percent."""
    axes.set_ylim(0, top)
    axes.yaxis.set_major_formatter(PercentFormatter(1))


@contextlib.contextmanager
def writing() -> Iterator[None]:
    """What a figure is written in: the style, and no warnings about signs of a name that the font does not have."""
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():
        for message in ("Glyph .* missing from", "constrained_layout not applied", "Matplotlib currently does not"):
            warnings.filterwarnings("ignore", message=message)
        yield


def save(figure: Figure, path: Path) -> None:
    """Writes a figure as `path`.png and `path`.svg, the same bytes for the same figure.

    Args:
      figure: what to write.
      path: without a suffix; its folder exists.

    Raises:
      OSError: it cannot be written.
    """
    with writing():
        # Each drawing would lay the figure out anew, from where the last one left it.
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        for suffix, facts in ((".png", {"Software": None}), (".svg", {"Date": None, "Creator": None})):
            with files.replacing(path.with_name(path.name + suffix)) as file:
                figure.savefig(file, format=suffix[1:], dpi=_DOTS_PER_INCH, metadata=facts)


def save_all(drawings: Sequence[Drawing], folder: Path) -> None:
    """Writes figures into the folder `FOLDER` of a report's folder, see `save`.

    Args:
      drawings: the figures.
      folder: of the report.

    Raises:
      OSError: they cannot be written.
    """
    files.make_folder(folder / FOLDER)
    for drawing in drawings:
        save(drawing.figure, folder / FOLDER / drawing.name)
