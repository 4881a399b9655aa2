"""Adds whatever lies under docs/results/ to the navigation: reports are written by commands, not named by hand."""

from pathlib import Path
from typing import Any


def on_config(config: Any) -> Any:
    """What mkdocs calls first."""
    pages = sorted((Path(config["docs_dir"]) / "results").glob("*.md"), key=lambda path: (path.stem != "index", path))
    if pages:
        before_reference = next(place for place, entry in enumerate(config["nav"]) if "Reference" in entry)
        config["nav"].insert(before_reference, {"Results": [f"results/{path.name}" for path in pages]})
    return config
