"""The command line `icac`: which commands there are, and what exit status their failures have.

A command is a module of `icac_jax.cli.commands`, loaded when it is called: a wrong option should be answered
before the physics is loaded.
"""

import contextlib
import importlib
import os
import select
import sys
from collections.abc import Sequence

from icac_jax import __version__
from icac_jax.fields import ConfigError

COMMANDS = {
    "train": "train one algorithm on one arm, many seeds at once",
    "resume": "go on with a run that was stopped or killed, to the same bits",
    "evaluate": "what a run's policies do without exploration, against the oracle",
    "reproduce": "the paper's evaluation: runs, figures, a verdict on each claim",
    "sweep": "train every cell of a grid, a list, random draws or a search in a file",
    "best": "the best cell of a sweep as options in TOML",
    "runs": "list the runs in folders: state, progress, last figures",
    "render": "a run's trained arm reaching goals: video, GIF or a strip of frames",
    "plot-map": "the map of a seed: nodes, edges, visits, prediction error",
    "export": "a seed's policy as a file that NumPy alone can read",
}

EXIT_STATUSES = """\
Exit status: 0 done, 2 wrong input, 3 a file of the run is damaged, 4 the run folder cannot be written any more,
5 numbers stopped being finite in every lane, 6 the machine cannot do it (too little memory, a failing device),
130 or 143 stopped by Ctrl-C or SIGTERM with everything saved. What went wrong is one line on standard error."""


def usage() -> str:
    """The page that `icac` prints without a command."""
    lines = ["usage: icac COMMAND [OPTIONS]", ""]
    lines += [f"  {name:12}{help}" for name, help in COMMANDS.items()]
    lines += ["", "icac COMMAND --help lists a command's options; icac --version prints the version.", EXIT_STATUSES]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit status.

    Args:
      argv: arguments without the program's name; those of the process by default.
    """
    args = list(sys.argv[1:] if argv is None else argv)
    if not args or args[0] in ("-h", "--help"):
        print(usage())
        return 0 if args else 2
    if args[0] == "--version":
        print(f"icac_jax {__version__}")
        return 0
    if args[0] not in COMMANDS:
        print(f"icac: unknown command {args[0]!r}, must be one of {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    try:
        status = importlib.import_module(f"icac_jax.cli.commands.{args[0].replace('-', '_')}").main(args[1:])
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # whoever read the output has enough of it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print(f"icac {args[0]}: interrupted", file=sys.stderr)
        return 130
    except Exception as error:
        status = _status_of(error)
        if status is None:
            raise
        with contextlib.suppress(OSError):  # the terminal may be gone
            print(f"icac {args[0]}: {str(error).partition(chr(10))[0]}", file=sys.stderr)
        return status


def _status_of(error: Exception) -> int | None:
    """The exit status of an expected failure, None for any other."""
    if isinstance(error, ConfigError):
        return 2
    # Imported here: a wrong option should be answered before the physics is loaded.
    import jax

    from icac_jax.runs.checkpoints import DamagedError
    from icac_jax.runs.session import StoppedError, WriteError

    if isinstance(error, DamagedError):
        return 3
    if isinstance(error, WriteError | OSError):
        return 4
    if isinstance(error, MemoryError | jax.errors.JaxRuntimeError):
        return 6
    return 128 + error.signal if isinstance(error, StoppedError) else None


def _forget_lost_reader() -> None:
    """Where nobody reads standard error any more, what is still written there must not become the exit status 120."""
    watch = select.poll()
    watch.register(2, 0)
    if watch.poll(0):
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def entry() -> None:
    """What the installed program `icac` calls."""
    try:
        status = main()
    finally:
        _forget_lost_reader()
    if status and "icac_jax.runs.processes" in sys.modules and sys.modules["icac_jax.runs.processes"].joined():
        # Leaving in order would wait for processes that are still at work; leaving at once ends them too.
        os._exit(status)
    sys.exit(status)
