"""Copies in a run's folder of the files that it depends on, so that they go where it goes."""

import hashlib
import shutil
from pathlib import Path

from icac_jax import reading
from icac_jax.console import shown
from icac_jax.envs import own_arms
from icac_jax.errors import ConfigError
from icac_jax.runs import files
from icac_jax.runs import folder as run_folder
from icac_jax.settings import demonstration_files, encoder_files
from icac_jax.settings.options import Settings, resolve


def with_arm(folder: Path, settings: Settings) -> Settings:
    """Copies the files of a run's own arm into its folder, so that they go where it goes.

    Args:
      folder: of the run, locked by this process.
      settings: of the run.

    Returns:
      The settings with the copy as the arm; the same settings for an arm of the package.

    Raises:
      ConfigError: the copy is not the arm that the settings are of.
      OSError: something cannot be read or written.
    """
    if not settings.run.arm_sha256:
        return settings
    path, half, there = Path(settings.run.arm), folder / (run_folder.ARM + files.PARTIAL), folder / run_folder.ARM
    shutil.rmtree(half, ignore_errors=True)
    copied = own_arms.files_of(path).copy(half, path)
    half.rename(there)
    name = there / copied.relative_to(half)
    changed = resolve(**settings.flat() | {"arm": str(name.resolve()), "arm_sha256": ""})
    if vars(changed.arm) | {"model": ""} != vars(settings.arm) | {"model": ""}:
        raise ConfigError(f"arm: {shown(path)} or a file of its model has changed since the run was begun")
    return changed


def with_encoder(folder: Path, settings: Settings) -> Settings:
    """Copies a run's encoder into its folder; arguments, result and errors as of `with_demonstrations`."""
    options = settings.camera
    if not options.encoder:
        return settings
    name = _copied("encoder", options.encoder, options.encoder_sha256, encoder_files.MOST, folder / run_folder.ENCODER)
    return resolve(**settings.flat() | {"encoder": name})


def with_demonstrations(folder: Path, settings: Settings) -> Settings:
    """Copies a run's file of demonstrations into its folder, so that it goes where it goes.

    Args:
      folder: of the run, locked by this process.
      settings: of the run.

    Returns:
      The settings with the copy; the same settings where there is no such file.

    Raises:
      ConfigError: the file has changed since it was read.
      OSError: it cannot be read or written.
    """
    options = settings.imitation
    if not options.from_file:
        return settings
    given, sha256 = options.demonstrations, options.demonstrations_sha256
    there = folder / run_folder.DEMONSTRATIONS
    name = _copied("demonstrations", given, sha256, demonstration_files.MOST, there)
    return resolve(**settings.flat() | {"demonstrations": name})


def _copied(option: str, given: str, sha256: str, most: int, there: Path) -> str:
    """Copies the file that an option names, and gives the whole path of the copy.

    Args:
      option: its name.
      given: path of the file.
      sha256: what it held when it was read.
      most: bytes that it may have.
      there: path of the copy.
    """
    content = reading.data(Path(given), most)
    if hashlib.sha256(content).hexdigest() != sha256:
        raise ConfigError(f"{option}: {shown(given)} has changed since the run was begun")
    with files.replacing(there) as file:
        file.write(content)
    return str(there.resolve())
