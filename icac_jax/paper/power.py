"""How many seeds it would take to decide on what is undecided, if the means stayed where they are.

The half-width of an interval over seeds falls with the square root of their number; the rule in `paper.verdicts` says
how small it has to be.
"""

import math

from icac_jax.paper.claims import Order
from icac_jax.paper.verdicts import PartVerdict, Verdict
from icac_jax.reports.statistics import Estimate
from icac_jax.reports.verdicts import MIN_SEEDS, tolerance

MOST = 1_000_000
"""Beyond this many seeds a figure lies on the bound, as far as can be told."""


def _times(interval: Estimate, wanted: float) -> float:
    """By how much the number of seeds must grow until the half-width is `wanted`."""
    half = (interval.high - interval.low) / 2
    return (half / wanted) ** 2 if wanted > 0 else math.inf


def seeds_needed(found: PartVerdict, seeds: int, allowance: float) -> int | None:
    """About how many seeds would decide on an undecided part of a claim; None where no number below `MOST` would.

    Args:
      found: the part, undecided.
      seeds: how many there were.
      allowance: tolerance of its metric.
    """
    part = found.part
    if isinstance(part, Order):
        if found.improvement is None or found.difference is None:
            return None
        ways = [
            _times(found.improvement, abs(found.improvement.value - 0.5)),
            _times(found.difference, allowance - abs(found.difference.value)),
        ]
    elif part.bound == "about":
        ways = [_times(found.mean, 2 * allowance)]
    else:
        moved = part.around * allowance * (1 if part.bound == "at most" else -1)
        ways = [_times(found.mean, abs(found.mean.value - part.value - moved))]
    least = min((way for way in ways if not math.isnan(way)), default=math.inf)
    needed = seeds * max(least, 1.0)
    return None if needed > MOST else math.ceil(needed)


def sentences(verdict: Verdict, seeds: int, goal_reward: float) -> list[str]:
    """A sentence on each undecided part of an undecided claim: what it would take to decide.

    Args:
      verdict: of the claim.
      seeds: how many there were; with too few for any verdict nothing is said.
      goal_reward: extrinsic reward at the goal.
    """
    if verdict.outcome != "undecided" or seeds < MIN_SEEDS:
        return []
    said = []
    for found in (part for reading in verdict.readings for part in reading if part.outcome == "undecided"):
        needed = seeds_needed(found, seeds, tolerance(found.part.metric, goal_reward))
        name = f"{verdict.claim.id} {verdict.claim.arm}, {found.part}"
        if needed is None:
            said.append(f"{name}: {seeds} seeds do not decide, and no number of seeds is known that would.")
        else:
            said.append(
                f"{name}: {seeds} seeds do not decide; about {needed:,} would, if the means stay where they are."
            )
    return said
