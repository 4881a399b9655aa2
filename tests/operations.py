"""What the compiled program of a chunk consists of, and what of it is started by itself while it runs."""

import gzip
import json
import re
import tempfile
from collections import Counter
from pathlib import Path

import jax

# Instructions that cost a start of their own outside a fusion.
KINDS = ("fusion", "copy", "dot", "custom-call", "conditional", "while", "call")
_INSTRUCTION = re.compile(r"^\s+(?:ROOT )?%?[\w.-]+ = .*?\s(" + "|".join(KINDS) + r")\(")


def counts(program):
    """Instructions of each kind in a compiled program's text, those inside fusions left out."""
    found, inside = Counter(dict.fromkeys(KINDS, 0)), False
    for line in program.splitlines():
        if line and not line[0].isspace():
            inside = re.match(r"%?(fused|wrapped|parallel_fused)", line) is not None
        elif not inside and (match := _INSTRUCTION.match(line)):
            found[match[1]] += 1
    return dict(found)


def started(run):
    """Operations that XLA starts by themselves while `run()` computes, from its own trace."""
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            jax.block_until_ready(run())
        (path,) = Path(folder).glob("**/*.trace.json.gz")
        with gzip.open(path) as file:
            return sum("hlo_op" in event.get("args", {}) for event in json.load(file)["traceEvents"])
