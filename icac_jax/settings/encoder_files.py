"""Files of encoders: an archive of NumPy arrays with what they are in JSON, and a checksum over all of it.

What is read here is written by `runs.encoders`; every way in which a file can be wrong is a line.
"""

import dataclasses
import functools
import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from icac_jax import reading, shapes
from icac_jax.console import shown
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.embedding import PARTS, SCALE, Embedding, EncoderOptions, Weights, embedding_size
from icac_jax.fields import ConfigError
from icac_jax.settings import named_files
from icac_jax.settings.run_options import CameraOptions

_OPTION = "encoder"
META = "meta"
FORMAT = 1
MOST = 2**28
_SHAPE = shapes.record(
    {
        "format": shapes.whole,
        "arm": shapes.text,
        "sha256": shapes.text,
        "shape": shapes.several(shapes.whole),
        "options": shapes.mapping(shapes.anything),
        "facts": shapes.mapping(shapes.anything),
    }
)


def whole(name: Any) -> Any:
    """The option `encoder` with the whole path of a file, the same wherever the command is called."""
    return str(Path(name).expanduser().resolve()) if isinstance(name, str) and name else name


def digest(meta: dict[str, Any], arrays: dict[str, np.ndarray]) -> str:
    """Checksum of all that a file says: of what it is, its own checksum left out, and of its arrays."""
    found = hashlib.sha256(json.dumps({**meta, "sha256": ""}, sort_keys=True).encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        found.update(f"{name} {array.dtype.str} {array.shape}".encode())
        found.update(array.tobytes())
    return found.hexdigest()


def found(options: CameraOptions, arm: ArmSpec) -> CameraOptions:
    """The options with the whole path and the checksum of their file, which is read if it has none yet.

    Args:
      options: as said; those without a file come back unchanged.
      arm: of the run.

    Raises:
      ConfigError: the file cannot be read, is damaged or is of another arm.
    """
    if not options.encoder:
        return options
    path = Path(whole(options.encoder))
    if options.encoder_sha256:  # of a run that was begun: its copy is read where it is needed
        return dataclasses.replace(options, encoder=str(path))
    options = CameraOptions(str(path), named_files.checksum(named_files.content(_OPTION, path, MOST)))
    read(options, arm)
    return options


def read(options: CameraOptions, arm: ArmSpec) -> Embedding:
    """The encoder of a run.

    Args:
      options: of the run, with path and checksum of the file.
      arm: of the run.

    Raises:
      ConfigError: the file cannot be read, has changed, is damaged or is of another arm.
    """
    named_files.content(_OPTION, Path(options.encoder), MOST, options.encoder_sha256)  # is still what it was
    embedding = _read(options.encoder, options.encoder_sha256)
    if embedding.arm != arm.name:
        raise ConfigError(f"encoder: must be of {arm.name}, {shown(options.encoder)} is of {shown(embedding.arm)}")
    return embedding


@functools.lru_cache(maxsize=8)
def _read(name: str, sha256: str) -> Embedding:
    """What a file holds; kept by its checksum."""
    path = Path(name)
    with named_files.parsing(_OPTION, path, "encoder"):
        return _parsed(named_files.content(_OPTION, path, MOST, sha256))


def _parsed(content: bytes) -> Embedding:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        if sum(member.file_size for member in archive.infolist()) > MOST:
            raise ValueError(f"it holds more than {MOST >> 20} MiB")
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        meta = reading.parsed_json(archive[META].tobytes())
        arrays = {name: archive[name] for name in archive.files if name != META}
    if not shapes.fits(_SHAPE, meta) or meta["format"] != FORMAT or len(meta["shape"]) != 3:
        raise ValueError("no description by icac encode")
    if digest(meta, arrays) != meta["sha256"]:
        raise ValueError("its checksum is another")
    options, shape = EncoderOptions(**meta["options"]), tuple(meta["shape"])
    weights: dict[str, Weights] = {
        part: {name.removeprefix(f"{part}/"): array for name, array in arrays.items() if name.startswith(f"{part}/")}
        for part in PARTS
    }
    for part in PARTS:
        if any(weights[part][name].shape != (embedding_size(options, shape),) for name in SCALE):
            raise ValueError(f"its {part} has a scale of another size")
    if not all(np.all(np.isfinite(array)) for array in arrays.values()):
        raise ValueError("it has numbers that are not finite")
    return Embedding(options, meta["arm"], shape, weights, meta["facts"])
