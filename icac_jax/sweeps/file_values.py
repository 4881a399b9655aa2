"""Options and their values in a sweep file: what is not allowed is one line that names table and key."""

import difflib
from collections.abc import Iterable
from typing import Any

from icac_jax.agents import registry
from icac_jax.fields import ConfigError, allowed, check_field
from icac_jax.settings import arm_files, demonstration_files, encoder_files
from icac_jax.settings.options import all_options, typed
from icac_jax.sweeps import axes

# Options that name a file, with what gives its whole path.
_WHOLE = {"arm": arm_files.whole, "demonstrations": demonstration_files.whole, "encoder": encoder_files.whole}
MOST_CELLS = 10_000
# What the tables that draw hold beside distributions, with what is taken where they do not say it.
KEYS = {
    "random": {"draws": 20, "seed": 0, "sampler": "random"},
    "search": {"trials": 32, "batch": 8, "seed": 0, "metric": "steps"},
    "halving": {"min_episodes": None, "factor": 3, "metric": "steps"},
}


def key(name: str) -> str:
    """A key of a file in one line."""
    return name if name.isprintable() else repr(name)


def hint(name: str, among: Iterable[str]) -> str:
    """What may have been meant, for the end of a line; empty where nothing is near."""
    close = difflib.get_close_matches(name, among, n=1)
    return f"; did you mean {close[0]}?" if close else ""


def known(table: str, name: str) -> None:
    """Refuses what is no option."""
    if name not in all_options():
        keys = KEYS.get(table, {})
        raise ConfigError(f"[{table}] {key(name)}: no such option{hint(name, [*keys, *all_options()])}")


def words(name: str) -> str:
    """What an option accepts, in words."""
    return "one of " + ", ".join(registry.learners()) if name == "algo" else allowed(all_options()[name])


def checked(table: str, name: str, value: Any) -> Any:
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


def listed(table: str, name: str, values: Any) -> list[Any]:
    """What a table has for an option: a list of at least one value, not checked yet."""
    known(table, name)
    if not isinstance(values, list) or not values:
        raise ConfigError(f"[{table}] {name}: must be a list of at least one value, got {values!r}")
    return values


def different(table: str, name: str, values: Any) -> list[Any]:
    """The values of an option in a table that lists them, each once."""
    found = [checked(table, name, value) for value in listed(table, name, values)]
    for place, value in enumerate(found):
        if value in found[:place]:
            raise ConfigError(f"[{table}] {name}: must not hold a value twice, got {axes.short(value)} again")
    return found
