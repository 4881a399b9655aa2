"""Tables that are printed, written as Markdown and put into a page: one set of rows for all three."""

import html
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
    lines = [table.header, tuple("---" for _ in table.header), *table.rows]
    body = "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
    return f"### {table.title}\n\n{body}\n"


def as_html(table: Table) -> str:
    """An HTML table with a caption."""

    def line(cells: tuple[str, ...], tag: str) -> str:
        # A number and its interval stay on one line.
        kept = [f'<{tag} class="number">' if "[" in cell else f"<{tag}>" for cell in cells]
        body = (f"{start}{html.escape(cell)}</{tag}>" for start, cell in zip(kept, cells, strict=True))
        return "<tr>" + "".join(body) + "</tr>"

    rows = "\n".join(line(row, "td") for row in table.rows)
    return (
        f'<div class="wide"><table><caption>{html.escape(table.title)}</caption>\n'
        f"<thead>{line(table.header, 'th')}</thead>\n<tbody>\n{rows}\n</tbody></table></div>"
    )
