"""Whether curiosity pays on a task of discovery; the rule, fixed before any run.

A seed's figure is the number of the first episode that reached its goal; infinite if none did. Seeds are paired: one
seed has the same start and goal under every signal. A signal is compared with each control of the same task and
learner:

P(earlier)   the share of seeds that find their goal earlier than under the control, ties counting half. Its interval is
             that of a mean of paired scores, at 95 % corrected for the number of signals and tasks judged (Bonferroni).
lead         the share of seeds that found their goal, less the control's.

A signal pays against a control if P's interval lies above one half and the lead is more than 5 points. It pays on the
task if it pays against every control there, so no control has to be chosen. It does not pay if some control is at least
as good, by P or by the lead. Otherwise it is undecided: ahead of every control, by less than the rule asks for.

Visit counts are a control too, as they know nothing but where the learner has been; they are judged themselves against
the other controls. Signals with fewer than 20 seeds are undecided.
"""

import functools
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from scipy import stats

from icac_jax.reports.statistics import CONFIDENCE, Estimate
from icac_jax.reports.verdicts import SUCCESS_TOLERANCE

Outcome = Literal["pays", "does not pay", "undecided"]

MIN_SEEDS = 20


class Judged(NamedTuple):
    """A signal on a task.

    Attributes:
      outcome: by the rule of this module.
      control: name of the control that is hardest to beat: the one with the smallest P.
      earlier: P(earlier) against that control, with its corrected interval.
      lead: of the share of seeds that found their goal, over the control that found most.
    """

    outcome: Outcome
    control: str
    earlier: Estimate
    lead: float


def found(first: np.ndarray) -> float:
    """The share of seeds that found their goal.

    Args:
      first: [S] number of the first episode that reached the goal; infinite if none did.
    """
    return float(np.mean(np.isfinite(first)))


def earlier(first: np.ndarray, control: np.ndarray, judged: int = 1) -> Estimate:
    """P(earlier) of a signal against a control, with its interval.

    Args:
      first: [S] first episode that reached the goal, as in `found`.
      control: [S] the same seeds under the control.
      judged: how many comparisons the interval is corrected for.
    """
    scores = (first < control) + 0.5 * (first == control)
    half = _width(judged, len(scores)) * float(scores.std(ddof=1)) / np.sqrt(len(scores))
    return Estimate(float(scores.mean()), float(scores.mean() - half), float(scores.mean() + half))


@functools.cache
def _width(judged: int, seeds: int) -> float:
    """Half an interval of a mean in standard errors."""
    return float(stats.t.ppf(1 - (1 - CONFIDENCE) / 2 / judged, seeds - 1))


def judge(first: np.ndarray, controls: Mapping[str, np.ndarray], judged: int) -> Judged:
    """Decides on one signal on one task.

    Args:
      first: [S] first episode that reached the goal.
      controls: the same of each control, by name; at least one.
      judged: how many signals on tasks are judged in all.
    """
    chances = {name: earlier(first, control, judged) for name, control in controls.items()}
    leads = {name: found(first) - found(control) for name, control in controls.items()}
    hardest = min(chances, key=lambda name: chances[name].value)
    outcome: Outcome = "undecided"
    if len(first) >= MIN_SEEDS:
        if all(chances[name].low > 0.5 and leads[name] > SUCCESS_TOLERANCE for name in controls):
            outcome = "pays"
        elif any(chances[name].value <= 0.5 or leads[name] <= 0 for name in controls):
            outcome = "does not pay"
    return Judged(outcome, hardest, chances[hardest], min(leads.values()))
