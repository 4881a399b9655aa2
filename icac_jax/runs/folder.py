"""The run folder: where each thing a run leaves behind lies, who works in it, and what happened to it."""

import contextlib
import datetime
import hashlib
import json
import os
import platform
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import jax
import tomli_w

from icac_jax import reading
from icac_jax.console import shown
from icac_jax.envs import own_arms
from icac_jax.errors import ConfigError
from icac_jax.runs import fcntl, files
from icac_jax.settings.options import Settings, of_learner, resolve

CONFIG = "config.toml"
SWEEP = "sweep.toml"
HISTORY = "history.jsonl"
STATUS = "status.json"
SUMMARY = "summary.json"
REPORT = "report.html"
LOG = "log.txt"
CHECKPOINTS = "checkpoints"
TENSORBOARD = "tensorboard"
ARM = "arm"
WARM_MAP = "warm_map.npz"
RECORDS = "records"
DEMONSTRATIONS = "demonstrations.parquet"
ENCODER = "encoder.npz"
read_json = reading.json_object
_LOCK = "lock"
_ATTEMPTS = 10
_LOCK_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

_PACKAGES = ("icac_jax", "jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "flax", "optax", "chex", "pyarrow")


def next_free(base: Path, name: str) -> Path:
    """Makes and returns the first of `base`/name-001, name-002, ... that is not there yet.

    Raises:
      ConfigError: it cannot be made.
    """
    number = 1
    while True:
        folder = base / f"{name}-{number:03d}"
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            number += 1
        except OSError as error:
            raise ConfigError(f"out: cannot write to {folder}: {error.strerror or error}") from error


def is_run(folder: Path) -> bool:
    """Whether the folder holds a run."""
    return (folder / CONFIG).is_file()


def is_sweep(folder: Path) -> bool:
    """Whether the folder holds a sweep."""
    return (folder / SWEEP).is_file()


@contextlib.contextmanager
def created(folder: Path, name: str, text: str | Callable[[], str]) -> Iterator[None]:
    """Makes the folder of a run or a sweep, locks it, and writes what it is.

    Args:
      folder: new or empty.
      name: the file that says what it is, `CONFIG` or `SWEEP`.
      text: what that file holds, or what gives it once the folder is there.

    Raises:
      ConfigError: the folder holds something already, is in use, or cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"out: cannot write to {folder}: {error.strerror or error}") from error
    for holds, what in ((is_run(folder), "run"), (is_sweep(folder), "sweep")):
        if holds and not is_locked(folder):
            hint = "icac resume continues it"
            raise ConfigError(f"out: must be a new or empty folder, {folder} holds a {what} ({hint})")
    with locked(folder):
        # A lock and half-written files are what a killed start leaves behind.
        others = [path for path in folder.iterdir() if path.name != _LOCK and path.suffix != files.PARTIAL]
        if others:
            raise ConfigError(f"out: must be a new or empty folder, {folder} holds {others[0].name}")
        try:
            files.write_text(folder / name, text if isinstance(text, str) else text())
        except OSError as error:
            raise ConfigError(f"out: cannot write to {folder}: {error.strerror or error}") from error
        yield


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps other processes out of the folder; the system lets go of the lock when this process ends, however it ends.

    Raises:
      ConfigError: another live process works in the folder, or it cannot be written.
    """
    try:
        lock = os.open(folder / _LOCK, _LOCK_FLAGS, 0o666)
    except OSError as error:
        raise ConfigError(f"out: cannot write to {folder}: {error.strerror or error}") from error
    try:
        _take(lock, folder)
        with contextlib.suppress(OSError):  # who holds it is a courtesy, a full disk is no reason to refuse
            os.ftruncate(lock, 0)
            os.pwrite(lock, f"process {os.getpid()} on {platform.node()}".encode(), 0)
        files.remove_partial(folder, folder / CHECKPOINTS, folder / RECORDS)
        yield
    finally:
        os.close(lock)


def _take(lock: int, folder: Path) -> None:
    """Takes the lock; `icac runs` may hold it for an instant, so it is asked for some times."""
    for attempt in range(_ATTEMPTS):
        try:
            return fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            if attempt == _ATTEMPTS - 1:
                owner = os.pread(lock, 200, 0).decode(errors="replace") or "another process"
                raise ConfigError(f"out: {folder} is in use by {owner}") from error
            time.sleep(0.05)
        except OSError as error:
            raise ConfigError(f"out: cannot lock {folder}: {error.strerror or error}") from error


def is_locked(folder: Path) -> bool:
    """Whether a live process works in the folder."""
    try:
        with reading.regular(folder / _LOCK) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def config_text(settings: Settings, folder: Path | None = None) -> str:
    """The resolved settings as TOML, every option spelled out.

    Args:
      settings: of the run.
      folder: where it will lie; the file of an arm or a warm map within it is named relative to it.

    Raises:
      ConfigError: the name of a file is not UTF-8, and no TOML file can say it.
    """
    options = settings.flat()
    for name in ("arm", "demonstrations", "encoder"):
        if folder is not None and options.get(f"{name}_sha256"):
            with contextlib.suppress(ValueError):
                options[name] = Path(options[name]).relative_to(folder.resolve()).as_posix()
    if folder is not None and settings.warm.warm_map == str(folder.resolve() / WARM_MAP):
        options["warm_map"] = WARM_MAP
    text = "# Every option of this run. To repeat it: icac train --config FILE\n" + tomli_w.dumps(options)
    try:
        text.encode()
    except UnicodeEncodeError as error:
        name = "demonstrations" if settings.run.arm.isprintable() else "arm"  # bytes that are none are surrogates
        raise ConfigError(f"{name}: must be a path in UTF-8, got {options[name]!r}") from error
    return text


def write_config(folder: Path, settings: Settings) -> None:
    """Writes the run's settings."""
    files.write_text(folder / CONFIG, config_text(settings, folder))


# What a file that a run wrote names, whatever its version, and one that somebody wrote by hand hardly does.
_IN_EVERY_RUN = {"arm", "preset", "algo", "physics", "sub_steps", "seeds", "episodes", "root_seed", "horizon"}


def read_options(path: Path) -> dict[str, Any]:
    """The options in a TOML file.

    Raises:
      ConfigError: it cannot be read or is not TOML.
    """
    try:
        options = reading.toml(path)
    except OSError as error:
        raise ConfigError(f"config: cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise ConfigError(f"config: {path} is not valid TOML: {error}") from error
    for name in ("demonstrations", "encoder"):
        copy = options.get(name)
        if options.get(f"{name}_sha256") and isinstance(copy, str):
            options[name] = str((path.parent / copy).resolve())
    arm = options.get("arm")
    if options.get("arm_sha256") and isinstance(arm, str) and own_arms.is_own(str(path.parent / arm)):
        options["arm"] = str((path.parent / arm).resolve())  # a run's own copy, wherever the run is now
    if options.get("warm_map_sha256") and options.get("warm_map") == WARM_MAP:
        options["warm_map"] = str((path.parent / WARM_MAP).resolve())
    return options


def settings_of(path: Path) -> Settings:
    """The settings that a TOML file of options gives.

    Raises:
      ConfigError: it cannot be read, or an option in it is not valid; the line names the file and the option.
    """
    options = read_options(path)
    try:
        # A run's own file names everything; those of version 0.1 even the options of every learner.
        if options.keys() >= _IN_EVERY_RUN:
            options = of_learner(options)
        return resolve(**options)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def load(folder: Path) -> Settings:
    """The settings of the run in `folder`.

    Raises:
      ConfigError: there is no run, or its configuration is not valid; the line names the file and the field.
    """
    try:
        if not folder.is_dir():
            raise ConfigError(f"run: there is no folder {folder}")
        if not is_run(folder):
            raise ConfigError(f"run: {folder} holds no run (no {CONFIG})")
    except OSError as error:
        raise ConfigError(f"run: cannot read {folder}: {error.strerror or error}") from error
    return settings_of(folder / CONFIG)


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
        "processor": _processor(),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "backend": jax.default_backend(),
        "devices": [device.device_kind for device in jax.devices()],
    }


def _processor() -> str:
    """Model of the processor and what its instructions can do, on which the compiled code depends; may be empty."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8", errors="replace").partition("\n\n")[0].splitlines()
        facts = {name.strip(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        flags = hashlib.sha256(facts.get("flags", "").encode()).hexdigest()[:8]
        return f"{facts.get('model name', 'unknown')} (instructions {flags})"
    return platform.processor()


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def record(folder: Path, event: str, **facts: Any) -> None:
    """Adds an event to the run's history and to its log."""
    files.append_line(folder / HISTORY, json.dumps({"time": _now(), "event": event, **facts}))
    note(folder, event + "".join(f", {name} {value}" for name, value in facts.items() if name != "platform"))


def note(folder: Path, line: str) -> None:
    """Adds a line to the run's log; a log that cannot be written is no reason to stop."""
    with contextlib.suppress(OSError):
        files.append_line(folder / LOG, f"{_now()} {line}")


def history(folder: Path) -> list[dict[str, Any]]:
    """The events of the run, oldest first; lines that cannot be read are left out."""
    events = []
    with contextlib.suppress(OSError):
        events += reading.json_lines(folder / HISTORY)
    return events


def platform_changes(folder: Path, facts: dict[str, Any]) -> list[str]:
    """What is different from the platform that the run last ran on, a few words each."""
    former = next((event["platform"] for event in reversed(history(folder)) if "platform" in event), None)
    if not isinstance(former, dict):
        return []
    changes = []
    for name, value in facts.items():
        old = former.get(name)
        if name == "versions":
            old = old if isinstance(old, dict) else {}
            changes += [f"{p} {shown(old.get(p))} -> {v}" for p, v in value.items() if old.get(p) != v]
        elif name == "devices":
            if old != value:
                changes.append(f"{len(old) if isinstance(old, list) else 0} -> {len(value)} devices")
        elif name not in ("system", "random") and old != value:
            changes.append(f"{name} {shown(old)} -> {value}")
    return changes
