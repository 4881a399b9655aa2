"""What the TOML file of an arm of one's own says, and what it would say of an arm that is given by its model file."""

import difflib
import re
from pathlib import Path
from typing import Any

from icac_jax import reading
from icac_jax.console import shown
from icac_jax.envs import arms
from icac_jax.envs.model import joint_names_of, tips_of
from icac_jax.fields import ConfigError

# Each key with what it must hold, in words and as types; a list holds items of that type.
_NUMBERS, _TEXTS, _TEXT, _NUMBER = "a list of numbers", "a list of texts", "text", "a number"
_KEYS = {
    "name": _TEXT,
    "model": _TEXT,
    "joints": _TEXTS,
    "tip": _TEXT,
    "goal_axes": _TEXTS,
    "goal_low": _NUMBERS,
    "goal_high": _NUMBERS,
    "joint_low": _NUMBERS,
    "joint_high": _NUMBERS,
    "goal_radius": _NUMBER,
    "goal_reward": _NUMBER,
    "defaults": "a table of options",
    "tasks": "a table of tables of options",
}


def of_toml(path: Path) -> dict[str, Any]:
    """What the TOML file of an own arm says, each key of the right type."""
    try:
        table = reading.toml(path)
    except OSError as error:
        raise ConfigError(f"arm: cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise ConfigError(f"arm: {path} is not valid TOML: {shown(error)}") from error
    for key, value in table.items():
        if key not in _KEYS:
            close = difflib.get_close_matches(key, _KEYS, n=1)
            hint = f"; did you mean {close[0]}?" if close else ""
            raise ConfigError(f"{path}: {shown(key)}: no such key{hint}")
        if not _is(_KEYS[key], value):
            raise ConfigError(f"{path}: {key}: must be {_KEYS[key]}, got {shown(repr(value))}")
    for key in ("model", "joints"):
        if not table.get(key):
            raise ConfigError(f"{path}: {key}: must be given")
    return table


def _is(kind: str, value: Any) -> bool:
    if kind in (_NUMBERS, _TEXTS):
        return isinstance(value, list) and all(_is(_NUMBER if kind == _NUMBERS else _TEXT, item) for item in value)
    if kind == _NUMBER:
        return isinstance(value, int | float) and not isinstance(value, bool) and bool(abs(value) < 1e300)
    return isinstance(value, str if kind == _TEXT else dict)


def of_model(path: Path, tip: str) -> dict[str, Any]:
    """What the TOML file would say of an arm that is given by its model file."""
    sites, bodies = tips_of(str(path))
    if not tip:
        tip = "tip" if "tip" in sites else sites[0] if len(sites) == 1 else ""
    if not tip:
        may = ", ".join(sites or bodies) or "none, add a <site>"
        kind = "sites" if sites else "bodies"
        raise ConfigError(f"tip: must be given, --tip NAME: what must reach the goal, one of its {kind}: {shown(may)}")
    label = re.sub(r"^[^A-Za-z0-9]+|[^\w.-]", "-", path.stem, flags=re.ASCII).lstrip("-_.") or "arm"
    label = f"{label}-own" if label in arms.ARMS else label
    return {"model": path.name, "joints": joint_names_of(str(path)), "tip": tip, "name": label}
