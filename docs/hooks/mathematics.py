"""Sets equations as MathML while the site is built: a page shows them without JavaScript and without the web.

A page has them between dollar signs, in LaTeX; `pymdownx.arithmatex` finds them and leaves code alone. What LaTeX knows
and the converter does not ends the build, and so does a command without its arguments.
"""

import html
import re
import xml.etree.ElementTree as ElementTree
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

_FOUND = re.compile(r'<(span|div) class="arithmatex">(?:\\\((.+?)\\\)|\\\[(.+?)\\\])</\1>', re.S)
# How many children an element must have: with fewer a browser shows an error.
_CHILDREN = {"mfrac": 2, "msub": 2, "msup": 2, "msubsup": 3, "munder": 2, "mover": 2, "munderover": 3, "mroot": 2}


def mathml(latex: str, block: bool = False) -> str:
    """An equation as a `<math>` element.

    Args:
      latex: what stands between the dollar signs.
      block: on a line of its own, in the larger form.

    Raises:
      PluginError: the converter does not know a command, or an argument is missing.
    """
    try:
        text = convert(latex, display="block" if block else "inline")
        elements = list(ElementTree.fromstring(text).iter())
    except Exception as error:  # the converter has a class per kind of mistake, and plain IndexErrors
        raise PluginError(f"no equation: {latex}: {error!r}") from error
    unknown = [element.text for element in elements if "\\" in (element.text or "")]
    tags = [element.tag.rpartition("}")[2] for element in elements]
    short = [
        tag for tag, element in zip(tags, elements, strict=True) if len(element) != _CHILDREN.get(tag, len(element))
    ]
    if unknown or short:
        raise PluginError(f"no equation: {latex}: {', '.join([*map(str, unknown), *short])}")
    return text


def on_page_content(html_text: str, **_: Any) -> str:
    """What mkdocs calls with every page's HTML."""
    return _FOUND.sub(lambda match: mathml(html.unescape(match[2] or match[3]), match[2] is None), html_text)
