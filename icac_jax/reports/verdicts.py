"""What the verdicts on a claim have in common: outcomes, tolerances, and how outcomes combine.

Tolerances are half of what the paper's numbers are rounded to: five steps, ten points of success.
"""

from collections.abc import Iterable
from typing import Literal, get_args

Outcome = Literal["reproduced", "not reproduced", "undecided"]
OUTCOMES = get_args(Outcome)

# With fewer seeds everything is undecided.
MIN_SEEDS = 5
LARGER_IS_BETTER = {"extrinsic_reward": True, "success_rate": True, "steps": False, "steps_when_reached": False}
LARGER_IS_BETTER |= {"steps_all_episodes": False, "steps_first_tenth": False}
STEPS_TOLERANCE = 2.5
SUCCESS_TOLERANCE = 0.05


def tolerance(metric: str, goal_reward: float) -> float:
    """How far a figure may be from the paper's and still be taken for it."""
    if metric == "success_rate":
        return SUCCESS_TOLERANCE
    return SUCCESS_TOLERANCE * abs(goal_reward) if metric == "extrinsic_reward" else STEPS_TOLERANCE


def at_most(low: float, high: float, limit: float) -> Outcome:
    """Whether a figure is at most the limit: the whole interval lies there, or beyond it, or neither.

    Args:
      low: lower end of the figure's interval.
      high: upper end of it.
      limit: of the claim.
    """
    return "reproduced" if high <= limit else "not reproduced" if low > limit else "undecided"


def within(low: float, high: float, allowance: float) -> bool:
    """Whether the whole interval of a difference lies within plus or minus the allowance."""
    return -allowance <= low and high <= allowance


def all_of(outcomes: Iterable[Outcome]) -> Outcome:
    """Of parts that must all hold: reproduced if each is, not reproduced if one is not, undecided otherwise."""
    found = set(outcomes)
    if "not reproduced" in found:
        return "not reproduced"
    return "undecided" if "undecided" in found else "reproduced"


def one_of(outcomes: Iterable[Outcome]) -> Outcome:
    """Of readings one of which must hold: reproduced if one is, not reproduced if none is, undecided otherwise."""
    found = set(outcomes)
    if "reproduced" in found:
        return "reproduced"
    return "undecided" if "undecided" in found else "not reproduced"
