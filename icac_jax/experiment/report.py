"""The report of a reproduction: tables of the runs and of the claims, and one self-contained page with everything."""

import html
import io
import shlex
from typing import Any, NamedTuple

import matplotlib
import numpy as np

from icac_jax.experiment import claims, figures, folder, results, tables
from icac_jax.experiment.claims import Order, PartVerdict, Verdict
from icac_jax.experiment.figures import Drawing
from icac_jax.experiment.progress import duration
from icac_jax.experiment.results import Result
from icac_jax.experiment.statistics import Estimate, estimate
from icac_jax.experiment.tables import Table


class ArmReport(NamedTuple):
    """What is reported of one arm.

    Attributes:
      arm: its name.
      runs: its results by name, in the order of the tables.
      evaluations: `evaluation.json` of each run by name.
      verdicts: on the claims that the runs allow.
      drawings: its figures.
      seconds: wall-clock time of each run by name, compilation included.
    """

    arm: str
    runs: dict[str, Result]
    evaluations: dict[str, dict[str, Any]]
    verdicts: list[Verdict]
    drawings: list[Drawing]
    seconds: dict[str, float]


def _number(found: Estimate | None, metric: str, signed: bool = False) -> str:
    """An estimate with its interval, in the metric's form."""
    if found is None or not np.isfinite(found.value):
        return "-"
    form = ("+" if signed else "") + (".0%" if metric == "success_rate" else ".2f" if metric == "chance" else ".1f")
    return f"{found.value:{form}} [{found.low:{form}}, {found.high:{form}}]"


def runs_table(report: ArmReport) -> Table:
    """The end of learning, run by run: mean and interquartile mean over seeds, greedy evaluation, time."""
    header = (
        *("run", "success", "success (IQM)", "steps", "steps (IQM)", "steps when reached"),
        *("steps / oracle", "reward", "success, no noise", "steps, no noise", "nodes", "time"),
    )
    rows = []
    for name, result in report.runs.items():
        ends = results.last_tenth(result)
        summary, greedy = result.summary, report.evaluations.get(name, {})
        ratio, nodes = summary.get("steps_over_oracle"), summary.get("live_nodes")
        curious = result.settings.spec.algo == "icac" and nodes is not None
        rows.append(
            (
                claims.TITLES[name],
                _number(estimate(ends["success_rate"], "mean"), "success_rate"),
                _number(estimate(ends["success_rate"]), "success_rate"),
                _number(estimate(ends["steps"], "mean"), "steps"),
                _number(estimate(ends["steps"]), "steps"),
                _number(estimate(ends["steps_when_reached"], "mean"), "steps"),
                "-" if ratio is None else f"{ratio:.2f}",
                _number(estimate(ends["extrinsic_reward"], "mean"), "reward"),
                _greedy(greedy, "success_rate"),
                _greedy(greedy, "steps"),
                f"{nodes:.1f}" if curious else "-",
                duration(report.seconds[name]) if name in report.seconds else "-",
            )
        )
    settings = next(iter(report.runs.values())).settings
    run = settings.run
    return Table(
        f"{report.arm}: last tenth of {run.episodes:,} episodes, {run.seeds} seeds, {run.physics} physics, preset "
        f"{run.preset}; a failure is {settings.params.horizon} steps; mean [95 % interval over seeds]",
        header,
        rows,
    )


def _greedy(greedy: dict[str, Any], metric: str) -> str:
    found = greedy.get(metric)
    if not isinstance(found, dict) or None in found.values():
        return "-"
    return _number(Estimate(**found), metric)


def short_runs_table(report: ArmReport) -> Table:
    """The columns of `runs_table` that fit on a terminal."""
    full = runs_table(report)
    chosen = [full.header.index(name) for name in ("run", "success", "steps", "steps when reached", "steps / oracle")]
    title = full.title.partition(";")[0]
    return Table(title, *_columns(full, chosen))


def _columns(table: Table, chosen: list[int]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    return tuple(table.header[at] for at in chosen), [tuple(row[at] for at in chosen) for row in table.rows]


def _ours(found: PartVerdict) -> str:
    mean = _number(found.mean, found.part.metric)
    if isinstance(found.part, Order):
        return f"{mean} against {_number(found.other, found.part.metric)}"
    return mean


def claims_table(verdicts: list[Verdict]) -> Table:
    """Each claim with its verdict, then its parts, reading by reading."""
    header = ("claim", "what", "metric", "ours, mean", "IQM", "P(better)", "difference", "oracle", "verdict")
    rows: list[tuple[str, ...]] = []
    for verdict in verdicts:
        claim = verdict.claim
        least = "-" if verdict.oracle_steps is None else f"{verdict.oracle_steps:.1f}"
        rows.append((f"{claim.id} {claim.arm}", claim.text, "", "", "", "", "", least, verdict.outcome.upper()))
        for reading in verdict.readings:
            for found in reading:
                metric = found.part.metric
                rows.append(
                    (
                        *("", str(found.part), claims.METRIC_TITLES[metric], _ours(found), _number(found.iqm, metric)),
                        *(_number(found.improvement, "chance"), _number(found.difference, metric, signed=True)),
                        *("", found.outcome),
                    )
                )
    return Table("Claims of the paper at the end of learning, by the rule written in claims.py", header, rows)


def short_claims_table(verdicts: list[Verdict]) -> Table:
    """A line a claim."""
    rows = [(verdict.claim.id, verdict.claim.arm, verdict.outcome, verdict.claim.text) for verdict in verdicts]
    return Table("Claims of the paper", ("claim", "arm", "verdict", "what"), rows)


_CSS = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; background: #fff; max-width: 75rem; margin: 0 auto;
  padding: 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 2.2rem; border-bottom: 1px solid #ccc; }
.warning { border: 2px solid #d55e00; padding: .6rem 1rem; font-weight: 600; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 33rem), 1fr)); gap: 1rem 2rem; }
figure { margin: 0; } figure.broad { grid-column: 1 / -1; } figure svg { width: 100%; height: auto; }
figcaption { color: #444; font-size: .9rem; }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .85rem; } caption { text-align: left; padding: .3rem 0; color: #444; }
th, td { text-align: left; padding: .25rem .6rem; border-bottom: 1px solid #ddd; vertical-align: top; }
th { border-bottom: 2px solid #888; } .number { white-space: nowrap; }
.verdict { font-weight: 700; white-space: nowrap; } .yes { color: #00694a; } .no { color: #a84300; }
pre { background: #f5f5f5; padding: .7rem; overflow-x: auto; font-size: .85rem; }
"""
_COLOURS = {"reproduced": "yes", "not reproduced": "no", "undecided": ""}
# Side by side two figures fit; these are wider.
_BROAD = ("seeds", "ablations")


def _picture(drawing: Drawing, arm: str) -> str:
    """A figure as inline SVG, named for those who cannot see it."""
    buffer = io.StringIO()
    with matplotlib.rc_context(figures.STYLE):
        drawing.figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    svg = text[text.index("<svg") :]
    name = html.escape(f"{arm}: {drawing.caption}", quote=True)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{name}"', 1)
    broad = ' class="broad"' if drawing.name in _BROAD else ""
    caption = f"<figcaption>{html.escape(drawing.caption)}</figcaption>"
    return f'<figure id="{arm}-{drawing.name}"{broad}>{svg}{caption}</figure>'


def _verdict_lines(verdicts: list[Verdict]) -> str:
    rows = "\n".join(
        f"<tr><td>{html.escape(v.claim.id)}</td><td>{v.claim.arm}</td>"
        f'<td class="verdict {_COLOURS[v.outcome]}">{v.outcome}</td><td>{html.escape(v.claim.text)}</td></tr>'
        for v in verdicts
    )
    return (
        '<div class="wide"><table><thead><tr><th>claim</th><th>arm</th><th>verdict</th><th>what</th></tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div>"
    )


def _platform(report: ArmReport) -> list[tuple[str, str]]:
    """Versions and hardware that the first run of an arm started on."""
    events = folder.history(next(iter(report.runs.values())).folder)
    facts = next((event["platform"] for event in events if isinstance(event.get("platform"), dict)), {})
    versions = facts.get("versions", {})
    lines = [("python", str(facts.get("python", "-")))]
    lines += [(name, str(version)) for name, version in versions.items()] if isinstance(versions, dict) else []
    return lines + [(name, str(facts[name])) for name in ("system", "processor", "backend", "devices") if name in facts]


def page(reports: list[ArmReport], command: str, quick: bool) -> str:
    """The report as one HTML page that needs nothing else: no script, no other file, no network.

    Args:
      reports: the arms.
      command: what repeats it.
      quick: whether it is only a trial.
    """
    verdicts = [verdict for report in reports for verdict in report.verdicts]
    parts = [
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">',
        f"<title>ICAC: the paper's evaluation</title><style>{_CSS}</style></head><body>",
        "<h1>ICAC (Hafez, Weber, Wermter 2017): the paper's evaluation, repeated</h1>",
    ]
    if quick:
        parts.append(f'<p class="warning">{html.escape(QUICK)}</p>')
    parts += ["<h2>Verdicts</h2>", _verdict_lines(verdicts)]
    for report in reports:
        parts += [f"<h2>{html.escape(report.arm)}</h2>", tables.as_html(runs_table(report))]
        parts += ['<div class="figures">', *(_picture(drawing, report.arm) for drawing in report.drawings), "</div>"]
        parts.append(
            "<p>Curves are means over seeds, bands 95 % bootstrap intervals over seeds; hollow marks are what the"
        )
        parts.append("paper's text states for the end. The oracle is the least number of steps on average.</p>")
    parts += ["<h2>Claims in detail</h2>", tables.as_html(claims_table(verdicts))]
    rule = (claims.__doc__ or "").partition("\n\n")[2]
    parts += ["<h2>The rule</h2>", f"<pre>{html.escape(rule)}</pre>"]
    parts += ["<h2>How to repeat it</h2>", f"<pre>{html.escape(command)}"]
    for report in reports:
        for name, result in report.runs.items():
            config = shlex.quote(str(result.folder / folder.CONFIG))
            parts.append(html.escape(f"icac train --config {config} --out NEW   # {report.arm} {name} alone"))
    parts.append("</pre>")
    for report in reports:
        parts.append(f"<h2>Configuration: {html.escape(report.arm)}</h2>")
        for name, result in report.runs.items():
            text = html.escape(folder.config_text(result.settings))
            parts.append(f"<details><summary>{html.escape(name)}</summary><pre>{text}</pre></details>")
        parts.append(tables.as_html(Table("versions and machine", ("what", ""), _platform(report))))
    return "\n".join([*parts, "</body></html>", ""])


QUICK = "A quick trial: few seeds, few episodes, kinematics only. Its figures say nothing about the paper's claims."


def markdown(reports: list[ArmReport], command: str, quick: bool) -> str:
    """The tables for `tables.md`; arguments as for `page`."""
    verdicts = [verdict for report in reports for verdict in report.verdicts]
    parts = [f"**{QUICK}**\n"] if quick else []
    parts += [tables.as_markdown(runs_table(report)) for report in reports]
    parts += [tables.as_markdown(claims_table(verdicts)), f"Repeat with `{command}`.\n"]
    return "\n".join(parts)
