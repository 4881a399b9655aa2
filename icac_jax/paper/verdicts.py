"""The rule by which the figures of runs decide on the paper's claims, fixed before any run.

Every figure is one number per seed: a mean over the last tenth of the episodes, for claims on learning speed over all
of them (the area under the curve, divided by their number) or over the first tenth. Intervals are 95 % bootstrap
intervals over seeds.

The rule for an order (X better than Y), pair by pair:
  reproduced      the interval of the probability that a random seed of X beats a random seed of Y lies above 0.5;
  not reproduced  that interval lies below 0.5; or the interval of the mean difference between X and Y, paired by seed,
                  lies within plus or minus the tolerance of the metric: no difference that a figure would show;
  undecided       otherwise.
The rule for a value, by the mean over seeds, as in the paper:
  about v         reproduced if the interval, widened by the tolerance, contains v and its own half-width is at most
                  twice the tolerance; not reproduced if the widened interval does not contain v; undecided if it does
                  but is too wide to tell.
  at most, at least b   reproduced if the whole interval lies on the claimed side of b, not reproduced if the whole
                  interval lies on the other side, undecided if b is within it. Where the text says "around", b is moved
                  by the tolerance in the claim's favour.
A reading is reproduced if each of its parts is, not reproduced if one of them is not, undecided otherwise. A claim that
the text allows to be read in two ways (steps to the goal: with failures as the horizon, or over the episodes that
reached it) is reproduced if one reading is, not reproduced if no reading can be, undecided otherwise.
With fewer than five seeds everything is undecided.

Tolerances: the paper's numbers of steps are all multiples of five, its success rates of ten points, so they are taken
as rounded to that: 2.5 steps, 5 points of success. A reward per episode is the success rate times the reward at the
goal.
"""

from typing import Any, NamedTuple

import numpy as np

from icac_jax.paper.claims import Claim, Order, Part, Value
from icac_jax.reports.statistics import Estimate, estimate, paired_difference, probability_of_improvement
from icac_jax.reports.verdicts import LARGER_IS_BETTER, MIN_SEEDS, Outcome, all_of, at_most, one_of, tolerance, within


class PartVerdict(NamedTuple):
    """What a run says about a part of a claim.

    Attributes:
      part: what is claimed.
      outcome: by the rule of this module.
      mean: the run's mean over seeds (of an order: of the better one).
      iqm: its interquartile mean.
      other: of an order: the other run's mean.
      improvement: of an order: the probability of improvement.
      difference: of an order: the mean difference paired by seed, positive where the claim is right.
    """

    part: Part
    outcome: Outcome
    mean: Estimate
    iqm: Estimate
    other: Estimate | None = None
    improvement: Estimate | None = None
    difference: Estimate | None = None


class Verdict(NamedTuple):
    """What the runs say about a claim.

    Attributes:
      claim: the claim.
      outcome: by the rule of this module.
      readings: the verdicts on the parts, reading by reading.
      oracle_steps: mean of the least number of steps in the task, if known.
    """

    claim: Claim
    outcome: Outcome
    readings: tuple[tuple[PartVerdict, ...], ...]
    oracle_steps: float | None


def judge_value(part: Value, figures: np.ndarray, allowance: float) -> PartVerdict:
    """Decides on a value.

    Args:
      part: what is claimed.
      figures: [S], one per seed, NaN where a seed has none.
      allowance: tolerance of the metric.
    """
    mean, iqm = estimate(figures, "mean"), estimate(figures, "iqm")
    if np.sum(~np.isnan(figures)) < MIN_SEEDS:
        return PartVerdict(part, "undecided", mean, iqm)
    outcome: Outcome = "undecided"
    if part.bound == "about":
        if not mean.low - allowance <= part.value <= mean.high + allowance:
            outcome = "not reproduced"
        elif mean.high - mean.low <= 4 * allowance:
            outcome = "reproduced"
    else:
        sign = 1 if part.bound == "at most" else -1
        low, high = sorted((sign * mean.low, sign * mean.high))
        limit = sign * part.value + part.around * allowance
        outcome = at_most(low, high, limit)
    return PartVerdict(part, outcome, mean, iqm)


def judge_order(part: Order, better: np.ndarray, worse: np.ndarray, allowance: float) -> PartVerdict:
    """Decides on an order.

    Args:
      part: what is claimed.
      better: [S] figures of the run that is claimed to be better, by seed.
      worse: [S] those of the other, the same seeds.
      allowance: tolerance of the metric.
    """
    sign = 1 if LARGER_IS_BETTER[part.metric] else -1
    known = [values[~np.isnan(values)] for values in (better, worse)]
    facts = {"mean": estimate(better, "mean"), "iqm": estimate(better), "other": estimate(worse, "mean")}
    if min(map(len, known)) < MIN_SEEDS:
        return PartVerdict(part, "undecided", **facts)
    chance = probability_of_improvement(sign * known[0], sign * known[1])
    difference = paired_difference(sign * better, sign * worse)
    outcome: Outcome = "undecided"
    if chance.low > 0.5:
        outcome = "reproduced"
    elif chance.high < 0.5 or within(difference.low, difference.high, allowance):
        outcome = "not reproduced"
    return PartVerdict(part, outcome, **facts, improvement=chance, difference=difference)


def judge(
    claim: Claim, ends: dict[str, dict[str, np.ndarray]], goal_reward: float, oracle_steps: float | None = None
) -> Verdict:
    """Decides on a claim.

    Args:
      claim: what the paper says.
      ends: run name to `results.judged` of it; every run in `claim.runs`.
      goal_reward: extrinsic reward at the goal.
      oracle_steps: mean of the least number of steps, passed on.
    """

    def decide(part: Part) -> PartVerdict:
        allowance = tolerance(part.metric, goal_reward)
        if isinstance(part, Order):
            return judge_order(part, ends[part.better][part.metric], ends[part.worse][part.metric], allowance)
        return judge_value(part, ends[part.run][part.metric], allowance)

    readings = tuple(tuple(decide(part) for part in reading) for reading in claim.readings)
    outcome = one_of(all_of(found.outcome for found in reading) for reading in readings)
    return Verdict(claim, outcome, readings, oracle_steps)


def as_json(verdict: Verdict) -> dict[str, Any]:
    """A verdict as JSON can hold it."""

    def known(found: Estimate | None) -> dict[str, float | None] | None:
        return None if found is None else found.as_json()

    return {
        "id": verdict.claim.id,
        "arm": verdict.claim.arm,
        "kind": verdict.claim.kind,
        "text": verdict.claim.text,
        "verdict": verdict.outcome,
        "oracle_steps": verdict.oracle_steps,
        "readings": [
            [
                {
                    "part": str(found.part),
                    "metric": found.part.metric,
                    "paper": found.part.value if isinstance(found.part, Value) else None,
                    "verdict": found.outcome,
                    **{name: known(getattr(found, name)) for name in found._fields[2:]},
                }
                for found in reading
            ]
            for reading in verdict.readings
        ],
    }
