"""Sweep files: TOML becomes a study, or one line that says which table and key is wrong."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from icac_jax import reading
from icac_jax.fields import ConfigError
from icac_jax.settings.options import all_options, of_learner, owners, resolve
from icac_jax.sweeps import axes, file_draws, file_values, wandb_file
from icac_jax.sweeps.study import EXPECTATIONS, TABLES, Study

_KEYS = ("claim", "expect", *TABLES)

# Where the studies lie that come with the package: in it, or beside it in a source checkout.
_PACKAGE = Path(__file__).resolve().parents[1]
_SHIPPED = (_PACKAGE / "sweeps", _PACKAGE.parent / "sweeps")


def find(name: Path) -> Path:
    """The sweep file of this name: a file, or else one of the studies that come with the package.

    Args:
      name: path of a file, or a shipped study without its suffix, such as "gamma".

    Raises:
      ConfigError: there is neither.
    """
    if name.exists() or name.suffix or len(name.parts) != 1:
        return name  # `read` says what is wrong with it
    shipped = {path.stem: path for folder in _SHIPPED for path in sorted(folder.glob("*.toml"))}
    if name.name not in shipped:
        known = ", ".join(sorted(shipped)) or "none"
        raise ConfigError(
            f"file: there is no file {name}, and no such study among {known}{file_values.hint(name.name, shipped)}"
        )
    return shipped[name.name]


def read(path: Path, warn: Callable[[str], None] = lambda _: None, **changed: Any) -> Study:
    """The study in a sweep file.

    Args:
      path: of the file; one that ends in .yaml is taken for one of Weights & Biases, see `wandb_file`.
      warn: told, in a line, what of such a file was not taken over.
      changed: options of [base] given on the command line instead.

    Raises:
      ConfigError: it cannot be read or something in it is not allowed; one line names file, table and key.
    """
    try:
        text = reading.text(path)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"file: cannot read {path}: {reason}") from error
    try:
        if path.suffix in wandb_file.SUFFIXES:
            tables, notes = wandb_file.tables(text)
            if notes:
                warn(f"{path}: {notes}")
            return _study(tables, changed)
        return parse(text, **changed)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def parse(text: str, **changed: Any) -> Study:
    """The study in the text of a sweep file; arguments and errors as in `read`."""
    try:
        tables = reading.parsed_toml(text)
    except ValueError as error:
        raise ConfigError(f"not valid TOML: {error}") from error
    try:
        return _study(tables, changed)
    except ConfigError:
        raise
    except ValueError as error:  # Python does not print whole numbers of thousands of digits
        raise ConfigError(f"a number has too many digits ({error})") from error


def _study(tables: dict[str, Any], changed: dict[str, Any]) -> Study:
    for name in tables:
        if name not in _KEYS:
            raise ConfigError(
                f"{file_values.key(name)}: no such table, must be one of {', '.join(_KEYS)}"
                f"{file_values.hint(name, _KEYS)}"
            )
    claim, expect = tables.get("claim"), tables.get("expect")
    if claim is not None and (not isinstance(claim, str) or not claim.strip()):
        raise ConfigError(f"claim: must be the claim or question in words, got {claim!r}")
    if expect is not None and expect not in EXPECTATIONS:
        raise ConfigError(f"expect: must be one of {', '.join(EXPECTATIONS)}, got {expect!r}")
    for name in TABLES:
        if not isinstance(tables.get(name, {}), dict):
            raise ConfigError(f"{name}: must be a table, got {tables[name]!r}")
    base = dict(tables.get("base", {})) | changed
    for name, value in base.items():
        file_values.known("base", name)
        base[name] = file_values.checked("base", name, value)
    found = [
        tuple({name: value} for value in file_values.different("grid", name, values))
        for name, values in tables.get("grid", {}).items()
    ]
    found += _zipped(tables.get("zip", {}))
    found += file_draws.random_axis(tables.get("random"))
    search, halving = file_draws.search(tables.get("search")), file_draws.halving(tables.get("halving"))
    names = [name for axis in found for name in axis[0]] + [d.option for d in (search.distributions if search else ())]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{name}: must be varied in one place only")
        if name in tables.get("base", {}):
            raise ConfigError(f"[base] {name}: must be in one place, it is varied too")
        if name in changed:
            raise ConfigError(f"{name}: must not be given, the file varies it")
    if search and found:
        raise ConfigError("[search]: must stand alone, without grid, zip and random")
    number = math.prod(len(axis) for axis in found)
    if number > file_values.MOST_CELLS:
        raise ConfigError(f"cells: must be at most {file_values.MOST_CELLS:,}, the tables make {number:,}")
    reference = _reference(tables.get("reference", {}), names, found)
    if expect is not None and not reference:
        raise ConfigError("[reference]: must name the values that the others are compared with, because of expect")
    title = claim.strip() if claim else f"Sweep over {', '.join(names)}" if names else "One cell"
    study = Study(title, base, tuple(found), search, expect, reference, tables | {"base": base}, halving)
    _check_owners(study, names)
    _check_base(study)
    _check_halving(study, names, number)
    return study


def _check_owners(study: Study, varied: list[str]) -> None:
    """Refuses an option that none of the study's learners has."""
    algos = study.learners
    trained = ", ".join(sorted(algos))
    for table, names in (("[base] ", study.base), ("", varied)):
        for name in names:
            having = owners(name)
            if having and not algos & set(having):
                raise ConfigError(f"{table}{name}: no option of {trained}, only of {', '.join(having)}")
            only = all_options()[name].metadata["only"]
            if only is not None and not any(value in only[1] for value in _taken(study, only[0])):
                said = ", ".join(map(str, _taken(study, only[0])))
                raise ConfigError(f"{table}{name}: no option of the {only[0]} {said}, only of {', '.join(only[1])}")


def _taken(study: Study, name: str) -> list[Any]:
    """The values that an option has in the cells of a study."""
    found = [part[name] for axis in study.axes for part in axis if name in part]
    drawn = study.search.distributions if study.search else ()
    found += [choice for one in drawn if one.option == name for choice in one.choices or ()]
    return list(dict.fromkeys(found)) or [study.base.get(name, all_options()[name].default)]


def _check_base(study: Study) -> None:
    """Names [base] where its options contradict each other; what only some cells have is left to the cells."""
    first = {name: value for axis in study.axes for name, value in axis[0].items()}
    if study.search:
        first = {one.option: one.choices[0] if one.choices else one.low for one in study.search.distributions}
    said = []
    for options in (study.base, study.base | first):
        try:
            resolve(**of_learner(options))
            return
        except ConfigError as error:
            said.append(str(error))
    if said[0] == said[1]:
        raise ConfigError(f"[base] {said[0]}")


def _reference(table: dict[str, Any], names: list[str], parts_of: list[tuple[dict[str, Any], ...]]) -> dict[str, Any]:
    """The values of [reference], which some cell must have."""
    reference = {}
    for name, value in table.items():
        file_values.known("reference", name)
        if name not in names or not parts_of:
            raise ConfigError(f"[reference] {name}: must be an option that grid, zip or random varies")
        reference[name] = file_values.checked("reference", name, value)
    for axis in parts_of:
        wanted = {name: value for name, value in reference.items() if name in axis[0]}
        missing = [name for name in axis[0] if name not in wanted]
        if wanted and missing:
            raise ConfigError(f"[reference] {missing[0]}: must be given, it varies together with {next(iter(wanted))}")
        if wanted and not any(wanted.items() <= part.items() for part in axis):
            values = " ".join(f"{name}={axes.short(value)}" for name, value in wanted.items())
            raise ConfigError(f"[reference] {next(iter(wanted))}: no cell has {values}")
    return reference


def _zipped(table: dict[str, Any]) -> list[tuple[dict[str, Any], ...]]:
    """One axis of lists side by side; a value may repeat in it."""
    if not table:
        return []
    lengths = {name: len(file_values.listed("zip", name, values)) for name, values in table.items()}
    first = next(iter(lengths))
    for name, length in lengths.items():
        if length != lengths[first]:
            raise ConfigError(f"[zip] {name}: must have {lengths[first]} values as {first} has, got {length}")
    rows = zip(
        *([file_values.checked("zip", name, value) for value in values] for name, values in table.items()), strict=True
    )
    return [tuple(dict(zip(table, row, strict=True)) for row in rows)]


def _check_halving(study: Study, varied: list[str], cells: int) -> None:
    """Refuses halving that would halve nothing, or of cells that cannot be compared."""
    if study.halving is None:
        return
    if study.search or study.expect:
        raise ConfigError(f"[halving]: must be without {'search' if study.search else 'expect'}")
    for name in ("episodes", "seeds"):
        if name in varied:
            raise ConfigError(f"[halving]: must be without varied {name}, cells are compared at equal {name}")
    factor, episodes = study.halving.factor, resolve(**of_learner(study.base)).run.episodes
    if cells < factor:
        raise ConfigError(f"[halving] factor: must be at most the number of cells, {cells}, got {factor}")
    if len(study.halving.rungs(episodes)) < 2:
        raise ConfigError(
            f"[halving] min_episodes: must be at most {episodes // factor}, the episodes {episodes} over the factor "
            f"{factor}, got {study.halving.min_episodes}"
        )
