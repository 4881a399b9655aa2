"""The paper's claims and the rule by which a run's figures decide on them, fixed before any run.

Every figure is of the last tenth of the episodes, one number a seed. Intervals are 95 % bootstrap intervals over seeds.

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
as rounded to that: 2.5 steps, 5 points of success. A reward an episode is the success rate times the reward at the
goal.
"""

import dataclasses
from typing import Any, Literal, NamedTuple

import numpy as np

from icac_jax.reports.statistics import Estimate, estimate, paired_difference, probability_of_improvement

Outcome = Literal["reproduced", "not reproduced", "undecided"]
Bound = Literal["about", "at most", "at least"]

MIN_SEEDS = 5
LARGER_IS_BETTER = {"extrinsic_reward": True, "success_rate": True, "steps": False, "steps_when_reached": False}
STEPS_TOLERANCE = 2.5
SUCCESS_TOLERANCE = 0.05

# The algorithms of the paper, worst first, then ICAC with one part changed: run name to options.
ALGORITHMS: dict[str, dict[str, Any]] = {name: {"algo": name} for name in ("cacla", "cacla_var", "icac")}
ABLATIONS: dict[str, dict[str, Any]] = {
    "icac-single_predictor": {"algo": "icac", "predictors": "single"},
    "icac-learning_progress": {"algo": "icac", "perception_error_weight": 0.0},
    "icac-perception_error": {"algo": "icac", "learning_progress_weight": 0.0},
}
TITLES = {
    "cacla": "CACLA",
    "cacla_var": "CACLA+Var",
    "icac": "ICAC",
    "icac-single_predictor": "ICAC, one predictor",
    "icac-learning_progress": "ICAC, learning progress alone",
    "icac-perception_error": "ICAC, perception error alone",
}
METRIC_TITLES = {
    "extrinsic_reward": "reward an episode",
    "success_rate": "success",
    "steps": "steps",
    "steps_when_reached": "steps when reached",
}


@dataclasses.dataclass(frozen=True)
class Order:
    """One run is better than another at the end.

    Attributes:
      better: name of the run that is claimed to be better.
      worse: name of the other.
      metric: of `results.METRICS`.
    """

    better: str
    worse: str
    metric: str

    @property
    def runs(self) -> tuple[str, ...]:
        """The runs that it needs."""
        return self.better, self.worse

    def __str__(self) -> str:
        return f"{TITLES[self.better]} better than {TITLES[self.worse]}"


@dataclasses.dataclass(frozen=True)
class Value:
    """A run has a certain figure at the end.

    Attributes:
      run: its name.
      metric: of `results.METRICS`.
      value: the paper's number.
      bound: how the number is meant.
      around: the text says "around": a bound is moved by the tolerance.
    """

    run: str
    metric: str
    value: float
    bound: Bound = "about"
    around: bool = False

    @property
    def runs(self) -> tuple[str, ...]:
        """The runs that it needs."""
        return (self.run,)

    def __str__(self) -> str:
        number = f"{self.value:.0%}" if self.metric == "success_rate" else f"{self.value:g}"
        return f"{TITLES[self.run]} {self.bound} {'around ' * self.around}{number}"


Part = Order | Value
Reading = tuple[Part, ...]


@dataclasses.dataclass(frozen=True)
class Claim:
    """Something the paper says about the end of learning.

    Attributes:
      id: short name.
      arm: on which arm.
      kind: "order", "value", or "ablation" for a comparison that the paper argues for without showing it.
      text: what is claimed, near the paper's words.
      readings: each a set of parts that must all hold.
    """

    id: str
    arm: str
    kind: Literal["order", "value", "ablation"]
    text: str
    readings: tuple[Reading, ...]

    @property
    def runs(self) -> set[str]:
        """The runs that it needs."""
        return {run for reading in self.readings for part in reading for run in part.runs}


def _ranking(metric: str) -> Reading:
    """ICAC better than CACLA+Var better than CACLA."""
    return Order("icac", "cacla_var", metric), Order("cacla_var", "cacla", metric), Order("icac", "cacla", metric)


def _both_counts(*values: Value) -> tuple[Reading, ...]:
    """Steps over all episodes, or over those that reached the goal."""
    return values, tuple(dataclasses.replace(value, metric="steps_when_reached") for value in values)


def _ablations(arm: str) -> tuple[Claim, ...]:
    def against(name: str) -> tuple[Reading, ...]:
        return ((Order("icac", name, "steps"),),)

    return (
        Claim(
            *("C9", arm, "ablation", "an ensemble of local predictors is better than one for the whole space (Sec. I)"),
            against("icac-single_predictor"),
        ),
        Claim(
            *("C9a", arm, "ablation", "both intrinsic terms are better than the learning progress alone (Sec. I)"),
            against("icac-learning_progress"),
        ),
        Claim(
            *("C9b", arm, "ablation", "both intrinsic terms are better than the perception error alone (Sec. I)"),
            against("icac-perception_error"),
        ),
    )


CLAIMS: tuple[Claim, ...] = (
    Claim(
        *("C1", "planar2", "order", "reward: ICAC above CACLA+Var, slightly above CACLA (Fig. 5)"),
        (_ranking("extrinsic_reward"),),
    ),
    Claim(
        *(
            "C2",
            "planar2",
            "value",
            "about 35 steps for CACLA, 20 for CACLA+Var, less than 10 for ICAC (Fig. 6)",
        ),
        _both_counts(
            Value("cacla", "steps", 35), Value("cacla_var", "steps", 20), Value("icac", "steps", 10, "at most")
        ),
    ),
    *_ablations("planar2"),
    Claim(
        *("C3", "nico4", "value", "success over 90 % for ICAC, at most around 60 % for the others (Fig. 8)"),
        (
            (
                Value("cacla", "success_rate", 0.6, "at most", around=True),
                Value("cacla_var", "success_rate", 0.6, "at most", around=True),
                Value("icac", "success_rate", 0.9, "at least"),
            ),
        ),
    ),
    Claim(
        *("C4", "nico4", "value", "30 steps for CACLA, 20 for CACLA+Var, only around five for ICAC (Fig. 9)"),
        _both_counts(
            Value("cacla", "steps", 30),
            Value("cacla_var", "steps", 20),
            Value("icac", "steps", 5, "at most", around=True),
        ),
    ),
    *_ablations("nico4"),
)


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


def tolerance(metric: str, goal_reward: float) -> float:
    """How far a figure may be from the paper's and still be taken for it."""
    if metric == "success_rate":
        return SUCCESS_TOLERANCE
    return SUCCESS_TOLERANCE * abs(goal_reward) if metric == "extrinsic_reward" else STEPS_TOLERANCE


def judge_value(part: Value, figures: np.ndarray, allowance: float) -> PartVerdict:
    """Decides on a value.

    Args:
      part: what is claimed.
      figures: [S], one a seed, NaN where a seed has none.
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
        outcome = "reproduced" if high <= limit else "not reproduced" if low > limit else "undecided"
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
    elif chance.high < 0.5 or (-allowance <= difference.low and difference.high <= allowance):
        outcome = "not reproduced"
    return PartVerdict(part, outcome, **facts, improvement=chance, difference=difference)


def _all_of(outcomes: list[Outcome]) -> Outcome:
    if "not reproduced" in outcomes:
        return "not reproduced"
    return "undecided" if "undecided" in outcomes else "reproduced"


def _one_of(outcomes: list[Outcome]) -> Outcome:
    if "reproduced" in outcomes:
        return "reproduced"
    return "undecided" if "undecided" in outcomes else "not reproduced"


def judge(
    claim: Claim, ends: dict[str, dict[str, np.ndarray]], goal_reward: float, oracle_steps: float | None = None
) -> Verdict:
    """Decides on a claim.

    Args:
      claim: what the paper says.
      ends: run name to `results.last_tenth` of it; every run in `claim.runs`.
      goal_reward: extrinsic reward at the goal.
      oracle_steps: mean of the least number of steps, passed on.
    """

    def decide(part: Part) -> PartVerdict:
        allowance = tolerance(part.metric, goal_reward)
        if isinstance(part, Order):
            return judge_order(part, ends[part.better][part.metric], ends[part.worse][part.metric], allowance)
        return judge_value(part, ends[part.run][part.metric], allowance)

    readings = tuple(tuple(decide(part) for part in reading) for reading in claim.readings)
    outcome = _one_of([_all_of([found.outcome for found in reading]) for reading in readings])
    return Verdict(claim, outcome, readings, oracle_steps)


def paper_marks(arm: str, metric: str) -> dict[str, float]:
    """The end values that the text states for a metric, by run name; for marks in figures."""
    parts = [part for claim in CLAIMS if claim.arm == arm for reading in claim.readings for part in reading]
    marks = {part.run: part.value for part in parts if isinstance(part, Value) and part.metric == metric}
    if metric == "extrinsic_reward":  # the text reads the success rates off the rewards, 100 at the goal on nico4
        return {run: 100 * rate for run, rate in paper_marks(arm, "success_rate").items()}
    return marks


def as_json(verdict: Verdict) -> dict[str, Any]:
    """A verdict as JSON can hold it."""

    def known(found: Estimate | None) -> dict[str, float | None] | None:
        if found is None:
            return None
        return {name: float(v) if np.isfinite(v) else None for name, v in found._asdict().items()}

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
