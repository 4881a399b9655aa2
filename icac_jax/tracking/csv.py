"""A CSV file with a row per chunk: for spreadsheets, and for whatever watches a file."""

import csv
import io
from pathlib import Path

from icac_jax import tracking
from icac_jax.fields import ConfigError
from icac_jax.runs import files
from icac_jax.runs.observers import Observer, Run, Told

FILE = "progress.csv"
_STEPS = "lane_steps"


class CSV(Observer):
    """Writes the scalars of each chunk, with `episode` and `seconds` before them; what a chunk does not tell is empty.

    Args:
      path: the file; `progress.csv` in the run's folder by default.
    """

    def __init__(self, path: str | Path | None = None) -> None:
        self._path = None if path is None else Path(path)
        self._columns: list[str] = []

    def start(self, run: Run) -> None:
        """Begins the file, or cuts it back to where the run goes on."""
        if self._path is None:
            if run.folder is None:
                raise ConfigError("path: must be given to CSV where the run has no folder (out)")
            self._path = run.folder / FILE
        tracking.remember(run.folder, "csv")
        if not run.lane_steps_done or not self._path.exists():
            files.write_text(self._path, "")
            return
        with self._path.open(newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            self._columns = list(reader.fieldnames or [])
            # Rows after the checkpoint that a run goes on from would be there twice.
            kept = [row for row in reader if _number(row.get(_STEPS)) <= run.lane_steps_done]
        files.write_text(self._path, self._text(kept, head=bool(self._columns)))

    def _text(self, rows: list[dict], head: bool) -> str:
        text = io.StringIO()
        writer = csv.DictWriter(text, self._columns, extrasaction="ignore", lineterminator="\n")
        if head:
            writer.writeheader()
        writer.writerows(rows)
        return text.getvalue()

    def see(self, told: Told) -> None:
        """Adds a row."""
        assert self._path is not None
        if not told.by_seed:
            return  # no episode has ended
        row = {"episode": told.episode, "seconds": told.chunk.seconds, **told.scalars}
        head = not self._columns
        self._columns = self._columns or list(row)
        files.append_line(self._path, self._text([row], head).removesuffix("\n"))


def _number(text: str | None) -> float:
    try:
        return float(text or "inf")
    except ValueError:
        return float("inf")
