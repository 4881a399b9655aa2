"""Puts the package's own code into a page: what the documentation shows is what runs.

A page names a function and, where only a part is wanted, words that stand in that part, such as its comment:

    <!-- code: icac_jax.curiosity.itm.update | line 2; lines 3-8 -->

becomes the blocks (lines between empty lines) in which those words stand. Without words it is the whole function. A
function that does not exist, or words that are not in exactly one of its blocks, end the build.

    <!-- file: examples/curiosity.py -->

becomes that file: Python as a block of code, Markdown as a part of the page.
"""

import importlib
import inspect
import re
import textwrap
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).resolve().parents[2]
_DIRECTIVE = re.compile(r"^<!-- code: (?P<name>[\w.]+)(?: \| (?P<words>.+?))? -->$", re.M)
_FILE = re.compile(r"^<!-- file: (?P<path>[\w./-]+) -->$", re.M)
_DOCSTRING = re.compile(r'^ *"""(?:.|\n)*?"""\n', re.M)
_DECORATORS = re.compile(r"\A(?:@.*\n)+")


def find(name: str) -> Any:
    """The function or class of that full name; where results are cached, the function that gives them.

    Raises:
      LookupError: there is none.
    """
    module, _, last = name.rpartition(".")
    try:
        return inspect.unwrap(getattr(importlib.import_module(module), last))
    except (ImportError, AttributeError) as error:
        raise LookupError(f"the documentation shows {name}, which does not exist") from error


def code(name: str, *words: str) -> str:
    """Source of a function without its docstring, or of the blocks in it that hold the words.

    Args:
      name: its full name.
      words: each stands in exactly one block; none for the whole function.

    Raises:
      LookupError: there is no such function, or some words are not in exactly one block.
    """
    source = textwrap.dedent(inspect.getsource(find(name)))
    source = _DECORATORS.sub("", _DOCSTRING.sub("", source, count=1))
    if not words:
        return source.rstrip()
    blocks = source.split("\n\n")
    chosen = set()
    for wanted in words:
        found = [place for place, block in enumerate(blocks) if re.search(rf"{re.escape(wanted)}(?!\d)", block)]
        if len(found) != 1:
            raise LookupError(f"the documentation shows {name} at {wanted!r}, found in {len(found)} places")
        chosen.add(found[0])
    return textwrap.dedent("\n\n".join(blocks[place] for place in sorted(chosen))).strip("\n")


def excerpt(match: re.Match[str]) -> str:
    """The Markdown that takes a directive's place: where the code is from, then the code."""
    name = match["name"]
    words = [part.strip() for part in (match["words"] or "").split(";") if part.strip()]
    file = Path(inspect.getsourcefile(find(name)) or "").resolve().relative_to(_ROOT)
    shown = name.removeprefix("icac_jax.")
    return f"[`{shown}`][{name}] in `{file}`\n{{ .from }}\n\n```python\n{code(name, *words)}\n```\n"


def whole_file(match: re.Match[str]) -> str:
    """The Markdown that takes the place of a directive for a whole file."""
    path = _ROOT / match["path"]
    text = path.read_text().rstrip()
    return f"```python\n{text}\n```" if path.suffix == ".py" else text


def on_page_markdown(markdown: str, **_: Any) -> str:
    """What mkdocs calls for every page."""
    return _FILE.sub(whole_file, _DIRECTIVE.sub(excerpt, markdown))
