"""What a reproduction runs, and how its folder remembers it, so that `icac resume` can go on with it."""

import dataclasses
import json
import shlex
from pathlib import Path
from typing import Any, NamedTuple

from icac_jax import shapes
from icac_jax.envs import arms
from icac_jax.errors import DamagedError
from icac_jax.paper import claims
from icac_jax.policies import PAIRS
from icac_jax.runs import files
from icac_jax.settings.options import Settings, resolve

FILE = "reproduction.json"
_SHAPE = shapes.record(
    {"arms": shapes.several(shapes.one_of(arms.ARMS), least=1), "options": shapes.mapping(shapes.anything)}
    | {"ablations": shapes.flag, "quick": shapes.flag, "command": shapes.text, "pairs": shapes.whole}
)


@dataclasses.dataclass(frozen=True)
class Plan:
    """What is run.

    Attributes:
      arms: names of the arms.
      options: settings that all runs share, as for `settings.resolve`.
      ablations: run ICAC with one part changed, too.
      quick: mark everything as a trial.
      pairs: start and goal pairs per seed of the evaluation without exploration.
      command: what the user called, to be called again.
    """

    arms: tuple[str, ...]
    options: dict[str, Any]
    ablations: bool
    quick: bool
    command: str
    pairs: int = PAIRS

    @property
    def repeat(self) -> str:
        """The command as reports show it: without the place of the folder on this machine."""
        words = shlex.split(self.command)
        for place, word in enumerate(words):
            if place and words[place - 1] == "--out":
                words[place] = Path(word).name
            elif word.startswith("--out="):
                words[place] = f"--out={Path(word[6:]).name}"
        return shlex.join(words)

    def runs(self) -> list["PlannedRun"]:
        """Every run, in order.

        Raises:
          ConfigError: an option is not valid.
        """
        names = claims.ALGORITHMS | (claims.ABLATIONS if self.ablations else {})
        return [
            PlannedRun(arm, name, resolve(arm=arm, **self.options, **options))
            for arm in self.arms
            for name, options in names.items()
        ]


class PlannedRun(NamedTuple):
    """A run of the evaluation.

    Attributes:
      arm: its arm's name.
      name: what figures and tables call it; its folder within the arm's.
      settings: all of its settings.
    """

    arm: str
    name: str
    settings: Settings

    def place(self, out: Path) -> Path:
        """Its folder."""
        return out / self.arm / self.name

    @property
    def work(self) -> int:
        """Episodes, for estimates of the time."""
        return self.settings.run.seeds * self.settings.run.episodes


def write(plan: Plan, out: Path, finished: bool) -> None:
    """Writes a plan into the folder of its reproduction.

    Args:
      plan: what is run.
      out: the folder.
      finished: whether every run, every figure and the report are there.

    Raises:
      OSError: it cannot be written.
    """
    facts = dataclasses.asdict(plan) | {"state": "finished" if finished else "running"}
    files.write_text(out / FILE, json.dumps(facts, indent=2) + "\n")


def read(out: Path) -> Plan | None:
    """The plan of the reproduction in a folder, None where there is none.

    Raises:
      DamagedError: there is one that cannot be read.
    """
    facts = shapes.read(out / FILE, _SHAPE, "plan of a reproduction")
    if facts is None:
        return None
    try:
        plan = Plan(**{field.name: facts[field.name] for field in dataclasses.fields(Plan)})
        plan = dataclasses.replace(plan, arms=tuple(plan.arms))
        if not 1 <= plan.pairs <= PAIRS:
            raise ValueError(f"pairs is {plan.pairs}")
        plan.runs()
        plan.repeat  # noqa: B018
    except (TypeError, ValueError) as error:
        raise DamagedError(f"{out / FILE}: not a readable plan of a reproduction ({error})") from error
    return plan
