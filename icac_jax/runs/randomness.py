"""JAX's settings of random numbers: the same seed draws something else under others, so that a run keeps its own."""

from pathlib import Path
from typing import Any

import jax

from icac_jax.errors import ConfigError
from icac_jax.runs import folder as run_folder

# What JAX has unless it is told otherwise; runs of earlier versions, which did not record it, were trained with it.
DEFAULTS = {"jax_default_prng_impl": "threefry2x32", "jax_threefry_partitionable": True, "jax_random_seed_offset": 0}


def settings() -> dict[str, Any]:
    """JAX's settings of random numbers now, by name."""
    return {name: jax.config.values[name] for name in DEFAULTS}


def platform_facts() -> dict[str, Any]:
    """What a run's history says of where it runs: versions and hardware, and these settings."""
    return run_folder.platform_facts() | {"random": settings()}


def check(folder: Path) -> None:
    """Refuses to go on with a run or a sweep under other settings than it was begun with.

    Args:
      folder: of the run or the sweep. One without a history of its own is taken as it is.

    Raises:
      ConfigError: a setting differs; the line names it and what it must be.
    """
    began = next((event for event in run_folder.history(folder) if isinstance(event.get("platform"), dict)), None)
    if began is None:
        return
    stored = began["platform"].get("random")
    stored = DEFAULTS | (stored if isinstance(stored, dict) else {})
    for name, value in settings().items():
        if stored[name] != value:
            raise ConfigError(
                f"{name}: must be {stored[name]!r} as when {folder} was begun, got {value!r}; "
                f"other random numbers would be drawn (set {name.upper()}={stored[name]})"
            )
