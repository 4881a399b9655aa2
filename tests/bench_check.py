"""`make bench-check OLD=a.json NEW=b.json`: what became slower from one `make bench` to another."""

import argparse
import json
import sys
from pathlib import Path

# Medians on a busy machine differ by this much without a change.
FACTOR = 1.25


def worse_by(old, new):
    """By which factor a measurement became worse; below 1 where it became better.

    Args:
      old: a measurement: its `value`, and whether `better` is "less" or "more".
      new: the same, later.
    """
    before, after = (new["value"], old["value"]) if old["better"] == "more" else (old["value"], new["value"])
    return after / before if before else 1.0 if after == before else float("inf")


def compare(old, new, factor=FACTOR):
    """Lines that say what became worse by more than the factor, what else differs, and how many there are of the first.

    Args:
      old: what `make bench` wrote.
      new: the same, later.
      factor: what counts as slower.
    """
    lines = []
    for name in ("device", "cores", "cpu"):
        if old["machine"].get(name) != new["machine"].get(name):
            lines.append(f"another machine ({name}): {old['machine'].get(name)} then, {new['machine'].get(name)} now")
    shared = [name for name in old["measurements"] if name in new["measurements"]]
    worse = {name: worse_by(old["measurements"][name], new["measurements"][name]) for name in shared}
    slower = sorted((name for name in shared if worse[name] > factor), key=lambda name: -worse[name])
    for name in slower:
        before, after = old["measurements"][name], new["measurements"][name]
        lines.append(
            f"{worse[name]:.2f} x worse: {name}, {before['value']:.4g} to {after['value']:.4g} {before['unit']}"
        )
    for name in sorted(set(old["measurements"]) ^ set(new["measurements"])):
        lines.append(f"only {'then' if name in old['measurements'] else 'now'}: {name}")
    lines.append(f"{len(slower)} of {len(shared)} measurements worse by more than {factor:g}")
    return lines, len(slower)


def main(args=None):
    """Prints the comparison; exit status 1 if anything became slower."""
    parser = argparse.ArgumentParser(prog="bench-check", description=__doc__)
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path)
    parser.add_argument("--factor", type=float, default=FACTOR, help="what counts as slower (%(default)s)")
    given = parser.parse_args(args)
    old, new = (json.loads(path.read_text()) for path in (given.old, given.new))
    lines, slower = compare(old, new, given.factor)
    print("\n".join(lines))
    return 1 if slower else 0


if __name__ == "__main__":
    sys.exit(main())
