"""The report of `icac encode`: pictures beside their reconstructions, and what a line reads out of the latent."""

import io
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from icac_jax.envs import drawing
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.embedding import PARTS, Embedding
from icac_jax.errors import ConfigError
from icac_jax.reports.figures import STYLE
from icac_jax.runs import encoder_measures, files

_EXAMPLES = 6
_SHOWN = 400  # configurations in a panel
_SEED = 7  # of configurations that are in no training


def figure(arm: ArmSpec, embedding: Embedding) -> Figure:
    """Rows of pictures, of reconstructions where there are any, and panels of read-outs against the truth.

    Args:
      arm: which arm.
      embedding: its encoder.
    """
    camera = drawing.camera(arm, embedding.options.picture_size)
    seen = encoder_measures.drawn(arm, camera, 2 * _SHOWN, (embedding.options.seed, _SEED))
    back = {part: encoder_measures.reconstructed(embedding, part, seen.pictures[part][:_EXAMPLES]) for part in PARTS}
    rows = 2 if back["arm"] is not None else 1
    read = [(part, number) for part in PARTS for number in range(seen.truth[part].shape[1])]
    with matplotlib.rc_context(STYLE):
        page = Figure(figsize=(10.0, 1.1 * rows + 3.1), layout="constrained")
        halves: Any = page.subfigures(2, 1, height_ratios=[1.1 * rows, 2.8])
        upper, lower = halves
        panels = upper.subplots(rows, 2 * _EXAMPLES, squeeze=False)
        for place, part in enumerate(PARTS):
            for number in range(_EXAMPLES):
                column = place * _EXAMPLES + number
                panels[0, column].imshow(_colours(seen.pictures[part][number] / 255))
                if (again := back[part]) is not None:
                    panels[1, column].imshow(_colours(again[number]))
        for panel in panels.ravel():
            panel.set_xticks([])
            panel.set_yticks([])
        for row, words in zip(panels, ("picture", "from the latent"), strict=False):
            row[0].set_ylabel(words, fontsize=8)
        options = embedding.options
        upper.suptitle(f"{arm.name}, {options.method}, {embedding.size} entries per picture", fontsize=10)
        panels = lower.subplots(1, len(read), squeeze=False)[0]
        for panel, (part, number) in zip(panels, read, strict=True):
            unit = "rad" if part == "arm" else "m"
            name = f"joint {number + 1}" if part == "arm" else f"goal {'xyz'[arm.goal_axes[number]]}"
            embeddings = encoder_measures.embedded(embedding, part, seen.pictures[part])
            truth, said = encoder_measures.read_out(embeddings, seen.truth[part][:, number])
            panel.plot(truth, said, ".", markersize=2, color="#22608f")
            panel.plot([truth.min(), truth.max()], [truth.min(), truth.max()], color="#888888", linewidth=0.8)
            panel.set_xlabel(f"{name} [{unit}]")
            panel.set_title(f"R² {embedding.facts[part]['read_out'][number]:.3f}", fontsize=9)
        panels[0].set_ylabel("read out by a line")
    return page


def _colours(picture: np.ndarray) -> np.ndarray:
    """A picture [V, P, P] in [0, 1] as colours [P, P, 3]: dark on white, a second view in red over it."""
    ink = np.array([[0.87, 0.62, 0.42], [0.2, 0.75, 0.8]])[: len(picture)]
    return np.clip(1 - np.tensordot(picture, ink, (0, 0)), 0, 1)


def write(path: Path, arm: ArmSpec, embedding: Embedding) -> None:
    """Draws the report of an encoder into a PNG file.

    Raises:
      ConfigError: it cannot be written.
    """
    buffer = io.BytesIO()
    figure(arm, embedding).savefig(buffer, format="png", dpi=130)
    try:
        with files.replacing(path) as file:
            file.write(buffer.getvalue())
    except OSError as error:
        raise ConfigError(f"out: cannot write {path}: {error.strerror or error}") from error
