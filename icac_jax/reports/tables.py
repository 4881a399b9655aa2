"""Tables that are printed, written as Markdown and put into a page: one set of rows for all three."""

import html
import re
from typing import NamedTuple


class Table(NamedTuple):
    """Rows of text.

    Attributes:
      title: what it shows.
      header: name of each column.
      rows: cells of each row, as many as the header has; an empty first cell continues the row above.
    """

    title: str
    header: tuple[str, ...]
    rows: list[tuple[str, ...]]


def as_text(table: Table) -> str:
    """Aligned columns for a terminal, all to the left."""
    lines = [table.header, *table.rows]
    widths = [max(len(line[place]) for line in lines) for place in range(len(table.header))]
    return "\n".join(
        [
            table.title,
            *("  ".join(f"{cell:{w}}" for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines),
        ]
    )


def as_markdown(table: Table) -> str:
    """A Markdown table under a heading."""
    head, *rows = (map(markdown_text, line) for line in (table.header, *table.rows))
    lines = [head, ("---" for _ in table.header), *rows]
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    return f"### {markdown_text(table.title)}\n\n{body}\n"


# What would mark up the text around it; an underscore within a word does not, nor a bracket that no other one follows.
_MARKS = re.compile(r"[\\`*]|(?<![^\W_])_|_(?![^\W_])|\](?=[(\[])")


def markdown_text(text: str) -> str:
    """A text in one line that Markdown shows as it is."""
    marked = _MARKS.sub(lambda found: f"\\{found[0]}", " ".join(text.split()))
    # Not every reader of Markdown knows these with a backslash.
    return re.sub("[<>|&$~]", lambda found: f"&#{ord(found[0])};", marked)


def markdown_code(text: str) -> str:
    """A text in one line as code in Markdown, whatever backticks are in it."""
    text = " ".join(text.split())
    fence = "`" * (1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence} {text} {fence}" if "`" in text else f"`{text}`"


def as_html(table: Table) -> str:
    """An HTML table under its title; where it has to be scrolled, the column that names the rows stays in sight."""
    columns = [*zip(*table.rows, strict=True)] or [() for _ in table.header]
    named = next((at for at, cells in enumerate(columns) if not all(cell.isdigit() for cell in cells)), 0)

    def cell(at: int, text: str, tag: str) -> str:
        # A line may end between a number and its interval, and not within the interval.
        kept = re.sub(r"\[[^\]]*\]", r'<span class="interval">\g<0></span>', html.escape(text))
        start = f'<{tag} class="name">' if at == named else f"<{tag}>"
        return f"{start}{kept}</{tag}>"

    def line(cells: tuple[str, ...], tag: str) -> str:
        return "<tr>" + "".join(cell(at, text, tag) for at, text in enumerate(cells)) + "</tr>"

    rows = "\n".join(line(row, "td") for row in table.rows)
    return (
        f'<figure class="table"><figcaption>{html.escape(table.title)}</figcaption><div class="wide"><table>\n'
        f"<thead>{line(table.header, 'th')}</thead>\n<tbody>\n{rows}\n</tbody></table></div></figure>"
    )
