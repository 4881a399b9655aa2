"""The arms by name: those of the package, and arms of one's own, each a TOML file beside its MuJoCo model."""

import difflib
import functools
import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from icac_jax import reading
from icac_jax.envs import arms, reach
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import joint_ranges, tip_box
from icac_jax.fields import ConfigError
from icac_jax.settings import presets

_SUFFIX = ".toml"
_SAMPLES = 20_000
_LARGEST = 2**30  # bytes of a mesh or a texture
_AXES = ("x", "y", "z")
_FOLDERS = ("meshdir", "texturedir", "assetdir")
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
}


class Found(NamedTuple):
    """An arm and what goes with it.

    Attributes:
      name: the option `arm`: a name of the package, or the whole path of a TOML file.
      arm: its numbers.
      presets: by name, what each changes of the declared defaults.
      sha256: of all files of an own arm; empty for an arm of the package.
    """

    name: str
    arm: ArmSpec
    presets: dict[str, dict[str, Any]]
    sha256: str


def whole(name: str) -> str:
    """The option `arm` as runs keep it: the path of an own arm without regard to the current folder."""
    if isinstance(name, str) and name.endswith(_SUFFIX):
        return str(Path(os.path.expanduser(name)).resolve())
    return name


def find(name: str) -> Found:
    """The arm that the option `arm` names.

    Raises:
      ConfigError: there is none, or a file of an own arm cannot be read or is not valid.
    """
    if not whole(name).endswith(_SUFFIX):
        arm = arms.get(name)
        return Found(name, arm, presets.of_arm(name), "")
    path = Path(whole(name))
    table = _table(path)
    model = path.parent / table["model"]
    if not model.is_file():
        raise ConfigError(f"{path}: model: there is no file {model}")
    try:
        return _own(str(path), _checksum(path, model))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def _table(path: Path) -> dict[str, Any]:
    """What the TOML file of an own arm says, each key of the right type."""
    try:
        table = reading.toml(path)
    except OSError as error:
        raise ConfigError(f"arm: cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise ConfigError(f"arm: {path} is not valid TOML: {error}") from error
    for key, value in table.items():
        if key not in _KEYS:
            close = difflib.get_close_matches(key, _KEYS, n=1)
            raise ConfigError(f"{path}: {key}: no such key" + (f"; did you mean {close[0]}?" if close else ""))
        if not _is(_KEYS[key], value):
            raise ConfigError(f"{path}: {key}: must be {_KEYS[key]}, got {value!r}")
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


def _checksum(path: Path, model: Path) -> str:
    """SHA-256 over the TOML file, the model and every file that the model names."""
    digest = hashlib.sha256()
    try:
        for file in [path, *sorted(set(_files(model, [model.parent])))]:
            digest.update(hashlib.sha256(reading.data(file, _LARGEST)).digest())
    except OSError as error:
        raise ConfigError(f"model: cannot read {error.filename}: {error.strerror or error}") from error
    return digest.hexdigest()


def _files(model: Path, folders: list[Path]) -> Iterator[Path]:
    """An MJCF file and all files it names in these folders: included ones, meshes, textures, height fields."""
    yield model
    try:
        root = ElementTree.parse(model).getroot()
    except ElementTree.ParseError as error:
        raise ConfigError(f"model: {model} is not valid XML: {error}") from error
    asked = [value for node in root.iter("compiler") for key in _FOLDERS if (value := node.get(key))]
    folders = folders + [folders[0] / value for value in asked]
    for node in root.iter():
        named = [folder / name for name in node.attrib.values() for folder in folders] if "file" in node.attrib else []
        for file in (file for file in named if file.is_file()):
            yield from _files(file, folders) if node.tag == "include" else [file]


@functools.lru_cache(maxsize=64)
def _own(name: str, sha256: str) -> Found:
    """The own arm of a TOML file; cached by its checksum, so a changed file is read again."""
    path = Path(name)
    table = _table(path)
    label = table.get("name", path.stem)
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", label) or label in arms.ARMS:
        raise ConfigError(f"name: must be letters, digits, _ . - and not {' or '.join(arms.ARMS)}, got {label!r}")
    names = tuple(table["joints"])
    axes = _axes(table.get("goal_axes", list(_AXES)))
    blank = (0.0,) * len(names)
    bare = ArmSpec(
        name=label,
        model=str(path.parent / table["model"]),
        goal_axes=axes,
        goal_low=(),
        goal_high=(),
        joint_low=blank,
        joint_high=blank,
        goal_radius=0.0,
        goal_reward=float(table.get("goal_reward", 100.0)),
        joint_names=names,
        tip=table.get("tip", "tip"),
    )
    joint_low, joint_high = _limits(bare, table)
    low, high, far = tip_box(bare, joint_low, joint_high, _SAMPLES)
    # Whole millimetres, outwards: the same box on every machine.
    box = {"goal_low": np.floor(low * 1000) / 1000, "goal_high": np.ceil(high * 1000) / 1000}
    chosen = {key: table.get(key, [float(value) for value in box[key][list(axes)]]) for key in box}
    for key, values in chosen.items():
        if len(values) != len(axes):
            raise ConfigError(f"{key}: must be {len(axes)} numbers, one a goal axis, got {len(values)}")
    for axis, below, above in zip(axes, chosen["goal_low"], chosen["goal_high"], strict=True):
        if above - below < 1e-3 * far or high[axis] - low[axis] < 1e-6:
            raise ConfigError(
                f"goal_axes: along {_AXES[axis]} the tip does not move, or goal_low is not below goal_high"
            )
    arm = bare.__class__(
        **vars(bare)
        | {
            "joint_low": joint_low,
            "joint_high": joint_high,
            "goal_low": tuple(map(float, chosen["goal_low"])),
            "goal_high": tuple(map(float, chosen["goal_high"])),
            "goal_radius": float(table.get("goal_radius", np.round(far / 8, 3))),
        }
    )
    return Found(name, arm, {"paper": presets.OWN | _defaults(table)}, sha256)


def _axes(names: list[str]) -> tuple[int, ...]:
    if not names or len(set(names)) < len(names) or not set(names) <= set(_AXES):
        raise ConfigError(f"goal_axes: must be some of {', '.join(_AXES)}, each once, got {names!r}")
    return tuple(_AXES.index(name) for name in names)


def _limits(arm: ArmSpec, table: dict[str, Any]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Lower and upper joint limits in degrees: as given, else the ranges of the model."""
    if ("joint_low" in table) != ("joint_high" in table):
        raise ConfigError("joint_low: joint_low and joint_high must be given both or neither")
    ranges = joint_ranges(arm)
    limits = table.get("joint_low"), table.get("joint_high")
    if limits[0] is None:
        for name, limit in zip(arm.joint_names, ranges, strict=True):
            if limit is None:
                raise ConfigError(f"joint_low: joint {name!r} has no range in the model; give joint_low and joint_high")
        limits = zip(*ranges, strict=True)  # pyright: ignore[reportArgumentType]
    low, high = (tuple(map(float, limit)) for limit in limits)  # pyright: ignore[reportArgumentType]
    reach.validate(arm, reach.ReachParams(joint_low=low, joint_high=high))
    return low, high


def _defaults(table: dict[str, Any]) -> dict[str, Any]:
    """The options that the file sets; those that make the arm itself have keys of their own."""
    chosen = table.get("defaults", {})
    for name in ("arm", "arm_sha256", "preset", "joint_low", "joint_high", "goal_radius", "goal_reward"):
        if name in chosen:
            raise ConfigError(f"defaults: {name} is not an option to be set there")
    return chosen
