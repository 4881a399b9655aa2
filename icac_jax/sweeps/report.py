"""What a sweep leaves to be read: figures, `tables.md`, and one self-contained page with everything."""

import json
import shlex
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from icac_jax.reports import html, tables, titles
from icac_jax.reports.figures import Drawing, save_all
from icac_jax.reports.tables import Table
from icac_jax.runs import files
from icac_jax.runs import folder as run_folder
from icac_jax.sweeps import axes, discovery, discovery_figures, figures, pays, summary, verdicts
from icac_jax.sweeps import tables as cells_tables
from icac_jax.sweeps.grid import Grid
from icac_jax.sweeps.verdicts import Verdict

TABLES = "tables.md"
PAGE = "report.html"
_MOST_ROWS = 300
_SHARED_TIME = (
    "Cells of one program take its time together: a step costs the same for all of them, whatever their maps hold. "
    "What a finer map costs shows in its nodes, in the nodes that a full map could not add, and in the steps taken."
)


def write(grid: Grid, result: dict[str, Any], verdict: Verdict | None, folder: Path) -> None:
    """Writes figures, tables and page into the sweep's folder.

    Args:
      grid: the trained study.
      result: its summary.
      verdict: on its claim, if it has one.
      folder: of the sweep.

    Raises:
      OSError: they cannot be written.
    """
    found = discovery.cells(grid) if discovery.is_one(grid.settings) and not grid.chosen.halving else []
    drawings = figures.all_of(grid)
    if found:
        drawings = discovery_figures.all_of(found, grid.settings[0].run.episodes) + drawings
        files.write_text(folder / discovery.FILE, json.dumps(discovery.as_json(found), indent=2) + "\n")
    save_all(drawings, folder)
    said = summary.lines(result)  # once: with thousands of cells it takes seconds to compare them with the best
    files.write_text(folder / TABLES, markdown(grid, result, verdict, folder, found, said))
    files.write_text(folder / PAGE, page(grid, result, verdict, folder, drawings, found, said))


def cells_table(grid: Grid) -> Table:
    """One row per cell, from best to worst."""
    rows = cells_tables.ranked(grid.rows, grid.chosen.metric)
    curious = any(row["live_nodes"] is not None for row in rows)
    header = (
        "cell",
        "what",
        "success",
        "steps",
        "steps / oracle",
        "reward",
        "nodes",
        "overflow",
        "lane-steps",
        "diverged",
    )
    lines = []
    for row in rows[:_MOST_ROWS]:
        ratio, nodes, overflow = row["steps_over_oracle"], row["live_nodes"], row["overflow"]
        figures_of = [cells_tables.interval(row, name) for name in cells_tables.FORMS]
        lines.append(
            (
                *(
                    str(row["cell"]),
                    row["name"],
                    *figures_of[:2],
                    "-" if ratio is None else f"{ratio:.2f}",
                    figures_of[2],
                ),
                *("-" if nodes is None else f"{nodes:.1f}", "-" if overflow is None else str(overflow)),
                f"{row['lane_steps']:,}",
                str(row["failed_lanes"]),
            )
        )
    run, params = grid.settings[0].run, grid.settings[0].params
    long = "a cell's" if grid.chosen.halving else f"{run.episodes:,}"
    title = (
        f"{run.arm}: last tenth of {long} episodes, {run.seeds} seeds, {run.physics} physics, a failure is "
        f"{params.horizon} steps; {cells_tables.shown_by(grid.chosen.metric)}"
    )
    if len(rows) > _MOST_ROWS:
        title += f"; the first {_MOST_ROWS} of {len(rows):,}, all are in {cells_tables.CELLS}"
    kept = [at for at, name in enumerate(header) if curious or name not in ("nodes", "overflow")]
    return Table(title, tuple(header[at] for at in kept), [tuple(line[at] for at in kept) for line in lines])


def verdict_table(verdict: Verdict) -> Table:
    """One row per comparison with the reference."""
    values = ", ".join(f"{name} = {axes.short(value)}" for name, value in verdict.reference.items())
    rows = [
        (one.name, titles.METRICS[one.metric], verdicts.difference_text(one), one.outcome)
        for one in verdict.comparisons
    ]
    title = f"Difference to {values}, other options held equal: mean over seeds, paired [95 % interval]"
    return Table(title, ("cell", "metric", "difference", "verdict"), rows)


def repeat(folder: Path) -> str:
    """The command that repeats the sweep in a folder."""
    return f"icac sweep {shlex.quote(str(folder / run_folder.SWEEP))} --out NEW"


def page(
    grid: Grid,
    result: dict[str, Any],
    verdict: Verdict | None,
    folder: Path,
    drawings: list[Drawing],
    found: Sequence[discovery.Cell] = (),
    said: Sequence[str] | None = None,
) -> str:
    """The report as one HTML page.

    Arguments as for `write`, the figures, the cells of a study of discovery, and the lines of its summary if they are
    known already.
    """
    parts = [f"<h1>{escape(grid.chosen.claim)}</h1>"]
    if verdict:
        outcome = html.verdict(verdict.outcome, "span")
        parts.append(f"<p>Verdict: {outcome} ({verdicts.WORDS[verdict.expect]} was expected).</p>")
    parts += [f"<p>{escape(line[0].upper() + line[1:])}.</p>" for line in said or summary.lines(result)]
    parts += html.pictures(drawings, "sweep")
    if found:
        parts += ["<h2>Who found the goal</h2>", tables.as_html(discovery.table(found))]
        parts += [tables.as_html(discovery.by_distance(found)), "<h3>The rule</h3>", html.rule(pays)]
    parts += ["<h2>Cells</h2>", tables.as_html(cells_table(grid))]
    if any(row["live_nodes"] is not None for row in grid.rows):
        parts.append(f"<p>{_SHARED_TIME}</p>")
    if verdict:
        parts += ["<h2>Verdict in detail</h2>", tables.as_html(verdict_table(verdict))]
        parts += ["<h3>The rule</h3>", html.rule(verdicts)]
    parts += [
        "<h2>How to repeat it</h2>",
        f"<pre>{escape(repeat(folder))}",
        "icac best FOLDER   # the best cell alone</pre>",
    ]
    parts += ["<h2>Configuration</h2>", f"<pre>{escape(grid.chosen.text)}</pre>"]
    first = run_folder.config_text(grid.settings[0])
    parts.append(html.folded(f"every option of the first cell, {grid.rows[0]['name']}", first))
    parts.append(html.platform(folder))
    return html.document(grid.chosen.claim, parts)


def markdown(
    grid: Grid,
    result: dict[str, Any],
    verdict: Verdict | None,
    folder: Path,
    found: Sequence[discovery.Cell] = (),
    said: Sequence[str] | None = None,
) -> str:
    """The tables for `tables.md`; arguments as for `page`."""
    parts = [f"## {tables.markdown_text(grid.chosen.claim)}\n"]
    if verdict:
        parts.append(f"**{verdict.outcome.capitalize()}** ({verdicts.WORDS[verdict.expect]} was expected).\n")
    parts += [f"{tables.markdown_text(line[0].upper() + line[1:])}.\n" for line in said or summary.lines(result)]
    if found:
        parts += [tables.as_markdown(discovery.table(found)), tables.as_markdown(discovery.by_distance(found))]
    parts.append(tables.as_markdown(cells_table(grid)))
    if any(row["live_nodes"] is not None for row in grid.rows):
        parts.append(f"{_SHARED_TIME}\n")
    if verdict:
        parts.append(tables.as_markdown(verdict_table(verdict)))
    return "\n".join([*parts, f"Repeat with {tables.markdown_code(repeat(folder))}.\n"])
