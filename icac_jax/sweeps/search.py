"""Searching with Optuna: batches of cells are asked for, trained together, and told. Optional extra `search`."""

from collections.abc import Iterator, Sequence
from typing import Any

from icac_jax.fields import ConfigError
from icac_jax.settings.options import of_learner, resolve
from icac_jax.sweeps.distributions import Search
from icac_jax.sweeps.study import OBJECTIVES, Cell, Study

try:
    import optuna
except ImportError as error:
    raise ConfigError("search: needs the extra, pip install 'icac_jax[search]'") from error

optuna.logging.set_verbosity(optuna.logging.WARNING)


class Asking:
    """The search's side of a sweep: which cells to try next, given how the earlier ones went.

    Deterministic: the same study and the same figures give the same cells, so that a sweep that was stopped is replayed
    from what its finished batches gave.

    Args:
      chosen: a study with a search.
    """

    def __init__(self, chosen: Study) -> None:
        assert chosen.search is not None
        self.chosen, self.search = chosen, chosen.search
        direction = "maximize" if OBJECTIVES[self.search.metric] else "minimize"
        sampler = optuna.samplers.TPESampler(
            seed=self.search.seed, constant_liar=True, n_startup_trials=self._startup()
        )
        self.study = optuna.create_study(direction=direction, sampler=sampler)
        self.asked: list[Any] = []

    def _startup(self) -> int:
        """Random trials before the search has something to learn from; whole batches of them."""
        return max(self.search.batch, min(10, self.search.trials // 2))

    @property
    def total(self) -> int:
        """Episodes of the whole sweep."""
        run = resolve(**of_learner(self.chosen.base)).run
        return self.search.trials * run.seeds * run.episodes

    def batches(self) -> Iterator[list[Cell]]:
        """Batches of cells; `tell` must be called with the figures of one before the next is asked for."""
        number = 0
        while number < self.search.trials:
            size = min(self.search.batch, self.search.trials - number)
            self.asked = [self.study.ask() for _ in range(size)]
            cells = []
            for trial in self.asked:
                cells.append(self.chosen.cell(number, _suggested(trial, self.search)))
                number += 1
            yield cells

    def tell(self, rows: Sequence[dict[str, Any]]) -> None:
        """Tells the figures of the batch that was asked for last, in the same order."""
        for trial, row in zip(self.asked, rows, strict=True):
            value = row[self.search.metric]
            state = optuna.trial.TrialState.FAIL if value is None else optuna.trial.TrialState.COMPLETE
            self.study.tell(trial, value, state)


def _suggested(trial: "optuna.trial.Trial", search: Search) -> dict[str, Any]:
    values = {}
    for one in search.distributions:
        if one.choices is not None:
            # Optuna takes plain values; a place in the list stands for any other.
            values[one.option] = one.choices[trial.suggest_categorical(one.option, range(len(one.choices)))]
        elif one.whole:
            values[one.option] = trial.suggest_int(one.option, int(one.low), int(one.high), log=one.log)
        else:
            values[one.option] = trial.suggest_float(one.option, one.low, one.high, log=one.log)
    return values
