"""The report of one run: a page that needs nothing else, and its figures as files."""

import base64
import contextlib
import io
from collections.abc import Callable
from html import escape
from pathlib import Path

from icac_jax.analysis import run_figures
from icac_jax.console import shown
from icac_jax.errors import ConfigError, DamagedError
from icac_jax.reports import figures, html, results, statistics
from icac_jax.reports.results import Result
from icac_jax.reports.titles import RUNS
from icac_jax.runs import evaluations, files
from icac_jax.runs import folder as run_folder
from icac_jax.runs import summary as summaries

PAGE = run_folder.REPORT
FILM_AFTER = 20.0
"""Seconds of training from which a training's own report shows arm and map: drawing them takes about five."""
# Nodes in all panels of a map, each of them a hundred bytes of the page.
_MOST_MARKS = 5000


def headline(result: Result) -> str:
    """What came of the run, in a sentence or two."""
    run, summary = result.settings.run, result.summary
    if result.settings.is_world:
        return _of_world(result)
    success = results.last_tenth(result)["success_rate"]
    mean = statistics.estimate(success, "mean")
    learner = RUNS.get(run.algo, run.algo.upper())
    seeds = f"{run.seeds} seed{'s' * (run.seeds > 1)}"
    interval = f", 95 % interval {mean.low:.1%} to {mean.high:.1%}" if run.seeds > 1 else ""
    text = (
        f"In the last tenth of {run.episodes:,} episodes {learner} reached {mean.value:.1%} of its goals on "
        f"{shown(result.settings.arm.name)}, exploration included ({seeds}{interval})"
    )
    first = summary["first_tenth"]["success_rate"]
    if first is not None and run.episodes > 1:
        way = "up from" if mean.value > first else "down from" if mean.value < first else "as"
        text += f", {way} {first:.1%} in the first tenth"
    text += "."
    steps, ratio = summary["last_tenth"]["steps_when_reached"], summary.get("steps_over_oracle")
    if steps is not None:
        text += f" An episode that succeeded took {steps:.1f} steps"
        text += f"; all together took {ratio:.1f} times the least number possible." if ratio else "."
    if lost := summary["failed_seeds"]:
        text += f" {len(lost)} of {seeds} diverged and count as failing."
    return text


def _of_world(result: Result) -> str:
    """What came of a run in a world without goals, in a sentence or two."""
    run, returns = result.settings.run, result.summary["returns"]
    mean = statistics.estimate(results.last_tenth(result)["extrinsic_reward"], "mean")
    seeds = f"{run.seeds} seed{'s' * (run.seeds > 1)}"
    interval = f", 95 % interval {mean.low:,.1f} to {mean.high:,.1f}" if run.seeds > 1 else ""
    text = (
        f"In the last tenth of {run.episodes:,} episodes {RUNS.get(run.algo, run.algo.upper())} had a return of "
        f"{mean.value:,.1f} per episode on {shown(result.settings.arm.name)}, exploration included ({seeds}{interval})"
    )
    if returns["first_tenth"] is not None and run.episodes > 1:
        text += f", after {returns['first_tenth']:,.1f} in the first tenth"
    if lost := result.summary["failed_seeds"]:
        text += f". {len(lost)} of {seeds} diverged"
    return text + "."


def _date(folder: Path) -> str:
    """When the run ended, in words; empty where its history does not say."""
    ends = [event.get("time") for event in run_folder.history(folder) if event.get("event") == "finished"]
    return str(ends[-1])[:16].replace("T", " ") + " UTC" if ends else ""


def film(folder: Path, warn: Callable[[str], None]) -> bytes | None:
    """The best seed's arm on its way to two goals, as a PNG; None where nothing can be drawn, which `warn` is told."""
    from icac_jax.policies import film as films  # needs MuJoCo's renderer

    buffer = io.BytesIO()
    try:
        films.strip(folder, buffer)
    except ConfigError as error:
        warn(f"no picture of the arm in the report ({error})")
        return None
    return buffer.getvalue()


def topological_map(folder: Path, warn: Callable[[str], None]) -> list[figures.Drawing]:
    """The map of the best seed, where it has one that a page can hold; why there is none is told to `warn`."""
    from icac_jax.policies import map_picture, saved  # needs JAX

    try:
        learner = saved.pick(folder)
        found = map_picture.nodes(learner)
    except (ConfigError, DamagedError):  # no map, or nothing to take it from
        return []
    if len(found.joints) * len(found.joints[0]) ** 2 > _MOST_MARKS:
        warn("no map in the report, it has too many nodes for a page (icac plot-map draws it)")
        return []
    caption = "The map of the best seed in joint space: how often each node was asked, and how well it predicted"
    return [figures.Drawing("map", caption, map_picture.figure(learner), broad=True)]


def page(result: Result, drawings: list[figures.Drawing], strip: bytes | None) -> str:
    """The report of a finished run as one HTML page.

    Args:
      result: the run.
      drawings: its figures.
      strip: picture of its arm, a PNG, or None.
    """
    settings, folder = result.settings, result.folder
    learner = RUNS.get(settings.algo, settings.algo.upper())
    title = f"{learner} on {shown(settings.arm.name)}"
    facts = [_date(folder), f"{settings.physics} physics", f"preset {settings.run.preset}"]
    facts += [f"task {settings.run.task}", f"root seed {settings.run.root_seed}"]
    parts = [f"<h1>{escape(title)}</h1>", f'<p class="headline">{escape(headline(result))}</p>']
    parts.append(f'<p class="facts">{escape(", ".join(filter(None, facts)))}</p>')
    if strip is not None:
        data = base64.b64encode(strip).decode()
        words = "The best seed without exploration, from start to goal, one row per episode"
        picture = f'<img alt="{words}" src="data:image/png;base64,{data}">'
        parts.append(f'<figure class="film">{picture}<figcaption>{words}</figcaption></figure>')
    parts += html.pictures(drawings, "run")
    parts += ["<h2>Summary</h2>", f"<pre>{escape(summaries.as_text(result.summary))}</pre>"]
    parts += [
        "<h2>How to repeat it</h2>",
        "<pre>icac train --config config.toml --out NEW   # in the run's folder</pre>",
    ]
    parts.append("<h2>Configuration</h2>")
    parts += [html.folded("every option", run_folder.config_text(settings, folder)), html.platform(folder)]
    return html.document(title, parts)


def write(
    folder: Path,
    with_film: bool = True,
    as_files: bool = False,
    warn: Callable[[str], None] = lambda _: None,
) -> list[Path]:
    """Writes the report of a finished run into its folder.

    Args:
      folder: of the run.
      with_film: whether to draw the arm and the map, where they can be drawn.
      as_files: whether to write the figures as PNG and SVG too.
      warn: told, in a line, why the arm is not drawn.

    Returns:
      What was written.

    Raises:
      ConfigError: the folder holds no finished run.
      DamagedError: its record cannot be read.
      OSError: the folder cannot be written.
    """
    if run_folder.is_sweep(folder):
        raise ConfigError(f"run: {folder} holds a sweep, which has its {PAGE}; icac compare draws its cells")
    result = results.read(folder)
    if not result.summary:
        raise ConfigError(f"run: {folder} has not finished (icac resume continues it)")
    drawings = run_figures.all_of(result, evaluations.read(folder))
    with_film = with_film and not result.settings.is_world
    if with_film:
        drawings += topological_map(folder, warn)
    written = [folder / PAGE]
    if as_files:
        figures.save_all(drawings, folder)
        written += [folder / figures.FOLDER / f"{drawing.name}.png" for drawing in drawings]
    strip = film(folder, warn) if with_film and not _all_failed(result) else None
    files.write_text(folder / PAGE, page(result, drawings, strip))
    return written


def _all_failed(result: Result) -> bool:
    return len(result.summary["failed_seeds"]) == result.settings.run.seeds


def after_training(folder: Path, warn: Callable[[str], None]) -> None:
    """Writes the report of a run that has just finished, if it is not there; that it cannot be is only a warning.

    Args:
      folder: of the run.
      warn: told, in a line, what could not be done.
    """
    if (folder / PAGE).exists():
        return
    with contextlib.suppress(DamagedError):
        try:
            seconds = run_folder.read_json(folder / run_folder.SUMMARY).get("seconds", 0.0)
            write(folder, with_film=isinstance(seconds, float) and seconds >= FILM_AFTER, warn=warn)
        except OSError as error:
            warn(f"cannot write {folder / PAGE}: {error.strerror or error}")
