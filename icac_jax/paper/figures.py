"""The figures of an experiment on one arm, in the form of the paper's Figures 5, 6, 8 and 9, and what those hide.

One function per figure; each takes the results of runs on one arm and returns a Matplotlib figure. Curves and style are
those of `reports.curves` and `reports.figures`.
"""

from collections.abc import Callable, Sequence
from typing import Any, cast

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from icac_jax.paper import claims
from icac_jax.reports import results
from icac_jax.reports.curves import block_length, blocks, draw_curve, draw_oracle, draw_seeds
from icac_jax.reports.figures import LOOKS, STYLE, Drawing, Look, blank, legend_columns, look_of, percent_axis, title_of
from icac_jax.reports.results import Result


def _finish(axes: Axes, all_results: Sequence[Result], y: str, legend: bool = True) -> None:
    length = block_length(all_results[0])
    axes.set_xlim(0, max(result.settings.run.episodes for result in all_results) * 1.02)
    axes.set_xlabel(f"episode (means of {length})" if length > 1 else "episode")
    axes.set_ylabel(y)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    if legend:
        handles, labels = axes.get_legend_handles_labels()
        columns = legend_columns(cast(Figure, axes.figure), labels)
        axes.figure.legend(handles, labels, loc="outside upper center", ncols=columns)


def _paper_marks(axes: Axes, all_results: Sequence[Result], metric: str) -> None:
    """What the paper's text states for the end: hollow marks right of the curves."""
    shown = {result.name: result for result in all_results}
    marks = claims.paper_marks(all_results[0].settings.run.arm, metric)
    end = max(result.settings.run.episodes for result in all_results) * 1.02
    placed: list[float] = []
    for name, value in marks.items():
        if name not in shown:
            continue
        look = look_of(name)
        aside = 0.025 * placed.count(value)
        placed.append(value)
        axes.plot(
            *([end * (1.02 + aside)], [value]),
            color=look.colour,
            marker=look.marker,
            markersize=7,
            markerfacecolor="white",
            markeredgewidth=1.6,
            linestyle="none",
            clip_on=False,
        )
    if placed:
        axes.set_ylim(top=max(axes.get_ylim()[1], *(1.04 * value for value in placed)))
        axes.plot(
            *([], []),
            color="#555555",
            marker="o",
            markersize=7,
            markerfacecolor="white",
            markeredgewidth=1.6,
            linestyle="none",
            label="the paper's text",
        )


def _oracle(axes: Axes, all_results: Sequence[Result]) -> None:
    """The least number of steps on average, where a run knows it."""
    known = [result.summary.get("oracle_steps") for result in all_results]
    least = next((value for value in known if value is not None), None)
    if least is not None:
        draw_oracle(axes, least)


def _metric_figure(all_results: Sequence[Result], column: str, y: str, metric: str, oracle: bool = False) -> Figure:
    with matplotlib.rc_context(STYLE):
        figure = blank()
        axes = figure.add_subplot()
        for result in all_results:
            draw_curve(axes, result, results.outcomes(result)[column])
        if oracle:
            _oracle(axes, all_results)
        axes.set_ylim(bottom=0)
        _paper_marks(axes, all_results, metric)
        _finish(axes, all_results, y)
        return figure


def reward(all_results: Sequence[Result]) -> Figure:
    """Figures 5 and 8: average external reward per episode."""
    return _metric_figure(all_results, "extrinsic_reward", "external reward per episode", "extrinsic_reward")


def steps(all_results: Sequence[Result]) -> Figure:
    """Figures 6 and 9, first reading: average number of steps; an episode that fails counts as the horizon."""
    horizon = all_results[0].settings.params.horizon
    return _metric_figure(all_results, "steps", f"steps to the goal (a failure is {horizon})", "steps", oracle=True)


def steps_when_reached(all_results: Sequence[Result]) -> Figure:
    """Figures 6 and 9, second reading: average number of steps of the episodes that reached the goal."""
    title = "steps to the goal (reached episodes)"
    return _metric_figure(all_results, "steps_when_reached", title, "steps_when_reached", oracle=True)


def success(all_results: Sequence[Result]) -> Figure:
    """Share of the episodes that reached the goal."""
    figure = _metric_figure(all_results, "reached", "success rate", "success_rate")
    (axes,) = figure.axes
    percent_axis(axes)
    return figure


def seeds(all_results: Sequence[Result]) -> Figure:
    """The spread over seeds: each seed's success as a thin line, or bands of them, and at the end as dots."""
    with matplotlib.rc_context(STYLE):
        number = len(all_results)
        figure = blank(2.3 * (number + 1), 3.0)
        panels = figure.subplots(1, number + 1, sharey=True, width_ratios=[*[1.0] * number, 0.35 * number])
        rng = np.random.default_rng(0)
        for place, (axes, result) in enumerate(zip(panels, all_results, strict=False)):
            look = look_of(result.name)
            episodes, means = blocks(result, results.outcomes(result)["reached"])
            draw_seeds(axes, result, results.outcomes(result)["reached"], look.colour)
            axes.plot(episodes, results.mean_of_known(means, axis=0), color="black", linewidth=1.6)
            axes.set_title(title_of(result.name))
            axes.xaxis.set_major_locator(MaxNLocator(3, integer=True))
            axes.set_xlabel("episode")
            at_end = results.last_tenth(result)["success_rate"]
            aside = place + rng.uniform(-0.2, 0.2, len(at_end))
            panels[-1].plot(
                *(aside, at_end), look.marker, color=look.colour, markersize=4, alpha=0.75, markeredgewidth=0
            )
            panels[-1].plot([place - 0.3, place + 0.3], [np.nanmean(at_end)] * 2, color="black", linewidth=1.6)
        panels[0].set_ylabel("success rate")
        percent_axis(panels[0], 1.02)
        panels[-1].set_title("last tenth")
        panels[-1].set_xticks(range(number), [title_of(result.name) for result in all_results], rotation=30, ha="right")
        panels[-1].set_xlim(-0.6, number - 0.4)
        return figure


def nodes(all_results: Sequence[Result]) -> Figure:
    """Growth of the map: live nodes at the end of each episode, of runs that build one."""
    with matplotlib.rc_context(STYLE):
        figure = blank()
        axes = figure.add_subplot()
        for result in all_results:
            draw_curve(axes, result, results.by_seed(result, "live_nodes"))
        axes.set_ylim(bottom=0)
        axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
        _finish(axes, all_results, "nodes of the map")
        return figure


def intrinsic(result: Result) -> Figure:
    """The intrinsic reward per step and its two terms, on a logarithmic axis: they differ by a factor of many."""
    with matplotlib.rc_context(STYLE):
        figure = blank()
        axes = figure.add_subplot()
        taken = results.by_seed(result, "steps")
        terms = (
            ("intrinsic_reward", "both, Eq. 10", Look("#444444", "-", "o")),
            ("perception_error", "perception error", LOOKS["icac-perception_error"]),
            ("learning_progress", "learning progress", LOOKS["icac-learning_progress"]),
        )
        for column, title, look in terms:
            values = results.by_seed(result, column) / taken
            draw_curve(axes, result, values, title, look)
        if any(np.any(np.asarray(line.get_ydata(), float) > 0) for line in axes.lines):
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.yaxis.set_minor_locator(NullLocator())
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        _finish(axes, [result], "intrinsic reward per step")
        return figure


def ablations(all_results: Sequence[Result]) -> Figure:
    """ICAC and ICAC with one part changed: success and steps."""
    with matplotlib.rc_context(STYLE):
        figure = blank(9.4, 3.8)
        left, right = figure.subplots(1, 2, gridspec_kw={"wspace": 0.12})
        for result in all_results:
            outcomes = results.outcomes(result)
            draw_curve(left, result, outcomes["reached"])
            draw_curve(right, result, outcomes["steps"])
        percent_axis(left)
        right.set_ylim(bottom=0)
        _oracle(right, all_results)
        horizon = all_results[0].settings.params.horizon
        _finish(left, all_results, "success rate", legend=False)
        _finish(right, all_results, f"steps to the goal (a failure is {horizon})", legend=False)
        figure.legend(*right.get_legend_handles_labels(), loc="outside upper center", ncols=3)
        return figure


# Side by side two figures fit; these are wider.
_BROAD = ("seeds", "ablations")


def all_of(runs: dict[str, Result]) -> list[Drawing]:
    """Every figure that the runs on one arm allow.

    Args:
      runs: by name; the three algorithms of the paper, and ICAC with one part changed if it was run.
    """
    three = [runs[name] for name in claims.ALGORITHMS if name in runs]
    changed = [runs[name] for name in ("icac", *claims.ABLATIONS) if name in runs]
    first = {"planar2": ("Fig. 5", "Fig. 6"), "nico4": ("Fig. 8", "Fig. 9")}[three[0].settings.run.arm]
    wanted: list[tuple[str, str, Callable[..., Figure], Any]] = [
        ("reward", f"Average external reward per episode (the paper's {first[0]})", reward, three),
        ("steps", f"Steps to the goal, a failure counts as the horizon ({first[1]}, one reading)", steps, three),
        (
            *("steps_when_reached", f"Steps to the goal of the episodes that reached it ({first[1]}, other reading)"),
            *(steps_when_reached, three),
        ),
        ("success", "Share of the episodes that reached the goal", success, three),
        (
            "seeds",
            "The spread over seeds: a thin line or a dot is a seed, bands are half and nine tenths, black is the mean",
            seeds,
            three,
        ),
    ]
    if "icac" in runs:
        wanted.append(("nodes", "Growth of the map", nodes, changed))
        wanted.append(("intrinsic", "Intrinsic reward per step and its two terms, ICAC", intrinsic, runs["icac"]))
    if len(changed) > 1:
        wanted.append(("ablations", "ICAC with one part changed", ablations, changed))
    return [Drawing(name, caption, draw(subject), name in _BROAD) for name, caption, draw, subject in wanted]
