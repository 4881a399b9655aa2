"""A study: a claim, what all of its cells share, what varies, and the cells that come of it."""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import tomli_w

from icac_jax.fields import ConfigError
from icac_jax.reports.verdicts import LARGER_IS_BETTER
from icac_jax.settings.options import Settings, learner_of, of_learner, resolve
from icac_jax.sweeps import axes
from icac_jax.sweeps.axes import Axis
from icac_jax.sweeps.distributions import Search
from icac_jax.sweeps.halving import Halving

# The tables of a sweep file that say what is trained; the claim's words do not count.
TABLES = ("reference", "base", "grid", "zip", "random", "search", "halving")
# What the claim expects of the cells, against the one with the values in [reference]; see `verdicts`.
EXPECTATIONS = ("no_difference", "no_gain")
# Metrics of a cell that a search can follow, and whether more is better.
OBJECTIVES = {name: LARGER_IS_BETTER[name] for name in ("success_rate", "steps", "extrinsic_reward")}


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


class Study(NamedTuple):
    """What a sweep file says.

    Attributes:
      claim: the claim or question in words; what varies, where the file has none.
      base: options that all cells share.
      axes: lists of partial settings; the cells are their product.
      search: how cells are found instead of listed, or None.
      expect: what the claim expects, one of `EXPECTATIONS`, or None.
      reference: the values of varied options that the others are compared with, such as the paper's.
      tables: the file's tables, with what was changed on the command line.
      halving: which cells train for how long, or None where all train to the end.
    """

    claim: str
    base: dict[str, Any]
    axes: tuple[tuple[dict[str, Any], ...], ...]
    search: Search | None
    expect: str | None
    reference: dict[str, Any]
    tables: dict[str, Any]
    halving: Halving | None = None

    @property
    def metric(self) -> str:
        """What makes a cell the best one, a key of `OBJECTIVES`: what a search or halving goes by, steps otherwise."""
        goal = self.search or self.halving
        return goal.metric if goal else "steps"

    @property
    def text(self) -> str:
        """A sweep file that gives this study."""
        return tomli_w.dumps(self.tables)

    @property
    def learners(self) -> set[str]:
        """Names of the learners that its cells train."""
        drawn = self.search.distributions if self.search else ()
        algos = {part["algo"] for axis in self.axes for part in axis if "algo" in part}
        algos |= {choice for one in drawn if one.option == "algo" for choice in one.choices or ()}
        if algos:
            return algos
        presets = [part for axis in self.axes for part in axis if "preset" in part] or [{}]  # may name the learner
        return {learner_of(self.base | {name: part[name] for name in part if name == "preset"}) for part in presets}

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
        if self.halving and "episodes" in varied:
            words.append(f"episodes={varied['episodes']}")
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


def differences(one: Study, other: Study) -> list[str]:
    """What two studies do not share, as "[table] key" in the order of the first; the claim's words do not count."""
    found = []
    if one.expect != other.expect:
        found.append("expect")
    for table in TABLES:
        first, second = (study.tables.get(table, {}) for study in (one, other))
        found += [f"[{table}] {key}" for key in first | second if first.get(key) != second.get(key)]
    return found
