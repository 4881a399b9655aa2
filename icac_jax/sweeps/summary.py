"""A finished sweep in a few lines for a person."""

from typing import Any

from icac_jax.reports import titles
from icac_jax.runs.progress import duration
from icac_jax.sweeps import tables, verdicts

_MOST_ROWS = 15


def as_text(result: dict[str, Any]) -> str:
    """The cells from best to worst, what is within noise, the cost, the verdict.

    Args:
      result: the summary of a sweep, as `summary.json` holds it.
    """
    table = tables.as_text(result["cells"], _MOST_ROWS, metric_of(result))
    found = [result["claim"], table, *lines(result)]
    if result["verdict"]:
        found.append(verdicts.as_text(verdicts.from_json(result["verdict"])))
    return "\n".join(found)


def metric_of(result: dict[str, Any]) -> str:
    """By which metric the cells of a summary are ranked; earlier versions did not say so, and ranked by steps."""
    return result.get("metric", "steps")


def best(rows: list[dict[str, Any]], metric: str = "steps") -> list[str]:
    """The best cell in words, and which others are within noise of it; nothing where there is one cell."""
    ranked = tables.ranked(rows, metric)
    if len(ranked) < 2:
        return []
    first = ranked[0]
    equal = tables.within_noise(first, ranked, metric)
    others = [one for one in ranked[1:] if one.get("rung") == first.get("rung")]
    lines = [f"best by {titles.METRICS[metric]}: {first['name']}, {tables.interval(first, metric)}"]
    if equal:
        names = ", ".join(one["name"] for one in equal[:3]) + (" and others" if len(equal) > 3 else "")
        lines.append(
            f"within noise of it, not beaten by the interval of the paired difference: {len(equal)} of "
            f"{len(others)}{' that trained as long' if len(others) < len(ranked) - 1 else ''} ({names})"
        )
    return lines


def _time(result: dict[str, Any]) -> str:
    speed = result["lane_steps"] / result["seconds_training"] if result["seconds_training"] else 0.0
    return (
        f"{len(result['cells'])} cells in {result['programs']} programs, {result['lanes_trained']:,} learners, at most "
        f"{result['lanes']:,} at once; {speed:,.0f} lane-steps per second, {duration(result['seconds'])} in all"
    )


def halved(rows: list[dict[str, Any]]) -> str:
    """How many cells trained for how many episodes in each rung of a study with halving."""
    last = max(row["rung"] for row in rows)
    numbers = [sum(row["rung"] >= rung for row in rows) for rung in range(last + 1)]
    long = [next(row["varied"]["episodes"] for row in rows if row["rung"] == rung) for rung in range(last + 1)]
    parts = ", ".join(f"{number:,} for {episodes:,}" for number, episodes in zip(numbers, long, strict=True))
    share = sum(number * one for number, one in zip(numbers, long, strict=True)) / (len(rows) * long[-1])
    return f"cells by episodes: {parts}; {share:.0%} of what all of them to the end would be"


def lines(result: dict[str, Any]) -> list[str]:
    """The best cell, what halving left out, failures and the cost, a line each."""
    found = best(result["cells"], metric_of(result))
    if "rung" in result["cells"][0]:
        found.append(halved(result["cells"]))
    if result["failed_lanes"]:
        found.append(f"{result['failed_lanes']} learners diverged; they count as failures")
    return [*found, _time(result)]
