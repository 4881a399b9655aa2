"""Successive halving: all cells train for a few episodes, the better ones of them for more, and so on.

Jamieson and Talwalkar, "Non-stochastic best arm identification and hyperparameter optimization", 2016; names of its
numbers as in Li et al., "Hyperband", 2018. Cells that go on train anew: their first episodes are the same ones, and the
record of each is that of `icac train` with its options.
"""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from icac_jax.sweeps.study import Cell, Study


class Halving(NamedTuple):
    """Which cells train for how long.

    Attributes:
      min_episodes: every cell trains for at least so many episodes.
      factor: from rung to rung one cell in so many goes on, for so many times the episodes.
      metric: by which they are chosen, a key of `study.OBJECTIVES`.
    """

    min_episodes: int
    factor: int
    metric: str

    def rungs(self, episodes: int) -> list[int]:
        """Episodes of each rung, the last one's being `episodes`: each has a `factor`-th of the next one's."""
        found = [episodes]
        while found[0] // self.factor >= self.min_episodes:
            found.insert(0, found[0] // self.factor)
        return found

    def numbers(self, cells: int, episodes: int) -> list[int]:
        """How many of so many cells train in each rung: a `factor`-th of those before, and at least one."""
        found = [cells]
        for _ in self.rungs(episodes)[1:]:
            found.append(max(found[-1] // self.factor, 1))
        return found


class Promoting:
    """Halving's side of a sweep: which cells train next, given how the rung before went.

    Deterministic, so that a sweep that was stopped is replayed from what its finished rungs gave.

    Args:
      chosen: a study with halving.
    """

    def __init__(self, chosen: "Study") -> None:
        assert chosen.halving is not None
        self.chosen, self.halving = chosen, chosen.halving
        self.all = chosen.cells()
        self.episodes = self.halving.rungs(self.all[0].settings.run.episodes)
        self.numbers = self.halving.numbers(len(self.all), self.episodes[-1])
        self.kept = [cell.number for cell in self.all]

    @property
    def total(self) -> int:
        """Episodes of the whole sweep."""
        seeds = self.all[0].settings.run.seeds
        return sum(seeds * number * long for number, long in zip(self.numbers, self.episodes, strict=True))

    def rung(self, place: int, kept: Sequence[int]) -> list["Cell"]:
        """The cells of these numbers as they are trained in a rung."""
        return [
            self.chosen.cell(number, self.all[number].varied | {"episodes": self.episodes[place]}) for number in kept
        ]

    def batches(self) -> Iterator[list["Cell"]]:
        """The cells of each rung; `tell` must be called with the figures of one before the next is asked for."""
        for place, number in enumerate(self.numbers):
            self.kept = sorted(self.kept[:number])
            yield self.rung(place, self.kept)

    def tell(self, rows: Sequence[dict[str, Any]]) -> None:
        """Tells the figures of the rung that was asked for last."""
        from icac_jax.sweeps import tables

        self.kept = [row["cell"] for row in tables.ranked(list(rows), self.halving.metric)]
