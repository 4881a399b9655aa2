"""Sweep files: a study in TOML becomes a list of cells, each one setting of every option."""

import difflib
import itertools
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from icac_jax import reading
from icac_jax.fields import ConfigError, allowed, check_field
from icac_jax.settings import arm_files
from icac_jax.settings.options import COMMON, Settings, all_options, of_learner, owners, resolve, typed
from icac_jax.sweeps import axes
from icac_jax.sweeps.axes import Axis

MOST_CELLS = 10_000
_TABLES = ("claim", "expect", "reference", "base", "grid", "zip", "random", "search")
# What the claim expects of the cells, against the one with the values in [reference]; see `verdicts`.
EXPECTATIONS = ("no_difference", "no_gain")
# What the tables [random] and [search] hold beside distributions.
_RANDOM_KEYS = {"draws": 20, "seed": 0}
_SEARCH_KEYS = {"trials": 32, "batch": 8, "seed": 0, "metric": "steps"}
# Metrics of a cell that a search can follow, and whether more is better.
OBJECTIVES = {"success_rate": True, "steps": False, "extrinsic_reward": True}

# Where the studies lie that come with the package: in it, or beside it in a source checkout.
_PACKAGE = Path(__file__).resolve().parents[2]
_SHIPPED = (_PACKAGE / "sweeps", _PACKAGE.parent / "sweeps")


class Cell(NamedTuple):
    """One setting of a study.

    Attributes:
      number: its place in the study, from 0.
      varied: the options that differ between cells, by name, with this cell's values.
      settings: all of its settings.
      name: what varies, in words, such as "algo=icac gamma=0.9".
    """

    number: int
    varied: dict[str, Any]
    settings: Settings
    name: str


class Distribution(NamedTuple):
    """What a value is drawn from.

    Attributes:
      option: the name of the option.
      low: least value; not used with choices.
      high: largest value; not used with choices.
      log: drawn uniformly in the logarithm.
      choices: the values to choose from, or None.
    """

    option: str
    low: float
    high: float
    log: bool
    choices: tuple[Any, ...] | None

    @property
    def whole(self) -> bool:
        """Whether the option is a whole number."""
        return all_options()[self.option].type is int

    def draw(self, rng: np.random.Generator) -> Any:
        """One value."""
        if self.choices is not None:
            return self.choices[int(rng.integers(len(self.choices)))]
        if self.log:
            value = math.exp(rng.uniform(math.log(self.low), math.log(self.high)))
            return min(max(round(value), int(self.low)), int(self.high)) if self.whole else value
        return (
            int(rng.integers(int(self.low), int(self.high) + 1))
            if self.whole
            else float(rng.uniform(self.low, self.high))
        )


class Search(NamedTuple):
    """A search instead of a list of cells.

    Attributes:
      distributions: what is varied.
      trials: cells tried in all.
      batch: cells tried together, between which the search learns.
      seed: of the search.
      metric: what is improved, a key of `OBJECTIVES`.
    """

    distributions: tuple[Distribution, ...]
    trials: int
    batch: int
    seed: int
    metric: str


class Study(NamedTuple):
    """What a sweep file says.

    Attributes:
      claim: the claim or question in words.
      base: options that all cells share.
      axes: lists of partial settings; the cells are their product.
      search: how cells are found instead of listed, or None.
      expect: what the claim expects, one of `EXPECTATIONS`, or None.
      reference: the values of varied options that the others are compared with, such as the paper's.
      tables: the file's tables, with what was changed on the command line.
    """

    claim: str
    base: dict[str, Any]
    axes: tuple[tuple[dict[str, Any], ...], ...]
    search: Search | None
    expect: str | None
    reference: dict[str, Any]
    tables: dict[str, Any]

    @property
    def text(self) -> str:
        """A sweep file that gives this study."""
        return tomli_w.dumps(self.tables)

    def cells(self) -> list[Cell]:
        """Every cell of a study without a search, in the order of the file.

        Raises:
          ConfigError: a combination is not valid; the line names the cell.
        """
        found = []
        for number, parts in enumerate(itertools.product(*self.axes)):
            varied = {name: value for part in parts for name, value in part.items()}
            found.append(self.cell(number, varied))
        return found

    def cell(self, number: int, varied: dict[str, Any]) -> Cell:
        """The cell with these values."""
        name = self._name(varied)
        try:
            return Cell(number, varied, resolve(**of_learner(self.base | varied)), name)
        except ConfigError as error:
            raise ConfigError(f"cell {number} ({name}): {error}") from error

    def _name(self, varied: dict[str, Any]) -> str:
        drawn = self.tables.get("random", {})
        words = []
        for parts in self.axes:
            mine = {name: varied[name] for name in parts[0]}
            if len(mine) > 1 and next(iter(mine)) in drawn:
                words += [f"{name}={axes.short(value)}" for name, value in mine.items()]
            else:
                words.append(axes.name(mine, parts))
        if self.search:
            words = [f"{name}={axes.short(value)}" for name, value in varied.items()]
        return " ".join(words) or "base"

    def varying(self, cells: Sequence[dict[str, Any]]) -> list[Axis]:
        """The axes of the study, for tables and figures.

        Args:
          cells: what varies, `Cell.varied` of each cell in order.
        """
        if self.search:
            return [
                axes.drawn(one.option, [varied[one.option] for varied in cells]) for one in self.search.distributions
            ]
        found = []
        places = np.unravel_index(np.arange(len(cells)), [len(parts) for parts in self.axes]) if self.axes else []
        for parts, place in zip(self.axes, places, strict=True):
            if next(iter(parts[0])) in self.tables.get("random", {}):
                found += [axes.drawn(name, [varied[name] for varied in cells]) for name in parts[0]]
            elif len(parts) > 1:
                found.append(axes.listed(parts, place))
        return found


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


def read(path: Path, **changed: Any) -> Study:
    """The study in a sweep file.

    Args:
      path: of the file.
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
        if name not in _TABLES:
            raise ConfigError(f"{_key(name)}: no such table, must be one of {', '.join(_TABLES)}{_hint(name, _TABLES)}")
    claim, expect = tables.get("claim", ""), tables.get("expect")
    if not isinstance(claim, str) or not claim.strip():
        raise ConfigError(f"claim: must be the claim or question in words, got {claim!r}")
    if expect is not None and expect not in EXPECTATIONS:
        raise ConfigError(f"expect: must be one of {', '.join(EXPECTATIONS)}, got {expect!r}")
    for name in _TABLES[2:]:
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
    study = Study(claim.strip(), base, tuple(found), search, expect, reference, tables | {"base": base})
    _check_owners(study, names)
    _check_base(study)
    return study


def _check_owners(study: Study, varied: list[str]) -> None:
    """Refuses an option that none of the study's learners has."""
    drawn = study.search.distributions if study.search else ()
    algos = {part["algo"] for axis in study.axes for part in axis if "algo" in part}
    algos |= {choice for one in drawn if one.option == "algo" for choice in one.choices or ()}
    algos = algos or {study.base.get("algo", COMMON["algo"].default)}
    for table, names in (("[base] ", study.base), ("", varied)):
        for name in names:
            having = owners(name)
            if having and not algos & set(having):
                raise ConfigError(
                    f"{table}{name}: no option of {', '.join(sorted(algos))}, only of {', '.join(having)}"
                )


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


def _checked(table: str, name: str, value: Any) -> Any:
    """A value of an option, as a number of the option's own kind."""
    value = typed(name, value)
    try:
        check_field(all_options()[name], value)
    except ConfigError as error:
        raise ConfigError(f"[{table}] {error}") from error
    # The sweep can be resumed from another folder than the one it was begun in.
    return arm_files.whole(value) if name == "arm" else value


def _values(table: str, name: str, values: Any) -> list[Any]:
    _known(table, name)
    if not isinstance(values, list) or not values:
        raise ConfigError(f"[{table}] {name}: must be a list of at least one value, got {values!r}")
    checked = [_checked(table, name, value) for value in values]
    for place, value in enumerate(checked):
        if value in checked[:place]:
            raise ConfigError(f"[{table}] {name}: must not hold a value twice, got {axes.short(value)} again")
    return checked


def _zipped(table: dict[str, Any]) -> list[tuple[dict[str, Any], ...]]:
    """One axis of lists side by side; a value may repeat in it."""
    if not table:
        return []
    lengths = {}
    for name, values in table.items():
        _known("zip", name)
        if not isinstance(values, list) or not values:
            raise ConfigError(f"[zip] {name}: must be a list of at least one value, got {values!r}")
        lengths[name] = len(values)
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
        raise ConfigError(f"[{table}] {name}: {wanted}; the option is {allowed(all_options()[name])}")
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
    rng = np.random.default_rng(seed)
    return [tuple({one.option: one.draw(rng) for one in found} for _ in range(draws))]


def _search(table: dict[str, Any] | None) -> Search | None:
    if table is None:
        return None
    numbers = {
        name: _number("search", name, table.get(name, _SEARCH_KEYS[name]), low)
        for name, low in (("trials", 1), ("batch", 1), ("seed", 0))
    }
    metric = table.get("metric", _SEARCH_KEYS["metric"])
    if metric not in OBJECTIVES:
        raise ConfigError(f"[search] metric: must be one of {', '.join(OBJECTIVES)}, got {metric!r}")
    return Search(_distributions("search", table, _SEARCH_KEYS), metric=metric, **numbers)


def differences(one: Study, other: Study) -> list[str]:
    """What two studies do not share, as "[table] key" in the order of the first; the claim's words do not count."""
    found = []
    if one.expect != other.expect:
        found.append("expect")
    for table in _TABLES[2:]:
        first, second = (study.tables.get(table, {}) for study in (one, other))
        found += [f"[{table}] {key}" for key in first | second if first.get(key) != second.get(key)]
    return found
