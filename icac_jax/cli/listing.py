"""`icac runs`: the runs and sweeps in some folders, how far they are, and their last figures."""

import contextlib
import textwrap
from pathlib import Path
from typing import Any, TypeGuard

from icac_jax import console
from icac_jax.errors import ConfigError, DamagedError
from icac_jax.runs import folder as run_folder
from icac_jax.runs import stored_summary
from icac_jax.sweeps import sweep_file

_WIDEST = 48
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
    """State and figures of one run: `folder`, `state`, `title`, `episodes_done`, `episodes`, `note`.

    The state is running, stopped, finished, failed, or unreadable where the configuration cannot be read.
    """
    status = run_folder.read_json(folder / run_folder.STATUS)
    state, done, note = (status.get(name) for name in ("state", "episodes_done", "note"))
    state = state if isinstance(state, str) and state in _STATES else "stopped"
    if run_folder.is_locked(folder):
        state = "running"
    elif state == "running":  # its process is gone without having said so
        state = "stopped"
    try:
        title, total = _title(folder, status)
    except ConfigError as error:
        state, title, total = "unreadable", str(error).removeprefix(f"{folder}/"), 0
    if state == "finished" and not run_folder.is_sweep(folder):
        note = _last_tenth(folder) or note
    return {
        "folder": str(folder),
        "state": state,
        "title": title,
        "episodes_done": done if _is_count(done) else 0,
        "episodes": total,
        "note": note if isinstance(note, str) else "",
    }


def _last_tenth(folder: Path) -> str | None:
    """How a finished run ended, None where its summary cannot be read."""
    with contextlib.suppress(DamagedError):
        summary = stored_summary.read(folder)
        last = {} if summary is None else summary["last_tenth"]
        if None not in (last.get("success_rate"), last.get("steps")):
            return "last tenth: success {success_rate:.1%}, steps {steps:.1f}".format(**last)
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
        lines.append(f"{run['folder']:{width}}  {run['state']:10} {share:4.0%}  {run['title']:{title}}  {run['note']}")
    return "\n".join(lines)
