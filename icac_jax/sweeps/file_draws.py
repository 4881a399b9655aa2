"""The tables of a sweep file that draw, search and halve."""

import math
from typing import Any

from icac_jax.fields import ConfigError
from icac_jax.settings.options import all_options
from icac_jax.sweeps import distributions, file_values
from icac_jax.sweeps.distributions import SAMPLERS, Distribution, Search
from icac_jax.sweeps.halving import Halving
from icac_jax.sweeps.study import OBJECTIVES

_RANDOM, _SEARCH, _HALVING = (file_values.KEYS[name] for name in ("random", "search", "halving"))


def _number(table: str, name: str, value: Any, low: int) -> int:
    high = file_values.MOST_CELLS if low else 2**32 - 1  # of cells, or a seed
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ConfigError(f"[{table}] {name}: must be a whole number at least {low} and at most {high}, got {value!r}")
    return value


def _distribution(table: str, name: str, given: Any) -> Distribution:
    file_values.known(table, name)
    wanted = "must be {low = L, high = H}, perhaps with log = true, or {choices = [...]}"
    if not isinstance(given, dict) or not given or not set(given) <= {"low", "high", "log", "choices"}:
        raise ConfigError(f"[{table}] {name}: {wanted}, got {given!r}")
    if "choices" in given:
        if len(given) > 1:
            raise ConfigError(f"[{table}] {name}: {wanted}, got both")
        return Distribution(name, 0.0, 0.0, False, tuple(file_values.different(table, name, given["choices"])))
    if all_options()[name].type not in (int, float) or not {"low", "high"} <= set(given):
        raise ConfigError(f"[{table}] {name}: {wanted}; the option is {file_values.words(name)}")
    low, high = (file_values.checked(table, name, given[end]) for end in ("low", "high"))
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


def random_axis(table: dict[str, Any] | None) -> list[tuple[dict[str, Any], ...]]:
    """One axis of random draws; crossed with the rest, so that every algorithm sees the same ones."""
    if table is None:
        return []
    draws = _number("random", "draws", table.get("draws", _RANDOM["draws"]), 1)
    seed = _number("random", "seed", table.get("seed", _RANDOM["seed"]), 0)
    found = _distributions("random", table, _RANDOM)
    sampler = table.get("sampler", _RANDOM["sampler"])
    if sampler not in SAMPLERS:
        raise ConfigError(f"[random] sampler: must be one of {', '.join(SAMPLERS)}, got {sampler!r}")
    return [tuple(distributions.draws(found, draws, seed, sampler))]


def halving(table: dict[str, Any] | None) -> Halving | None:
    """What [halving] says; None where there is none."""
    if table is None:
        return None
    for name in table:
        if name not in _HALVING:
            raise ConfigError(f"[halving] {file_values.key(name)}: no such key{file_values.hint(name, _HALVING)}")
    if "min_episodes" not in table:
        raise ConfigError("[halving] min_episodes: must be given, the least episodes that a cell trains for")
    least = _number("halving", "min_episodes", table["min_episodes"], 1)
    factor = _number("halving", "factor", table.get("factor", _HALVING["factor"]), 2)
    return Halving(least, factor, _metric("halving", table))


def _metric(table: str, given: dict[str, Any]) -> str:
    metric = given.get("metric", "steps")
    if not isinstance(metric, str) or metric not in OBJECTIVES:
        raise ConfigError(f"[{table}] metric: must be one of {', '.join(OBJECTIVES)}, got {metric!r}")
    return metric


def search(table: dict[str, Any] | None) -> Search | None:
    """What [search] says; None where there is none."""
    if table is None:
        return None
    numbers = {
        name: _number("search", name, table.get(name, _SEARCH[name]), low)
        for name, low in (("trials", 1), ("batch", 1), ("seed", 0))
    }
    metric = _metric("search", table)
    return Search(_distributions("search", table, _SEARCH), metric=metric, **numbers)
