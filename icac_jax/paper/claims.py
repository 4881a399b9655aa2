"""What the paper says about the end and the speed of learning, and the runs that decide on it.

The rule is in `paper.verdicts`.
"""

import dataclasses
from typing import Any, Literal

from icac_jax.reports import titles

Bound = Literal["about", "at most", "at least"]

# The algorithms of the paper, worst first, then ICAC with one part changed: run name to options.
ALGORITHMS: dict[str, dict[str, Any]] = {name: {"algo": name} for name in ("cacla", "cacla_var", "icac")}
ABLATIONS: dict[str, dict[str, Any]] = {
    "icac-single_predictor": {"algo": "icac", "predictors": "single"},
    "icac-learning_progress": {"algo": "icac", "perception_error_weight": 0.0},
    "icac-perception_error": {"algo": "icac", "learning_progress_weight": 0.0},
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
        return f"{titles.RUNS[self.better]} better than {titles.RUNS[self.worse]}"


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
        return f"{titles.RUNS[self.run]} {self.bound} {'around ' * self.around}{number}"


Part = Order | Value
Reading = tuple[Part, ...]


@dataclasses.dataclass(frozen=True)
class Claim:
    """Something the paper says about learning.

    Attributes:
      id: short name.
      arm: on which arm.
      kind: "order", "value", "speed" for an order on the way rather than at the end, or "ablation" for a comparison
        that the paper argues for without showing it.
      text: what is claimed, near the paper's words.
      readings: each a set of parts that must all hold.
    """

    id: str
    arm: str
    kind: Literal["order", "value", "speed", "ablation"]
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


def _speed(arm: str) -> tuple[Claim, ...]:
    figure = {"planar2": "Fig. 6", "nico4": "Fig. 9"}[arm]
    return (
        Claim(
            *("C10", arm, "speed", f"ICAC learns faster: the fewest steps over all episodes ({figure})"),
            (_ranking("steps_all_episodes"),),
        ),
        Claim(
            *("C11", arm, "speed", "intensive exploration costs ICAC steps in the early episodes (Sec. V)"),
            ((Order("cacla_var", "icac", "steps_first_tenth"),),),
        ),
    )


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
    *_speed("planar2"),
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
    *_speed("nico4"),
)


def paper_marks(arm: str, metric: str) -> dict[str, float]:
    """The end values that the text states for a metric, by run name; for marks in figures."""
    parts = [part for claim in CLAIMS if claim.arm == arm for reading in claim.readings for part in reading]
    marks = {part.run: part.value for part in parts if isinstance(part, Value) and part.metric == metric}
    if metric == "extrinsic_reward":  # the text reads the success rates off the rewards, 100 at the goal on nico4
        return {run: 100 * rate for run, rate in paper_marks(arm, "success_rate").items()}
    return marks
