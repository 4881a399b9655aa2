"""The run folder: where each thing a run leaves behind lies."""

import json
import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import tomli_w

from icac_jax.config import ConfigError
from icac_jax.experiment.settings import Settings

CONFIG = "config.toml"
PLATFORM = "platform.json"
EPISODES = "episodes.parquet"
SUMMARY = "summary.json"

_PACKAGES = ("icac_jax", "jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "flax", "optax", "chex", "pyarrow")


def next_free(base: Path, name: str) -> Path:
    """The first of `base`/name-001, name-002, ... that is not there yet."""
    number = 1
    while (base / f"{name}-{number:03d}").exists():
        number += 1
    return base / f"{name}-{number:03d}"


def create(folder: Path, settings: Settings) -> None:
    """Makes the folder and writes what the run is and where it runs.

    Raises:
      ConfigError: the folder holds something already, or cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        occupied = any(folder.iterdir())
        if not occupied:
            write_text(folder / CONFIG, config_text(settings))
            write_text(folder / PLATFORM, json.dumps(platform_facts(), indent=2) + "\n")
    except OSError as error:
        raise ConfigError(f"out: cannot write to {folder}: {error.strerror or error}") from error
    if occupied:
        what = "a run" if (folder / CONFIG).exists() else "other files"
        raise ConfigError(f"out: must be a new or empty folder, {folder} holds {what}")


def config_text(settings: Settings) -> str:
    """The resolved settings as TOML, every option spelled out."""
    return "# Every option of this run. To repeat it: icac train --config FILE\n" + tomli_w.dumps(settings.flat())


def platform_facts() -> dict[str, Any]:
    """Versions and hardware: what the last digits of the results depend on."""
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "python": platform.python_version(),
        "versions": versions,
        "system": platform.platform(),
        "machine": platform.machine(),
        "backend": jax.default_backend(),
        "devices": [device.device_kind for device in jax.devices()],
    }


def write_text(path: Path, text: str) -> None:
    """Writes beside `path` and moves it there, so that a reader never sees half a file."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text)
    os.replace(partial, path)
