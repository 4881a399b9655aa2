"""The report of a reproduction: tables of the runs and of the claims, and one self-contained page with everything."""

import shlex
from html import escape
from typing import Any, NamedTuple

from icac_jax.paper import power
from icac_jax.paper import verdicts as rule
from icac_jax.paper.claims import Order
from icac_jax.paper.verdicts import PartVerdict, Verdict
from icac_jax.reports import html, results, tables, titles
from icac_jax.reports.figures import Drawing
from icac_jax.reports.results import Result
from icac_jax.reports.statistics import Estimate, estimate
from icac_jax.reports.tables import Table
from icac_jax.runs import folder
from icac_jax.runs.progress import duration


class ArmReport(NamedTuple):
    """What is reported of one arm.

    Attributes:
      arm: its name.
      runs: its results by name, in the order of the tables.
      evaluations: `evaluation.json` of each run that has one, by name.
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
    if found is None:
        return "-"
    form = ("+" if signed else "") + (".0%" if metric == "success_rate" else ".2f" if metric == "chance" else ".1f")
    return found.text(form)


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
        curious = bool(nodes)
        rows.append(
            (
                titles.RUNS[name],
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
    return _number(Estimate.from_json(greedy[metric]), metric) if greedy else "-"


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
                        *("", str(found.part), titles.JUDGED[metric], _ours(found), _number(found.iqm, metric)),
                        *(_number(found.improvement, "chance"), _number(found.difference, metric, signed=True)),
                        *("", found.outcome),
                    )
                )
    return Table("Claims of the paper, by the rule written in paper/verdicts.py", header, rows)


def short_claims_table(verdicts: list[Verdict]) -> Table:
    """One line per claim."""
    rows = [(verdict.claim.id, verdict.claim.arm, verdict.outcome, verdict.claim.text) for verdict in verdicts]
    return Table("Claims of the paper", ("claim", "arm", "verdict", "what"), rows)


def undecided(reports: list[ArmReport]) -> list[str]:
    """A sentence on each part of a claim that is undecided: what it would take."""
    said = []
    for report in reports:
        settings = next(iter(report.runs.values())).settings
        for verdict in report.verdicts:
            said += power.sentences(verdict, settings.run.seeds, settings.params.goal_reward)
    return said


def _verdict_lines(verdicts: list[Verdict]) -> str:
    rows = "\n".join(
        f"<tr><td>{escape(v.claim.id)}</td><td>{v.claim.arm}</td>"
        f"{html.verdict(v.outcome, 'td')}<td>{escape(v.claim.text)}</td></tr>"
        for v in verdicts
    )
    return (
        '<div class="wide"><table><thead><tr><th>claim</th><th>arm</th><th>verdict</th><th>what</th></tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div>"
    )


def page(reports: list[ArmReport], command: str, quick: bool) -> str:
    """The report as one HTML page that needs nothing else: no script, no other file, no network.

    Args:
      reports: the arms.
      command: what repeats it.
      quick: whether it is only a trial.
    """
    verdicts = [verdict for report in reports for verdict in report.verdicts]
    parts = [
        "<h1>ICAC (Hafez, Weber, Wermter 2017): the paper's evaluation, repeated</h1>",
    ]
    if quick:
        parts.append(f'<p class="warning">{escape(QUICK)}</p>')
    parts += ["<h2>Verdicts</h2>", _verdict_lines(verdicts)]
    parts += [f"<p>{escape(line)}</p>" for line in undecided(reports)]
    for report in reports:
        parts += [f"<h2>{escape(report.arm)}</h2>", tables.as_html(runs_table(report))]
        parts += html.pictures(report.drawings, report.arm)
        parts.append(
            "<p>Curves are means over seeds, bands 95 % bootstrap intervals over seeds; hollow marks are what the"
        )
        parts.append("paper's text states for the end. The oracle is the least number of steps on average.</p>")
    parts += ["<h2>Claims in detail</h2>", tables.as_html(claims_table(verdicts))]
    parts += ["<h2>The rule</h2>", html.rule(rule)]
    parts += ["<h2>How to repeat it</h2>", f"<pre>{escape(command)}"]
    for report in reports:
        for name, result in report.runs.items():
            config = shlex.quote(str(result.folder / folder.CONFIG))
            parts.append(escape(f"icac train --config {config} --out NEW   # {report.arm} {name} alone"))
    parts.append("</pre>")
    for report in reports:
        parts.append(f"<h2>Configuration: {escape(report.arm)}</h2>")
        for name, result in report.runs.items():
            parts.append(html.folded(name, folder.config_text(result.settings)))
        parts.append(html.platform(next(iter(report.runs.values())).folder))
    return html.document("ICAC: the paper's evaluation", parts)


QUICK = "A quick trial: few seeds, few episodes, kinematics only. Its figures say nothing about the paper's claims."


def markdown(reports: list[ArmReport], command: str, quick: bool) -> str:
    """The tables for `tables.md`; arguments as for `page`."""
    verdicts = [verdict for report in reports for verdict in report.verdicts]
    parts = [f"**{QUICK}**\n"] if quick else []
    parts += [tables.as_markdown(runs_table(report)) for report in reports]
    parts += [
        tables.as_markdown(claims_table(verdicts)),
        *(f"{line}\n" for line in undecided(reports)),
        f"Repeat with {tables.markdown_code(command)}.\n",
    ]
    return "\n".join(parts)
