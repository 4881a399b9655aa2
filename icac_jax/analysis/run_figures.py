"""The figures of one run: success, steps, reward, and whatever its learner reports. S seeds, E episodes."""

from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator

from icac_jax.reports import results, statistics
from icac_jax.reports.curves import block_length, draw_curve, draw_oracle, draw_seeds
from icac_jax.reports.figures import STYLE, Drawing, blank, looks_by_order, percent_axis
from icac_jax.reports.results import Result
from icac_jax.runs.records import SCHEMA

_MEAN = looks_by_order(1)[0]
_GREEDY = looks_by_order(3)[2]
# What curious learners report per episode, drawn together.
_TERMS = ("intrinsic_reward", "learning_progress", "perception_error")


def _finish(axes: Axes, result: Result, y: str) -> None:
    length = block_length(result)
    axes.set_xlim(0, result.settings.run.episodes)
    axes.set_xlabel(f"episode (means of {length})" if length > 1 else "episode")
    axes.set_ylabel(y)
    axes.xaxis.set_major_locator(MaxNLocator(6, integer=True))
    if len(axes.get_legend_handles_labels()[0]) > 1:
        axes.figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)


def _seeds_and_mean(axes: Axes, result: Result, values: np.ndarray) -> None:
    """The seeds, and their mean with its interval."""
    draw_seeds(axes, result, values, "#8a949e")
    draw_curve(axes, result, values, "mean over seeds", _MEAN)


def _success(result: Result, evaluations: list[dict]) -> Figure:
    figure = blank()
    axes = figure.add_subplot()
    _seeds_and_mean(axes, result, results.outcomes(result)["reached"])
    passed = sorted({row["passed"] for row in evaluations})
    if passed:
        rates = [[row["success_rate"] for row in evaluations if row["passed"] == at] for at in passed]
        axes.plot(
            passed, [np.mean(each) for each in rates], _GREEDY.marker, color=_GREEDY.colour, label="without noise"
        )
    percent_axis(axes, 1.02)
    _finish(axes, result, "success")
    return figure


def _steps(result: Result) -> Figure:
    figure = blank()
    axes = figure.add_subplot()
    _seeds_and_mean(axes, result, results.outcomes(result)["steps"])
    if (least := result.summary.get("oracle_steps")) is not None:
        draw_oracle(axes, least)
    axes.set_ylim(bottom=0)
    horizon = result.settings.params.horizon
    _finish(
        axes, result, f"steps, at most {horizon}" if result.settings.is_world else f"steps (a failure is {horizon})"
    )
    return figure


def _column(result: Result, values: np.ndarray, y: str) -> Figure:
    figure = blank()
    axes = figure.add_subplot()
    _seeds_and_mean(axes, result, values)
    _finish(axes, result, y)
    return figure


def _terms(result: Result, columns: list[str]) -> Figure:
    figure = blank()
    axes = figure.add_subplot()
    taken = results.by_seed(result, "steps")
    for name, look in zip(columns, looks_by_order(len(columns)), strict=True):
        draw_curve(axes, result, results.by_seed(result, name) / taken, name.replace("_", " "), look)
    if all(np.all(np.asarray(line.get_ydata(), float) > 0) for line in axes.lines):
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    _finish(axes, result, "intrinsic reward per step")
    return figure


def _by_seed(result: Result) -> Figure:
    figure = blank()
    axes = figure.add_subplot()
    rates = np.sort(results.last_tenth(result)["success_rate"])[::-1]
    axes.bar(np.arange(len(rates)), rates, color=_MEAN.colour, width=0.8)
    mean = statistics.estimate(rates, "mean")
    axes.axhline(mean.value, color="#222222", linewidth=1.1, linestyle=(0, (8, 3)))
    axes.axhspan(mean.low, mean.high, color="#222222", alpha=0.12, linewidth=0)
    percent_axis(axes, 1.02)
    axes.set_xticks([])
    axes.set_xlabel(f"{len(rates)} seeds, the best first")
    axes.set_ylabel("success in the last tenth")
    return figure


def all_of(result: Result, evaluations: list[dict]) -> list[Drawing]:
    """Every figure that the run allows.

    Args:
      result: the run.
      evaluations: rows of its evaluations while it learnt, see `runs.evaluations`; empty where there were none.
    """
    reported = [name for name in result.table.column_names if name not in SCHEMA.names]
    terms = [name for name in _TERMS if name in reported]
    world = result.settings.is_world
    greedy = "; squares: policies without exploration" if evaluations else ""
    wanted: list[tuple[str, str, Callable[[], Figure]]] = [
        (
            "success",
            f"Share of the episodes that reached the goal; a thin line is a seed{greedy}",
            lambda: _success(result, evaluations),
        ),
        ("steps", "Steps per episode", lambda: _steps(result)),
        (
            "seeds",
            "Success in the last tenth by seed; the line is their mean, grey its interval",
            lambda: _by_seed(result),
        ),
        (
            *("reward", "Return, the sum of an episode's rewards" if world else "Extrinsic reward per episode"),
            lambda: _column(result, results.outcomes(result)["extrinsic_reward"], "reward per episode"),
        ),
    ]
    if world:  # without goals: nothing is reached
        wanted = [one for one in wanted if one[0] in ("reward", "steps")][::-1]
    if terms:
        wanted.append(("intrinsic", "Intrinsic reward per step, and its terms", lambda: _terms(result, terms)))
    for name in reported:
        if name not in terms:
            words = name.replace("_", " ")
            values = results.by_seed(result, name)
            if not np.any(np.nan_to_num(values)):
                continue  # such as nodes that a full map could not add
            wanted.append((name, f"{words.capitalize()} per episode", lambda v=values, w=words: _column(result, v, w)))
    with matplotlib.rc_context(STYLE):
        return [Drawing(name, caption, draw()) for name, caption, draw in wanted]
