"""The summary of a run as it is read back from its folder."""

from pathlib import Path
from typing import Any

from icac_jax import shapes
from icac_jax.errors import DamagedError
from icac_jax.runs import folder as run_folder
from icac_jax.settings.options import Settings

_FIGURE = shapes.optional(shapes.number)
_PART = shapes.record(
    {"episodes": shapes.whole} | dict.fromkeys(("success_rate", "steps", "steps_when_reached"), _FIGURE)
)
_SHAPE = shapes.record(
    dict.fromkeys(("arm", "algo", "physics", "preset"), shapes.text)
    | dict.fromkeys(("seeds", "episodes", "episodes_recorded", "lane_steps"), shapes.whole)
    | dict.fromkeys(("first_tenth", "last_tenth"), _PART)
    | {"last_tenth_by_seed": shapes.mapping(_PART), "failed_seeds": shapes.mapping(shapes.whole)}
    | {"live_nodes": _FIGURE, "overflow": shapes.optional(shapes.whole)}
    | {"seconds": shapes.number, "lane_steps_per_second": _FIGURE},
    later=dict.fromkeys(("oracle_steps", "steps_over_oracle"), _FIGURE)
    | {"returns": shapes.record(dict.fromkeys(("first_tenth", "last_tenth"), _FIGURE))},
)


def read(folder: Path, settings: Settings | None = None) -> dict[str, Any] | None:
    """The summary of a run that has finished, as `summary.summarise` has it; None where there is none.

    Args:
      folder: of the run.
      settings: of the run, where more than its shape is to be right.

    Raises:
      DamagedError: there is one that cannot be read, lacks something, or is of another run.
    """
    path = folder / run_folder.SUMMARY
    try:
        found = shapes.read(path, _SHAPE, "summary of a run")
        if found is not None and settings is not None:
            _check(path, found, settings)
    except DamagedError as error:
        raise DamagedError(f"{error}; icac resume writes it anew") from error
    return found


def _check(path: Path, found: dict[str, Any], settings: Settings) -> None:
    run = settings.run
    meant = {"arm": settings.arm.name, "algo": settings.algo, "physics": settings.physics, "seeds": run.seeds}
    seeds = {str(seed) for seed in range(run.seeds)}
    same = all(found[name] == value for name, value in meant.items())
    if not same or set(found["last_tenth_by_seed"]) != seeds or not set(found["failed_seeds"]) <= seeds:
        raise DamagedError(f"{path}: not the summary of this run")
