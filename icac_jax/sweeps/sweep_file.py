"""Sweep files: TOML becomes a study, or one line that says which table and key is wrong."""

import difflib
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from icac_jax import reading
from icac_jax.agents import registry
from icac_jax.fields import ConfigError, allowed, check_field
from icac_jax.settings import arm_files, demonstration_files, encoder_files
from icac_jax.settings.options import all_options, learner_of, of_learner, owners, resolve, typed
from icac_jax.sweeps import axes, distributions, wandb_file
from icac_jax.sweeps.distributions import SAMPLERS, Distribution, Search
from icac_jax.sweeps.study import EXPECTATIONS, OBJECTIVES, TABLES, Study

MOST_CELLS = 10_000
_KEYS = ("claim", "expect", *TABLES)
# Options that name a file, with what gives its whole path.
_WHOLE = {"arm": arm_files.whole, "demonstrations": demonstration_files.whole, "encoder": encoder_files.whole}
# What the tables [random] and [search] hold beside distributions.
_RANDOM_KEYS = {"draws": 20, "seed": 0, "sampler": "random"}
_SEARCH_KEYS = {"trials": 32, "batch": 8, "seed": 0, "metric": "steps"}

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
        raise ConfigError(f"file: there is no file {name}, and no such study among {known}{_hint(name.name, shipped)}")
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
            raise ConfigError(f"{_key(name)}: no such table, must be one of {', '.join(_KEYS)}{_hint(name, _KEYS)}")
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
        _known("base", name)
        base[name] = _checked("base", name, value)
    found = [
        tuple({name: value} for value in _values("grid", name, values))
        for name, values in tables.get("grid", {}).items()
    ]
    found += _zipped(tables.get("zip", {}))
    found += _random(tables.get("random"))
    search = _search(tables.get("search"))
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
    if number > MOST_CELLS:
        raise ConfigError(f"cells: must be at most {MOST_CELLS:,}, the tables make {number:,}")
    reference = _reference(tables.get("reference", {}), names, found)
    if expect is not None and not reference:
        raise ConfigError("[reference]: must name the values that the others are compared with, because of expect")
    title = claim.strip() if claim else f"Sweep over {', '.join(names)}" if names else "One cell"
    study = Study(title, base, tuple(found), search, expect, reference, tables | {"base": base})
    _check_owners(study, names)
    _check_base(study)
    return study


def _check_owners(study: Study, varied: list[str]) -> None:
    """Refuses an option that none of the study's learners has."""
    drawn = study.search.distributions if study.search else ()
    algos = {part["algo"] for axis in study.axes for part in axis if "algo" in part}
    algos |= {choice for one in drawn if one.option == "algo" for choice in one.choices or ()}
    if not algos:  # a preset may name the learner
        presets = [part for axis in study.axes for part in axis if "preset" in part] or [{}]
        algos = {learner_of(study.base | {name: part[name] for name in part if name == "preset"}) for part in presets}
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
        _known("reference", name)
        if name not in names or not parts_of:
            raise ConfigError(f"[reference] {name}: must be an option that grid, zip or random varies")
        reference[name] = _checked("reference", name, value)
    for axis in parts_of:
        wanted = {name: value for name, value in reference.items() if name in axis[0]}
        missing = [name for name in axis[0] if name not in wanted]
        if wanted and missing:
            raise ConfigError(f"[reference] {missing[0]}: must be given, it varies together with {next(iter(wanted))}")
        if wanted and not any(wanted.items() <= part.items() for part in axis):
            values = " ".join(f"{name}={axes.short(value)}" for name, value in wanted.items())
            raise ConfigError(f"[reference] {next(iter(wanted))}: no cell has {values}")
    return reference


def _key(name: str) -> str:
    """A key of a file in one line."""
    return name if name.isprintable() else repr(name)


def _hint(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def _known(table: str, name: str) -> None:
    if name not in all_options():
        keys = {"random": _RANDOM_KEYS, "search": _SEARCH_KEYS}.get(table, {})
        raise ConfigError(f"[{table}] {_key(name)}: no such option{_hint(name, [*keys, *all_options()])}")


def _words(name: str) -> str:
    """What an option accepts, in words."""
    return "one of " + ", ".join(registry.learners()) if name == "algo" else allowed(all_options()[name])


def _checked(table: str, name: str, value: Any) -> Any:
    """A value of an option, as a number of the option's own kind."""
    if name.startswith("warm_map"):  # a sweep keeps no copy, and could not be resumed without the other run
        raise ConfigError(f"[{table}] {name}: must not be in a sweep; icac train takes it, a run at a time")
    value = typed(name, value)
    try:
        check_field(all_options()[name], value)
        if name == "algo":
            registry.find(value)
    except ConfigError as error:
        raise ConfigError(f"[{table}] {error}") from error
    # The sweep can be resumed from another folder than the one it was begun in.
    return _WHOLE[name](value) if name in _WHOLE else value


def _listed(table: str, name: str, values: Any) -> list[Any]:
    """What a table has for an option: a list of at least one value, not checked yet."""
    _known(table, name)
    if not isinstance(values, list) or not values:
        raise ConfigError(f"[{table}] {name}: must be a list of at least one value, got {values!r}")
    return values


def _values(table: str, name: str, values: Any) -> list[Any]:
    checked = [_checked(table, name, value) for value in _listed(table, name, values)]
    for place, value in enumerate(checked):
        if value in checked[:place]:
            raise ConfigError(f"[{table}] {name}: must not hold a value twice, got {axes.short(value)} again")
    return checked


def _zipped(table: dict[str, Any]) -> list[tuple[dict[str, Any], ...]]:
    """One axis of lists side by side; a value may repeat in it."""
    if not table:
        return []
    lengths = {name: len(_listed("zip", name, values)) for name, values in table.items()}
    first = next(iter(lengths))
    for name, length in lengths.items():
        if length != lengths[first]:
            raise ConfigError(f"[zip] {name}: must have {lengths[first]} values as {first} has, got {length}")
    rows = zip(*([_checked("zip", name, value) for value in values] for name, values in table.items()), strict=True)
    return [tuple(dict(zip(table, row, strict=True)) for row in rows)]


def _number(table: str, name: str, value: Any, low: int) -> int:
    high = MOST_CELLS if low else 2**32 - 1  # of cells, or a seed
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ConfigError(f"[{table}] {name}: must be a whole number at least {low} and at most {high}, got {value!r}")
    return value


def _distribution(table: str, name: str, given: Any) -> Distribution:
    _known(table, name)
    wanted = "must be {low = L, high = H}, perhaps with log = true, or {choices = [...]}"
    if not isinstance(given, dict) or not given or not set(given) <= {"low", "high", "log", "choices"}:
        raise ConfigError(f"[{table}] {name}: {wanted}, got {given!r}")
    if "choices" in given:
        if len(given) > 1:
            raise ConfigError(f"[{table}] {name}: {wanted}, got both")
        return Distribution(name, 0.0, 0.0, False, tuple(_values(table, name, given["choices"])))
    if all_options()[name].type not in (int, float) or not {"low", "high"} <= set(given):
        raise ConfigError(f"[{table}] {name}: {wanted}; the option is {_words(name)}")
    low, high = (_checked(table, name, given[end]) for end in ("low", "high"))
    log = given.get("log", False)
    if not isinstance(log, bool) or not math.isfinite(low) or not math.isfinite(high):
        raise ConfigError(f"[{table}] {name}: {wanted}, got {given!r}")
    if low >= high or (log and low <= 0):
        least = "greater than 0 and " if log else ""
        raise ConfigError(f"[{table}] {name}: low must be {least}less than high, got {low:g} and {high:g}")
    return Distribution(name, low, high, log, None)


def _distributions(table: str, given: dict[str, Any], keys: dict[str, Any]) -> tuple[Distribution, ...]:
    found = tuple(_distribution(table, name, value) for name, value in given.items() if name not in keys)
    if not found:
        raise ConfigError(f"[{table}]: must name at least one option to draw")
    return found


def _random(table: dict[str, Any] | None) -> list[tuple[dict[str, Any], ...]]:
    """One axis of random draws; crossed with the rest, so that every algorithm sees the same ones."""
    if table is None:
        return []
    draws = _number("random", "draws", table.get("draws", _RANDOM_KEYS["draws"]), 1)
    seed = _number("random", "seed", table.get("seed", _RANDOM_KEYS["seed"]), 0)
    found = _distributions("random", table, _RANDOM_KEYS)
    sampler = table.get("sampler", _RANDOM_KEYS["sampler"])
    if sampler not in SAMPLERS:
        raise ConfigError(f"[random] sampler: must be one of {', '.join(SAMPLERS)}, got {sampler!r}")
    return [tuple(distributions.draws(found, draws, seed, sampler))]


def _search(table: dict[str, Any] | None) -> Search | None:
    if table is None:
        return None
    numbers = {
        name: _number("search", name, table.get(name, _SEARCH_KEYS[name]), low)
        for name, low in (("trials", 1), ("batch", 1), ("seed", 0))
    }
    metric = table.get("metric", _SEARCH_KEYS["metric"])
    if not isinstance(metric, str) or metric not in OBJECTIVES:
        raise ConfigError(f"[search] metric: must be one of {', '.join(OBJECTIVES)}, got {metric!r}")
    return Search(_distributions("search", table, _SEARCH_KEYS), metric=metric, **numbers)
