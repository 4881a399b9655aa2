"""What the compiled program of a chunk consists of: on a CPU each of these is started by itself in every step."""

import re
from collections import Counter

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
