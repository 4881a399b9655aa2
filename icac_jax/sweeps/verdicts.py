"""Whether a sweep bears out what the paper says about its options; the rule, fixed before any run.

A sweep file says what the claim expects (`expect`) and the paper's values of the varied options (`[reference]`). Each
cell is compared with the reference cell that has the same values of all other varied options, the same algorithm above
all. Figures are means over the last tenth of the episodes, one per seed; seeds are paired, as all cells see the same
starts, goals and noise. A difference is that of the means over seeds, with its 95 % bootstrap interval; tolerances are
those of the paper's claims: 5 points of success, 2.5 steps.

no_difference   a cell agrees if the interval lies within plus or minus the tolerance, contradicts if it lies wholly
                outside, is undecided otherwise.
no_gain         one-sided: a cell agrees if the interval does not reach beyond the tolerance in the direction of
                better, contradicts if all of it lies there, is undecided otherwise. A worse cell agrees.

Both metrics, success and steps, count. The claim is reproduced if every comparison agrees, not reproduced if one
contradicts, undecided otherwise. With fewer than five seeds everything is undecided.
"""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from icac_jax import shapes
from icac_jax.reports import titles
from icac_jax.reports.statistics import AS_JSON, Estimate, paired_difference
from icac_jax.reports.verdicts import LARGER_IS_BETTER, MIN_SEEDS, OUTCOMES, Outcome, all_of, at_most, tolerance, within
from icac_jax.sweeps import axes

METRICS = ("success_rate", "steps")
WORDS = {"no_difference": "no difference", "no_gain": "no gain"}
_UNKNOWN = Estimate(np.nan, np.nan, np.nan)
_COMPARISON = {"name": shapes.text, "metric": shapes.one_of(METRICS), "verdict": shapes.one_of(OUTCOMES)}
_COMPARISON |= {"cell": shapes.whole, "reference": shapes.whole, "difference": AS_JSON}
SHAPE = shapes.record(
    {"expect": shapes.one_of(WORDS), "reference": shapes.mapping(shapes.anything)}
    | {"verdict": shapes.one_of(OUTCOMES), "comparisons": shapes.several(shapes.record(_COMPARISON))}
)
"""Of what `as_json` gives."""


class Comparison(NamedTuple):
    """A cell against its reference cell.

    Attributes:
      cell: number of the cell.
      name: of the cell, in words.
      reference: number of the reference cell.
      metric: of `METRICS`.
      difference: cell minus reference, in the metric's own unit.
      outcome: reproduced where the cell agrees with the claim, by the rule of this module.
    """

    cell: int
    name: str
    reference: int
    metric: str
    difference: Estimate
    outcome: Outcome


class Verdict(NamedTuple):
    """What a sweep says about its claim.

    Attributes:
      expect: what the claim expects.
      reference: the values that the others are compared with.
      outcome: by the rule of this module.
      comparisons: cell by cell, metric by metric.
    """

    expect: str
    reference: dict[str, Any]
    outcome: Outcome
    comparisons: tuple[Comparison, ...]


def judge(rows: Sequence[dict[str, Any]], expect: str, reference: dict[str, Any]) -> Verdict:
    """Decides on the claim of a sweep.

    Args:
      rows: of the table of cells (`tables.row`).
      expect: one of `study.EXPECTATIONS`.
      reference: values of varied options.
    """
    wanted = _plain(reference)
    references = {
        _others(row, wanted): row for row in rows if {name: _plain(row["varied"])[name] for name in wanted} == wanted
    }
    comparisons = []
    for row in rows:
        against = references.get(_others(row, wanted))
        if against is None or against is row:
            continue
        for metric in METRICS:
            difference = _difference(row, against, metric)
            outcome = _outcome(difference, metric, expect)
            comparisons.append(Comparison(row["cell"], row["name"], against["cell"], metric, difference, outcome))
    outcome = all_of(comparison.outcome for comparison in comparisons) if comparisons else "undecided"
    return Verdict(expect, reference, outcome, tuple(comparisons))


def _plain(value: Any) -> Any:
    """As JSON holds it: the table of a finished sweep is read back from there."""
    return json.loads(json.dumps(value))


def _others(row: dict[str, Any], wanted: dict[str, Any]) -> str:
    """The values of the other varied options."""
    return json.dumps({name: value for name, value in row["varied"].items() if name not in wanted}, sort_keys=True)


def _difference(row: dict[str, Any], against: dict[str, Any], metric: str) -> Estimate:
    one, two = (np.array(each["by_seed"][metric], float) for each in (row, against))
    if len(one) != len(two) or np.sum(~np.isnan(one - two)) < MIN_SEEDS:
        return _UNKNOWN
    return paired_difference(one, two)


def _outcome(difference: Estimate, metric: str, expect: str) -> Outcome:
    allowance = tolerance(metric, 0.0)
    low, high = difference.low, difference.high
    if expect == "no_gain":
        if not LARGER_IS_BETTER[metric]:
            low, high = -high, -low
        return at_most(low, high, allowance)
    if within(low, high, allowance):
        return "reproduced"
    return "not reproduced" if low > allowance or high < -allowance else "undecided"


def as_json(verdict: Verdict) -> dict[str, Any]:
    """A verdict as JSON can hold it."""
    comparisons = []
    for one in verdict.comparisons:
        facts = {"cell": one.cell, "name": one.name, "reference": one.reference, "metric": one.metric}
        comparisons.append(facts | {"difference": one.difference.as_json(), "verdict": one.outcome})
    return {
        "expect": verdict.expect,
        "reference": verdict.reference,
        "verdict": verdict.outcome,
        "comparisons": comparisons,
    }


def from_json(facts: dict[str, Any]) -> Verdict:
    """The verdict that `as_json` wrote, of the shape `SHAPE`."""
    comparisons = tuple(
        Comparison(
            *(one["cell"], one["name"], one["reference"], one["metric"]),
            Estimate.from_json(one["difference"]),
            one["verdict"],
        )
        for one in facts["comparisons"]
    )
    return Verdict(facts["expect"], facts["reference"], facts["verdict"], comparisons)


def difference_text(one: Comparison) -> str:
    """A difference with its interval: "+1.2 [-0.3, +2.6]", points of success in percent."""
    return one.difference.text("+.1%" if one.metric == "success_rate" else "+.2f")


def as_text(verdict: Verdict) -> str:
    """The verdict in a line or two for a person: what was expected, the outcome, who contradicts."""
    cells = {one.cell for one in verdict.comparisons}
    against = [one for one in verdict.comparisons if one.outcome == "not reproduced"]
    unclear = {one.cell for one in verdict.comparisons if one.outcome == "undecided"} - {one.cell for one in against}
    values = ", ".join(f"{name} {axes.short(value)}" for name, value in verdict.reference.items())
    line = f"verdict: {verdict.outcome.upper()} ({WORDS[verdict.expect]} expected against {values}): "
    agreeing = len(cells) - len(unclear) - len({one.cell for one in against})
    line += (
        f"of {len(cells)} cells {agreeing} agree, {len(unclear)} undecided, {len({one.cell for one in against})} not"
    )
    worst = [f"{one.name}, {titles.METRICS[one.metric]} {difference_text(one)}" for one in against[:3]]
    return line + "".join(f"\n  contradicts: {text}" for text in worst)
