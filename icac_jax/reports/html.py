"""HTML pages that need nothing else: no script, no other file, no network; reports are made of them."""

import html
import io
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from icac_jax.reports import figures, shades, tables
from icac_jax.reports.figures import Drawing
from icac_jax.reports.tables import Table
from icac_jax.reports.verdicts import Outcome
from icac_jax.runs import folder

_CSS = """
:root { color-scheme: light dark; --paper: #ffffff; --ink: #222222; --soft: #444444; --line: #dddddd; --strong: #888888;
  --field: #f5f5f5; --yes: #00694a; --no: #a84300; }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 75rem;
  margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.6rem; line-height: 1.25; overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin-top: 2.2rem; border-bottom: 1px solid var(--line); }
.warning { border: 2px solid var(--no); padding: .6rem 1rem; font-weight: 600; }
.headline { font-size: 1.15rem; max-width: 48rem; } .facts { color: var(--soft); font-size: .9rem; }
.film { margin: 1rem 0 1.5rem; overflow-x: auto; }
.film img { width: 100%; min-width: 40rem; max-width: 63rem; height: auto; border-radius: 4px; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 33rem), 1fr)); gap: 1rem 2rem; }
figure { margin: 0; min-width: 0; } figure.broad { grid-column: 1 / -1; width: 100%; }
.drawing { overflow-x: auto; } .drawing svg { width: 100%; height: auto; display: block; fill: var(--ink); }
.broad .drawing svg { min-width: 44rem; }
.white { background: #ffffff; border-radius: 4px; } .white svg { fill: #000000; }
figcaption { color: var(--soft); font-size: .9rem; }
.wide { overflow-x: auto; margin: .3rem 0 1rem; } figure.table { margin-top: 1rem; }
table { border-collapse: separate; border-spacing: 0; font-size: .85rem; }
th, td { text-align: left; padding: .25rem .6rem; border-bottom: 1px solid var(--line); vertical-align: top; }
th { border-bottom: 2px solid var(--strong); } .interval { white-space: nowrap; }
.name { position: sticky; left: 0; background: var(--paper); overflow-wrap: anywhere; min-width: 6rem; }
.verdict { font-weight: 700; white-space: nowrap; } .yes { color: var(--yes); } .no { color: var(--no); }
pre { background: var(--field); padding: .7rem; overflow-x: auto; font-size: .85rem; }
@media (max-width: 40rem) {
  .name { max-width: 9rem; } th, td { padding: .25rem .45rem; }
}
"""
# What differs on a dark page; paper keeps the light one.
_DARK = f"""--paper: {shades.PAPER}; --ink: {shades.INK}; --soft: #b4bac0; --line: #343a40; --strong: #868e96;
  --field: #1f2428; --yes: #4cc9a0; --no: #f39a5b;"""
# Inches of a page per inch of a figure, at most.
_SCALE = 1.3
# Class of a verdict.
_COLOURS: dict[Outcome, str] = {"reproduced": "yes", "not reproduced": "no", "undecided": ""}


def document(title: str, parts: Sequence[str]) -> str:
    """A whole page.

    Args:
      title: in words.
      parts: of its body, HTML.
    """
    body = "\n".join(parts)
    night = f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {_DARK} {shades.at_night(body)} }} }}"
    head = [
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">',
        f"<title>{html.escape(title)}</title><style>{_CSS}{night}</style></head><body>",
    ]
    return "\n".join([*head, body, "</body></html>", ""])


def picture(drawing: Drawing, about: str) -> str:
    """A figure as inline SVG, named for those who cannot see it.

    Args:
      drawing: the figure.
      about: what it is of; begins its id and its name.
    """
    buffer = io.StringIO()
    with figures.writing():
        drawing.figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    svg = text[text.index("<svg") :]
    name = html.escape(f"{about}: {drawing.caption}", quote=True)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{name}"', 1)
    # The pixels of an image stay as they are: such a figure is a white card on a dark page.
    white = "<image" in svg
    svg = svg if white else shades.as_variables(svg)
    drawn = f'<div class="drawing{" white" if white else ""}">{svg}</div>'
    # A page's whole width would blow up what is not that wide.
    most = f' style="max-width: {_SCALE * drawing.figure.get_figwidth():.1f}in"'
    broad = f' class="broad"{most}' if drawing.broad else ""
    caption = f"<figcaption>{html.escape(drawing.caption)}</figcaption>"
    return f'<figure id="{about}-{drawing.name}"{broad}>{drawn}{caption}</figure>'


def pictures(drawings: Sequence[Drawing], about: str) -> list[str]:
    """Figures side by side where they fit, parts of a page; arguments as for `picture`."""
    return ['<div class="figures">', *(picture(drawing, about) for drawing in drawings), "</div>"]


def verdict(outcome: Outcome, tag: str) -> str:
    """A verdict in its colour, as an element of that tag."""
    return f'<{tag} class="verdict {_COLOURS[outcome]}">{outcome}</{tag}>'


def rule(module: ModuleType) -> str:
    """The rule of a module's verdicts: its docstring without the first paragraph."""
    text = (module.__doc__ or "").partition("\n\n")[2]
    return f"<pre>{html.escape(text)}</pre>"


def folded(title: str, text: str) -> str:
    """A long text that opens on demand, such as a configuration, under its title."""
    return f"<details><summary>{html.escape(title)}</summary><pre>{html.escape(text)}</pre></details>"


def platform(place: Path) -> str:
    """The versions and the hardware that the run or sweep in a folder started on, as an HTML table."""
    events = folder.history(place)
    facts = next((event["platform"] for event in events if isinstance(event.get("platform"), dict)), {})
    versions = facts.get("versions", {})
    lines = [("python", str(facts.get("python", "-")))]
    lines += [(name, str(version)) for name, version in versions.items()] if isinstance(versions, dict) else []
    lines += [(name, str(facts[name])) for name in ("system", "processor", "backend", "devices") if name in facts]
    return tables.as_html(Table("versions and machine", ("what", ""), lines))
