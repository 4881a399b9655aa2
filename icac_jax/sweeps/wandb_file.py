"""Sweep files of Weights & Biases (YAML) as the tables of a sweep file here. Optional extra `yaml`.

`method: grid` becomes [grid], `random` becomes [random] with `run_cap` draws, `bayes` becomes [search] with `run_cap`
trials. Whatever has no place here is named; a distribution that is not known here is refused.
"""

import math
from typing import Any

from icac_jax.errors import ConfigError
from icac_jax.sweeps.study import OBJECTIVES

SUFFIXES = (".yaml", ".yml")
_METHODS = ("grid", "random", "bayes")
_TAKEN = ("method", "parameters", "metric", "run_cap", "name", "description")
_UNIFORM = ("uniform", "int_uniform")
_LOG = ("log_uniform", "log_uniform_values")
_DISTRIBUTIONS = ("constant", "categorical", *_UNIFORM, *_LOG)
_KEYS = ("value", "values", "distribution", "min", "max")
# What a metric may be called there.
_METRICS = {"success": "success_rate", "reward": "extrinsic_reward", "return": "extrinsic_reward"}


def tables(text: str) -> tuple[dict[str, Any], str]:
    """The tables of a sweep file that says the same.

    Args:
      text: of the YAML file.

    Returns:
      The tables, and in a line what was not taken over; empty where everything was.

    Raises:
      ConfigError: it is no such file, says something that cannot be said here, or PyYAML is missing.
    """
    try:
        import yaml
    except ImportError as error:
        raise ConfigError("file: YAML needs the extra, pip install 'icac_jax[yaml]'") from error
    try:
        found = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(f"not valid YAML: {reason}") from error
    if not isinstance(found, dict) or not isinstance(found.get("parameters"), dict):
        raise ConfigError("parameters: must be a mapping from options to what they take, as in a sweep of W&B")
    method = found.get("method")
    if method not in _METHODS:
        raise ConfigError(f"method: must be one of {', '.join(_METHODS)}, got {method!r}")
    left = [str(key) for key in found if key not in _TAKEN]
    base: dict[str, Any] = {}
    varied: dict[str, Any] = {}
    for name, given in found["parameters"].items():
        option = str(name).replace("-", "_")
        kind, value, ignored = _parameter(str(name), given, method)
        (base if kind == "constant" else varied)[option] = value
        left += [f"parameters.{name}.{key}" for key in ignored]
    made: dict[str, Any] = {"base": base} if base else {}
    claim = found.get("description") or found.get("name")
    if isinstance(claim, str) and claim.strip():
        made["claim"] = claim.strip()
    notes = []
    if varied and method == "grid":
        made["grid"] = varied
        left += ["run_cap"] * ("run_cap" in found)
    elif varied:
        made["random" if method == "random" else "search"] = {**_number(found, method), **varied}
    if method == "bayes" and varied:
        made["search"]["metric"] = _metric(found.get("metric"))
        notes.append("method bayes is a search by Optuna's TPE")
    elif "metric" in found:
        left.append("metric")
    if left:
        notes.append(f"not taken over: {', '.join(left)}")
    return made, "; ".join(notes)


def _number(found: dict[str, Any], method: str) -> dict[str, Any]:
    if "run_cap" not in found:
        return {}
    return {"draws" if method == "random" else "trials": found["run_cap"]}


def _metric(given: Any) -> str:
    """The metric of a search by its name there, such as `success_rate` or `eval/success`.

    Raises:
      ConfigError: it is none of the metrics here, or its goal is the other way round.
    """
    said = given.get("name") if isinstance(given, dict) else None
    name = str(said).rpartition("/")[2]
    name = _METRICS.get(name, name)
    if not isinstance(given, dict) or name not in OBJECTIVES:
        raise ConfigError(f"metric.name: must be one of {', '.join(OBJECTIVES)}, got {said!r}")
    goal = "maximize" if OBJECTIVES[name] else "minimize"
    if given.get("goal", goal) != goal:
        raise ConfigError(f"metric.goal: must be {goal} for {name}, got {given['goal']!r}")
    return name


def _parameter(name: str, given: Any, method: str) -> tuple[str, Any, list[str]]:
    """What a parameter takes: its kind, its value, list or distribution here, and keys that were not taken over."""
    where = f"parameters.{name}"
    if not isinstance(given, dict):
        raise ConfigError(f"{where}: must be a mapping such as {{value: 1}} or {{values: [1, 2]}}, got {given!r}")
    if "parameters" in given:
        raise ConfigError(f"{where}.parameters: must not be nested, options here have no parts")
    ignored = [str(key) for key in given if key not in _KEYS]
    kind = given.get("distribution") or _kind(given)
    if kind not in _DISTRIBUTIONS:
        raise ConfigError(f"{where}.distribution: must be one of {', '.join(_DISTRIBUTIONS)}, got {kind!r}")
    if kind == "constant":
        if "value" not in given:
            raise ConfigError(f"{where}.value: must be given with the distribution constant")
        return kind, given["value"], ignored
    if kind == "categorical":
        values = given.get("values")
        if not isinstance(values, list):
            raise ConfigError(f"{where}.values: must be a list of at least one value, got {values!r}")
        return kind, values if method == "grid" else {"choices": values}, ignored
    if method == "grid":
        raise ConfigError(f"{where}.values: must be given with method grid, which has no distributions")
    ends: dict[str, Any] = {}
    for end, key in (("low", "min"), ("high", "max")):
        value = ends[end] = given.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigError(f"{where}.{key}: must be a number, got {value!r}")
    if kind == "log_uniform":  # there the ends are exponents
        try:
            ends = {end: math.exp(value) for end, value in ends.items()}
        except OverflowError as error:
            raise ConfigError(f"{where}: exponents must be smaller; log_uniform_values takes the numbers") from error
    return kind, ends | ({"log": True} if kind in _LOG else {}), ignored


def _kind(given: dict[str, Any]) -> str:
    """The distribution that W&B takes where none is named."""
    return "constant" if "value" in given else "categorical" if "values" in given else "uniform"
