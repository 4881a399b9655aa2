"""The files that make a model: which ones an MJCF or URDF names, what may be in them, and a copy of them all.

An MJCF file includes others, and any of them may say in which folders meshes and textures lie. Everything is read here
before MuJoCo reads it, so that a file that is none, that has no end or holds no numbers is refused in one line.
"""

import contextlib
import hashlib
import math
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, cast
from xml.etree import ElementTree

from icac_jax import reading
from icac_jax.console import shown
from icac_jax.fields import ConfigError

LARGEST = 2**30
"""Bytes of a mesh or a texture."""
_DEPTH = 200  # MuJoCo's own reader goes down element by element
_MOST_FILES = 5000
_FOLDERS = ("meshdir", "texturedir", "assetdir")
_NAMES = ("name", "class", "childclass", "joint", "site", "body", "geom", "mesh", "material", "texture", "model")
_PACKAGE = "package://"


class _Reference(NamedTuple):
    """An attribute that names a file.

    Attributes:
      tag: of its element.
      value: as it is written.
      file: the file; a name that two folders have stands for two.
    """

    tag: str
    value: str
    file: Path


def elements(path: Path) -> list[ElementTree.Element]:
    """Every element of an XML file, the root first.

    Raises:
      ConfigError: it cannot be read, is no XML, or goes beyond what is read.
    """
    try:
        content = reading.data(path)
    except OSError as error:
        raise ConfigError(f"model: cannot read {shown(path)}: {error.strerror or error}") from error
    if b"<!ENTITY" in content:
        raise ConfigError(f"model: {shown(path)}: must declare no entities")
    parser = ElementTree.XMLPullParser(("start", "end"))
    found: list[ElementTree.Element] = []
    depth = 0
    try:
        parser.feed(content)
        parser.close()
        for event, node in cast("Iterator[tuple[str, ElementTree.Element]]", parser.read_events()):
            depth += 1 if event == "start" else -1
            if event == "start":
                found.append(node)
            if depth > _DEPTH:
                raise ConfigError(f"model: {shown(path)}: nested too deeply")
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise ConfigError(f"model: {shown(path)} is not valid XML: {shown(error)}") from error
    for node in found:
        for key, value in node.attrib.items():
            if key not in _NAMES and "nan" in value.lower() and _has_nan(value):
                raise ConfigError(f"model: {shown(path)}: {node.tag} {key}: must be numbers, got {shown(repr(value))}")
    return found


def _has_nan(value: str) -> bool:
    try:
        return any(math.isnan(float(word)) for word in value.split())
    except ValueError:
        return False


class ModelFiles:
    """A model file and all files it names: included ones, models, meshes, textures, height fields.

    Args:
      model: the MJCF or URDF file.

    Attributes:
      files: all of them, the model first; as they are named, so that moving all together changes nothing.

    Raises:
      ConfigError: one of those that are XML cannot be read or is not valid.
    """

    def __init__(self, model: Path) -> None:
        self.model = model
        self._parts: dict[Path, list[ElementTree.Element]] = {}
        self._read(model)
        self._folders = [model.parent]
        for part in list(self._parts.values()):
            self._folders += self._asked(part)
        self.files = list(self._parts)
        for part in list(self._parts):
            for reference in self.references(part):
                if reference.file not in self.files:
                    self.files.append(reference.file)
        if len(self.files) > _MOST_FILES:
            raise ConfigError(f"model: {shown(model)}: names more than {_MOST_FILES} files")

    def _asked(self, part: list[ElementTree.Element]) -> list[Path]:
        """Folders of meshes and textures; whichever file says so, relative to the model itself."""
        nodes = [node for node in part if node.tag in ("compiler", "mujoco")]
        return [self.model.parent / value for node in nodes for key in _FOLDERS if (value := node.get(key))]

    def _read(self, path: Path) -> None:
        """A file and those that it includes, each once; that one includes itself is left for MuJoCo to say."""
        waiting = [path]
        while waiting:
            part = waiting.pop()
            if any(_same(part, known) for known in self._parts):
                continue
            self._parts[part] = elements(part)
            if len(self._parts) > _MOST_FILES:
                raise ConfigError(f"model: {shown(self.model)}: includes more than {_MOST_FILES} files")
            for node in self._parts[part]:
                if node.tag in ("include", "model") and (name := node.get("file")):
                    waiting += _found(name, [self.model.parent, part.parent])

    def references(self, part: Path) -> Iterator[_Reference]:
        """The attributes of one of the XML files that name a file."""
        for node in self._parts[part]:
            folders = [self.model.parent, part.parent] if node.tag in ("include", "model") else self._folders
            folders = [*folders, *([part.parent] if part.parent not in folders else [])]
            for key, value in node.attrib.items():
                if key.startswith("file") and value:
                    yield from (_Reference(node.tag, value, file) for file in _found(value, folders))

    def checksum(self, before: tuple[Path, ...] = ()) -> str:
        """SHA-256 over some other files and all of these; paths do not count, but for the order.

        Raises:
          ConfigError: one cannot be read.
        """
        digest = hashlib.sha256()
        try:
            for file in [*before, *sorted(self.files)]:
                digest.update(hashlib.sha256(reading.data(file, LARGEST)).digest())
        except OSError as error:
            raise ConfigError(f"model: cannot read {shown(error.filename)}: {error.strerror or error}") from error
        return digest.hexdigest()

    def copy(self, into: Path, main: Path) -> Path:
        """Copies all files, each where it was relative to the others; a whole path in the model becomes a relative one.

        Args:
          into: a new folder.
          main: the file that the arm is named by: the model itself or a TOML file that names it.

        Returns:
          The copy of `main`.

        Raises:
          OSError: something cannot be read or written.
        """
        files = [Path(os.path.normpath(file)) for file in dict.fromkeys([main, *self.files])]
        root = Path(os.path.commonpath([file.parent for file in files]))

        def place(file: Path) -> Path:
            return into / Path(os.path.normpath(file)).relative_to(root)

        for file in files:
            place(file).parent.mkdir(parents=True, exist_ok=True)
            with reading.regular(file) as source, open(place(file), "wb") as target:
                shutil.copyfileobj(source, target)
        for part in self._parts:
            content = reading.data(part)
            changed = content
            for old, new in self._whole_paths(part, place):
                for quote in (b'"', b"'"):
                    changed = changed.replace(quote + old.encode() + quote, quote + new.encode() + quote)
            if changed != content:
                place(part).write_bytes(changed)
        return place(main)

    def _whole_paths(self, part: Path, place: Callable[[Path], Path]) -> Iterator[tuple[str, str]]:
        """What stands for whole paths in the copy of an XML file: as written, and as it is to be written."""
        model = place(self.model).parent
        said = {key: value for nodes in self._parts.values() for node in nodes for key, value in _said(node)}
        for node in self._parts[part]:
            for _, value in _said(node):
                if Path(value).is_absolute() and _inside(Path(value), self.files):
                    yield value, os.path.relpath(place(_slashed(value)), model)
        for tag, value, file in self.references(part):
            if not Path(value).is_absolute():
                continue
            key = "texturedir" if tag == "texture" else "meshdir"
            folder = said.get(key, said.get("assetdir", "")) if tag not in ("include", "model") else ""
            whole = place(self.model.parent / folder) if folder and _inside(Path(folder), self.files) else model
            yield value, os.path.relpath(place(file), whole)


def _said(node: ElementTree.Element) -> list[tuple[str, str]]:
    """What a `<compiler>` says of folders."""
    return [(key, node.attrib[key]) for key in _FOLDERS if node.tag == "compiler" and node.get(key)]


def _slashed(folder: str) -> Path:
    return Path(os.path.normpath(folder))


def _inside(folder: Path, files: list[Path]) -> bool:
    """Whether some file lies in a folder; a relative one is of the model, and so it does."""
    return not folder.is_absolute() or any(_slashed(str(folder)) in Path(os.path.normpath(f)).parents for f in files)


def _found(name: str, folders: list[Path]) -> list[Path]:
    """The files of this name in these folders; what is there may be none that can be read."""
    names = [name]
    if name.startswith(_PACKAGE):  # of a URDF: MuJoCo takes the last part
        names = [name.removeprefix(_PACKAGE), name.rpartition("/")[2]]
    found = []
    for candidate in dict.fromkeys(folder / one for folder in folders for one in names):
        with contextlib.suppress(OSError, ValueError):
            if candidate.exists() and not candidate.is_dir():
                found.append(candidate)
    return found


def _same(one: Path, other: Path) -> bool:
    return os.path.normpath(one) == os.path.normpath(other)
