"""What several commands need: options, what must be set before JAX starts, warnings, a run's summary."""

import atexit
import contextlib
import dataclasses
import json
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from icac_jax import console
from icac_jax.cli import parsing
from icac_jax.fields import ConfigError
from icac_jax.policies import SHIPPED
from icac_jax.runs import CHECKPOINT_EVERY

if TYPE_CHECKING:
    from icac_jax.runs.processes import Process


def flag(default: Any, help: str, hidden: bool = False) -> Any:
    """An option of a command, with its line in the help; an older name of another option is hidden there."""
    return dataclasses.field(default=default, metadata={"help": help, "hidden": hidden})


def no_cache() -> Any:
    """The option of every command that compiles."""
    return flag(False, "do not keep compiled programs in the user's cache folder")


def checkpoint_every() -> Any:
    """The option of every command that trains."""
    return flag(CHECKPOINT_EVERY, "seconds between checkpoints; 0 saves after each chunk")


@dataclasses.dataclass(frozen=True)
class Processes:
    """Options of the commands that several processes can share."""

    coordinator: str | None = flag(None, "host:port of process 0, to share the work of processes")
    num_processes: int | None = flag(None, "how many processes share the work")
    process_id: int | None = flag(None, "which of them this one is, from 0")

    def connect(self) -> "Process":
        """Joins the other processes; after `prepare`."""
        from icac_jax.runs import processes

        return processes.connect(self.coordinator, self.num_processes, self.process_id)


def options(usage: str, record: type, args: Sequence[str]) -> Any:
    """The options of a command without settings; None when its help was asked for, and printed."""
    if {"-h", "--help"} & set(args):
        from icac_jax.cli import help

        print(help.command(usage, record))
        return None
    return parsing.parse(usage.split()[0], record, args, {field.name: field for field in dataclasses.fields(record)})


def of_run(usage: str, record: type, args: Sequence[str]) -> Any:
    """The options of a command about one folder, its argument `run`; None when its help was asked for, and printed.

    Raises:
      ConfigError: the folder is not given, nor a policy that may come with the package.
    """
    given = options(usage, record, args)
    if given is not None and given.run is None and getattr(given, "policy", None) not in SHIPPED:
        raise ConfigError("run: must be the folder of a run, got nothing")
    return given


def prepare(no_cache: bool, checkpoint_every: float = CHECKPOINT_EVERY, learners: Iterable[str] = ()) -> None:
    """What must be set before JAX starts, and the check of what every training command takes.

    Args:
      no_cache: keep nothing in the user's cache folder.
      checkpoint_every: seconds between checkpoints.
      learners: names of what will be trained.

    Raises:
      ConfigError: `checkpoint_every` is out of its bounds.
    """
    from icac_jax.agents import registry
    from icac_jax.runs import devices

    if not 0 <= checkpoint_every < math.inf:
        raise ConfigError(f"checkpoint_every: must be a number at least 0, got {checkpoint_every}")
    devices.use_every_core()
    devices.use_full_precision()
    if any(not registry.replays(name) for name in learners):
        devices.keep_loops()
    if not no_cache:
        devices.use_compile_cache()
    elif "MPLCONFIGDIR" not in os.environ:  # Matplotlib would keep its list of fonts
        os.environ["MPLCONFIGDIR"] = place = tempfile.mkdtemp(prefix="icac-")
        atexit.register(shutil.rmtree, place, ignore_errors=True)


def learners_of(path: Path) -> Iterable[str]:
    """Names of the learners in the folder of a run or a sweep; the paper's where it is neither."""
    from icac_jax.paper import claims
    from icac_jax.runs import folder
    from icac_jax.sweeps import sweep_file

    if folder.is_sweep(path):
        return sweep_file.read(path / folder.SWEEP).learners
    return [folder.load(path).algo] if folder.is_run(path) else claims.ALGORITHMS


def compiling(command: str) -> None:
    """Says, to somebody at a terminal, why the command seems to do nothing for some seconds."""
    if sys.stderr is not None and sys.stderr.isatty():
        console.say(f"icac {command}: compiling, which takes seconds the first time ...")


def need_folder(out: Path | None, process: "Process") -> None:
    """Refuses a folder that each of several processes would choose for itself."""
    if out is None and process.count > 1:
        raise ConfigError("out: must be given, the same folder for all processes")


def shared(process: "Process", out: Path) -> contextlib.AbstractContextManager[None]:
    """Has a process that shares a folder with others say how to go on, also where it ends while it waits for them."""
    from icac_jax.runs import signals

    if process.count == 1:
        return contextlib.nullcontext()
    return signals.saying(f"checkpoints are kept; resume with: icac resume {out}")


def warn(line: str) -> None:
    """Says something on standard error that does not stop the command."""
    console.say(f"icac: warning: {line}")


def show(result: dict[str, Any], out: Path, as_json: bool) -> int:
    """Prints a run's summary; status 5 if every lane failed."""
    from icac_jax.runs import summary

    if as_json:
        print(json.dumps(result))
    else:
        print(summary.as_text(result))
        print(f"{'written to':16}{console.shown(out)}")
    return status_of_failures(len(result["failed_seeds"]), result["seeds"])


def status_of_failures(failed: int, lanes: int) -> int:
    """Exit status 5, and a line that says so, if every lane failed; 0 otherwise."""
    if failed == lanes:
        console.say("icac: every learner diverged")
        return 5
    return 0
