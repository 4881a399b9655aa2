"""`icac reproduce`: the paper's evaluation, run by run, each in an ordinary run folder, and a report on all of it.

OUT/ARM/NAME is a run, OUT/ARM/figures has the arm's figures; OUT/claims.json, OUT/tables.md and OUT/report.html are
about all of it. All runs share the root seed, so that seed k sees the same starts and goals under every algorithm.
"""

import contextlib
import dataclasses
import json
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from icac_jax import shapes
from icac_jax.analysis import run_page
from icac_jax.envs import arms
from icac_jax.fields import ConfigError
from icac_jax.paper import claims, figures, page, verdicts
from icac_jax.paper import plan as plans
from icac_jax.paper.page import ArmReport
from icac_jax.paper.plan import Plan, PlannedRun
from icac_jax.policies import evaluate
from icac_jax.reports import results
from icac_jax.reports.figures import save_all
from icac_jax.reports.results import Result
from icac_jax.runs import CHECKPOINT_EVERY, files, signals, store, train
from icac_jax.runs import folder as run_folder
from icac_jax.runs.progress import duration
from icac_jax.runs.session import StoppedError
from icac_jax.settings.options import Settings

REPORT = "report.html"
CLAIMS = "claims.json"
TABLES = "tables.md"
TIMES = "times.json"


def reproduce(
    plan: Plan,
    out: Path,
    checkpoint_every: float = CHECKPOINT_EVERY,
    say: Callable[[str], None] = lambda _: None,
    warn: Callable[[str], None] = lambda _: None,
) -> list[ArmReport]:
    """Runs what is missing of a plan in `out`, and writes the report; called again it resumes where it stopped.

    Args:
      plan: what is run.
      out: folder of everything; made if missing.
      checkpoint_every: seconds between the checkpoints of a run.
      say: told, in a line each, what happens.
      warn: told, in a line each, what is not as it should be.

    Returns:
      The reports on the arms, also on one whose runs were in `out` already.

    Raises:
      ConfigError: an option is not valid, or `out` holds runs with other options.
      DamagedError: files of a run in `out` cannot be read.
      StoppedError: a signal asked for a stop; the message says how to resume.
      WriteError: a run's folder could not be written any more.
      OSError: the report could not be written.
    """
    runs = plan.runs()
    for run in runs:
        _check(run, out)
    reports: list[ArmReport] = []
    plans.write(plan, out, finished=False)
    with _stopping(plan.command):
        clock = _Clock(out, [run for run in runs if not _is_over(run.place(out), run.settings)])
        for number, run in enumerate(runs, 1):
            title = f"run {number} of {len(runs)}: {run.name} on {run.arm}"
            place = run.place(out)
            if _is_over(place, run.settings):
                say(f"{title}: finished already")
            else:
                say(f"{title}{clock.left()}")
                with clock.measured(run):
                    _train(run, place, checkpoint_every, warn)
            _evaluate(place, run, plan.pairs, say, warn)
            if run.arm != (runs[number].arm if number < len(runs) else None):
                reports = [_report(arm, out, clock.seconds) for arm in arms.ARMS if _finished(arm, out)]
                _write(plan, reports, out)
                say(f"{run.arm}: report in {out / REPORT}")
        plans.write(plan, out, finished=True)
    return reports


def _check(run: PlannedRun, out: Path) -> None:
    """Refuses a folder that holds another run than the planned one.

    Raises:
      ConfigError: with one line that names the first option that differs.
    """
    place = run.place(out)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"out: cannot write to {place}: {error.strerror or error}") from error
    if not run_folder.is_run(place):
        return
    there = run_folder.load(place).flat()
    for name, value in run.settings.flat().items():
        if there[name] != value:
            raise ConfigError(
                f"{name}: must be {there[name]!r} as in the run in {place}, got {value!r}; or choose another --out"
            )


def _is_over(place: Path, settings: Settings) -> bool:
    """Whether the run has finished and everything of it is written."""
    ended = train.ended(place, settings) is not None
    return ended and (place / store.EPISODES).is_file() and not run_folder.is_locked(place)


def _train(run: PlannedRun, place: Path, checkpoint_every: float, warn: Callable[[str], None]) -> None:
    if run_folder.is_run(place):
        result = train.resume(place, None, checkpoint_every, warn)
    else:
        result = train.train(run.settings, place, checkpoint_every)
    run_page.after_training(place, warn)
    if (asked := signals.asked_last()) is not None:
        raise StoppedError("", asked)
    if result["failed_seeds"]:
        warn(f"{place}: seed {', '.join(result['failed_seeds'])} diverged")


def _evaluate(
    place: Path, run: PlannedRun, pairs: int, say: Callable[[str], None], warn: Callable[[str], None]
) -> None:
    """Evaluates the run without exploration, unless that was done already."""
    done, trained = evaluate.read(place) or {}, train.ended(place, run.settings) or {}
    episodes = sum(done.get("episodes_trained", []))
    if (done.get("pairs"), done.get("pair_seed"), episodes) != (pairs, 0, trained.get("episodes_recorded")):
        say(f"{run.name} on {run.arm}: {pairs:,} episodes per seed without exploration")
        evaluate.evaluate(place, pairs, 0, warn)


def _finished(arm: str, out: Path) -> dict[str, Path]:
    """The finished runs of an arm that can be compared, by name; none unless the three algorithms are there."""
    found: dict[str, Path] = {}
    shared = None
    for name in claims.ALGORITHMS | claims.ABLATIONS:
        place = out / arm / name
        if not run_folder.is_run(place):
            continue
        settings = run_folder.load(place)
        run = dataclasses.replace(settings.run, algo="")  # all else must be the same
        shared = shared or run
        if run == shared and _is_over(place, settings):
            found[name] = place
    return found if set(claims.ALGORITHMS) <= set(found) else {}


def _report(arm: str, out: Path, seconds: dict[str, float]) -> ArmReport:
    """Judges the claims and draws the figures of an arm."""
    places = _finished(arm, out)
    read: dict[str, Result] = {name: results.read(place, name) for name, place in places.items()}
    ends = {name: results.judged(result) for name, result in read.items()}
    first = next(iter(read.values()))
    found = [
        verdicts.judge(claim, ends, first.settings.params.goal_reward, first.summary.get("oracle_steps"))
        for claim in claims.CLAIMS
        if claim.arm == arm and claim.runs <= set(read)
    ]
    evaluations = {name: evaluate.read(place) for name, place in places.items()}
    return ArmReport(
        arm=arm,
        runs=read,
        evaluations={name: greedy for name, greedy in evaluations.items() if greedy is not None},
        verdicts=found,
        drawings=figures.all_of(read),
        seconds={name: seconds[f"{arm}/{name}"] for name in places if f"{arm}/{name}" in seconds},
    )


def _write(plan: Plan, reports: list[ArmReport], out: Path) -> None:
    for found in reports:
        save_all(found.drawings, out / found.arm)
    facts = {
        "quick": plan.quick,
        "command": plan.repeat,
        "claims": [verdicts.as_json(verdict) for found in reports for verdict in found.verdicts],
    }
    files.write_text(out / CLAIMS, json.dumps(facts, indent=2, allow_nan=False) + "\n")
    files.write_text(out / TABLES, page.markdown(reports, plan.repeat, plan.quick))
    files.write_text(out / REPORT, page.page(reports, plan.repeat, plan.quick))


class _Clock:
    """Wall-clock time of the runs, kept over restarts, and what is left.

    Attributes:
      seconds: of each run that was worked on, by ARM/NAME.
    """

    def __init__(self, out: Path, missing: list[PlannedRun]) -> None:
        self.path = out / TIMES
        stored = run_folder.read_json(self.path)
        self.seconds = {key: float(value) for key, value in stored.items() if shapes.fits(shapes.amount, value)}
        self.begin = time.monotonic()
        self.total = sum(run.work for run in missing)
        self.done = 0

    def left(self) -> str:
        """How long it has taken and about how long it will still take; nothing before the first run has ended."""
        if self.done == 0:
            return ""
        spent = time.monotonic() - self.begin
        return f"; {duration(spent)} spent, about {duration(spent * (self.total - self.done) / self.done)} left in all"

    @contextlib.contextmanager
    def measured(self, run: PlannedRun) -> Iterator[None]:
        """Adds the time that the block takes to the run's."""
        begin = time.monotonic()
        try:
            yield
        finally:
            key = f"{run.arm}/{run.name}"
            self.seconds[key] = self.seconds.get(key, 0.0) + time.monotonic() - begin
            with contextlib.suppress(OSError):  # a full disk is for the run itself to complain of
                files.write_text(self.path, json.dumps(self.seconds, indent=2) + "\n")
        self.done += run.work


@contextlib.contextmanager
def _stopping(command: str) -> Iterator[None]:
    """Answers Ctrl-C and SIGTERM with how to resume, also between the runs, where nothing needs saving."""
    words = f"stopped, nothing is lost; resume with: {command}"
    try:
        with signals.saying(words):
            yield
    except (StoppedError, KeyboardInterrupt) as stop:
        asked = stop.signal if isinstance(stop, StoppedError) else signal.SIGINT
        raise StoppedError(words, asked) from stop
