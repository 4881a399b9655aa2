"""`icac runs`: the runs and sweeps in some folders, how far they are, and their last figures."""

import contextlib
import fnmatch
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeGuard

from icac_jax import console
from icac_jax.errors import ConfigError, DamagedError
from icac_jax.runs import folder as run_folder
from icac_jax.runs import stored_summary
from icac_jax.sweeps import engine, sweep_file
from icac_jax.sweeps.collect import GROUPS
from icac_jax.sweeps.sweep import PLAN

_WIDEST = 48
_ENDED = "last tenth: success {success_rate:.1%}, steps {steps:.1f}"
_DATE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d")
_OPTIONS = ("arm", "algo", "task", "physics")
KEYS = ("folder", "state", "date", "kind", *_OPTIONS)
"""What runs can be filtered by."""
ORDERS = ("folder", "date", "state", "algo", "arm", "episodes_done", "success")
"""What runs can be sorted by."""
_STATES = ("running", "stopped", "finished", "failed")


def find(folders: list[Path]) -> list[Path]:
    """The run folders among and below the given ones, in order of their paths.

    Raises:
      ConfigError: a folder does not exist.
    """
    found: set[Path] = set()
    for folder in folders:
        try:
            if not folder.is_dir():
                raise ConfigError(f"folder: there is no folder {folder}")
            found |= {path.parent for name in (run_folder.CONFIG, run_folder.SWEEP) for path in folder.rglob(name)}
        except OSError as error:
            raise ConfigError(f"folder: cannot read {folder}: {error.strerror or error}") from error
    return sorted(found)


def describe(folder: Path) -> dict[str, Any]:
    """State and figures of one run or sweep: the keys of `KEYS`, then `title`, `episodes_done`, `episodes`, `note`.

    The state is running, stopped, finished, failed, or unreadable where the configuration cannot be read. `date` is
    that of the last event in its history, UTC; `success` that of the last tenth of a finished run. What is not known is
    None.
    """
    status = run_folder.read_json(folder / run_folder.STATUS)
    state, done, note = (status.get(name) for name in ("state", "episodes_done", "note"))
    state = state if isinstance(state, str) and state in _STATES else "stopped"
    if run_folder.is_locked(folder):
        state = "running"
    elif state == "running":  # its process is gone without having said so
        state = "stopped"
    # A job array says it task by task; once it is put together the working files are gone.
    tasks = run_folder.read_json(folder / PLAN).get("tasks") if (folder / GROUPS).is_dir() else None
    if tasks:
        run, done = engine.how_far(folder / GROUPS)
        state, note = "running" if run else state, f"{run} of {tasks} tasks run"
    try:
        title, total = _title(folder, status)
    except ConfigError as error:
        state, title, total = "unreadable", str(error).removeprefix(f"{folder}/"), 0
    success = None
    if state == "finished" and not run_folder.is_sweep(folder):
        last = _last_tenth(folder)
        if last is not None:
            success, note = last["success_rate"], _ENDED.format(**last)
    return {
        "folder": str(folder),
        "state": state,
        "date": _date(folder),
        "kind": "sweep" if run_folder.is_sweep(folder) else "run",
        **_facts(folder),
        "success": success,
        "title": title,
        "episodes_done": done if _is_count(done) else 0,
        "episodes": total,
        "note": note if isinstance(note, str) else "",
    }


def _date(folder: Path) -> str | None:
    """The time of the last event in the history that is one."""
    times = (event.get("time") for event in reversed(run_folder.history(folder)))
    return next((time for time in times if isinstance(time, str) and _DATE.match(time)), None)


def _facts(folder: Path) -> dict[str, str | None]:
    """What runs are told apart by: arm, learner, task and physics; None for a sweep, or where it cannot be read."""
    facts: dict[str, str | None] = dict.fromkeys(_OPTIONS)
    if not run_folder.is_sweep(folder):
        with contextlib.suppress(ConfigError):
            settings = run_folder.load(folder)
            facts |= {name: getattr(settings.run, name) for name in _OPTIONS} | {"arm": settings.arm.name}
    return facts


def chosen(found: list[dict[str, Any]], filters: Sequence[str]) -> list[dict[str, Any]]:
    """The runs that all filters let through.

    Args:
      found: runs as `describe` gives them.
      filters: each KEY=VALUE with a key of `KEYS`; the value is a pattern such as `icac*`.

    Raises:
      ConfigError: a filter has no such form or key.
    """
    for text in filters:
        key, equals, pattern = text.partition("=")
        if not equals or key not in KEYS:
            raise ConfigError(f"filter: must be KEY=VALUE with a key among {', '.join(KEYS)}, got {text!r}")
        found = [run for run in found if run[key] is not None and fnmatch.fnmatchcase(str(run[key]), pattern)]
    return found


def by(found: list[dict[str, Any]], key: str, backwards: bool = False) -> list[dict[str, Any]]:
    """The runs in the order of a key; those without it come last.

    Args:
      found: runs as `describe` gives them.
      key: one of `ORDERS`.
      backwards: the largest or latest first.
    """
    known = [run for run in found if run[key] is not None]
    return [
        *sorted(known, key=lambda run: run[key], reverse=backwards),
        *(run for run in found if run[key] is None),
    ]


def _last_tenth(folder: Path) -> dict[str, Any] | None:
    """How a finished run ended, None where its summary cannot be read."""
    with contextlib.suppress(DamagedError):
        summary = stored_summary.read(folder)
        last = {} if summary is None else summary["last_tenth"]
        if None not in (last.get("success_rate"), last.get("steps")):
            return last
    return None


def _title(folder: Path, status: dict[str, Any]) -> tuple[str, int]:
    """What a run or a sweep is in a few words, and its episodes.

    Raises:
      ConfigError: its configuration cannot be read.
    """
    if run_folder.is_sweep(folder):
        total = status.get("episodes")
        claim = textwrap.shorten(sweep_file.read(folder / run_folder.SWEEP).claim, _WIDEST, placeholder=" ...")
        return f"sweep: {claim}", total if _is_count(total) else 0
    settings = run_folder.load(folder)
    title = f"{settings.algo} {settings.arm.name} {settings.run.physics} x {settings.run.seeds}"
    return title, settings.run.seeds * settings.run.episodes


def _is_count(value: Any) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**63


def as_text(found: list[dict[str, Any]]) -> str:
    """The runs as aligned lines."""
    if not found:
        return "no runs"
    # Anybody may have named the folders and written what is in them.
    found = [run | {name: console.shown(run[name]) for name in ("folder", "title", "note")} for run in found]
    width = max(len(run["folder"]) for run in found)
    title = max(len(run["title"]) for run in found)
    lines = []
    for run in found:
        share = run["episodes_done"] / run["episodes"] if run["episodes"] else 0.0
        date = (run["date"] or "")[:16].replace("T", " ")
        line = (
            f"{run['folder']:{width}}  {date:16}  {run['state']:10} {share:4.0%}  {run['title']:{title}}  {run['note']}"
        )
        lines.append(line.rstrip())
    return "\n".join(lines)
