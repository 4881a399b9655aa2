"""The command line `icac`: which commands there are, and what exit status their failures have.

A command is a module of `icac_jax.cli.commands`, loaded when it is called: a wrong option should be answered
before the physics is loaded, and the version before JAX.
"""

import os
import signal
import sys

TYPE_CHECKING = False  # as in typing; whatever takes long to load is loaded once Ctrl-C is answered
if TYPE_CHECKING:
    from collections.abc import Sequence

COMMANDS = {
    "train": "train one algorithm on one arm, many seeds at once",
    "resume": "continue a run that was stopped or killed, to the same bits",
    "demonstrate": "episodes of the oracle as a file from which learners start",
    "encode": "an encoder of pictures, for learners that see instead of feel",
    "evaluate": "what a run's policies do without exploration, against the oracle",
    "reproduce": "the paper's evaluation: runs, figures, a verdict on each claim",
    "sweep": "train every cell of a grid, a list, random draws or a search in a file",
    "best": "the best cell of a sweep as options in TOML",
    "compare": "runs beside each other: differences with intervals, a figure",
    "plot": "a run's own curves and report.html, its page",
    "runs": "list the runs in folders: state, progress, last figures",
    "render": "a run's trained arm reaching goals: video, GIF or a strip of frames",
    "plot-map": "the map of a seed: nodes, edges, visits, prediction error",
    "export": "a seed's policy as a file that NumPy alone can read",
    "completion": "a script with which bash, zsh or fish completes all this",
}

EXIT_STATUSES = """\
Exit status: 0 done, 1 result not printed, 2 wrong input, 3 damaged file, 4 run folder not writable, 5 every learner
diverged, 6 not on this machine, 129, 130, 143 stopped by a signal: the last line says if all is saved."""

_NOT_PRINTED = 1
_DIVERGED = 5
_DONE = (0, _NOT_PRINTED, _DIVERGED)  # statuses of a command that has done its work


def usage() -> str:
    """The page that `icac` prints without a command."""
    lines = ["usage: icac COMMAND [OPTIONS]; icac help COMMAND lists its options; icac --version"]
    lines += [f"  {name:12}{help}" for name, help in COMMANDS.items()]
    lines += ["", EXIT_STATUSES]
    return "\n".join(lines)


def main(argv: "Sequence[str] | None" = None) -> int:
    """Runs a command and returns its exit status.

    Args:
      argv: arguments without the program's name; those of the process by default.
    """
    import contextlib
    import io

    from icac_jax import console

    args = list(sys.argv[1:] if argv is None else argv)
    name = f"icac {args[0]}" if args and args[0] in COMMANDS else "icac"
    result = io.StringIO()
    with contextlib.redirect_stdout(result):
        status = _run(name, args)
    try:
        console.output(result.getvalue())
    except BrokenPipeError:  # whoever read the output has enough of it
        console.discard(sys.stdout)
    except (OSError, ValueError) as error:
        console.say(f"{name}: cannot write to standard output: {getattr(error, 'strerror', None) or error}")
        console.discard(sys.stdout)
        return status or _NOT_PRINTED
    return status


def _run(name: str, args: list[str]) -> int:
    """Runs a command, and says in one line what went wrong; what is not expected to go wrong is raised."""
    from icac_jax import console

    try:
        return _command(args)
    except KeyboardInterrupt:
        console.say(f"{name}: interrupted")
        return 128 + signal.SIGINT
    except SystemExit as stop:
        return stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
    except Exception as error:
        status, line = _explained(error)
        if status is None:
            raise
        console.say(f"{name}: {line}")
        return status


def _command(args: list[str]) -> int:
    import importlib

    import icac_jax
    from icac_jax.errors import ConfigError

    if args and args[0] == "help":
        args = [*args[1:2], "--help"]
    if not args or args[0] in ("-h", "--help"):
        print(usage())
        return 0 if args else 2
    if args[0] == "--version":
        print(f"icac_jax {icac_jax.__version__}")
        return 0
    if args[0] not in COMMANDS:
        import difflib

        close = difflib.get_close_matches(args[0], COMMANDS, n=1)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ConfigError(f"unknown command {args[0]!r}, must be one of {', '.join(COMMANDS)}{hint}")
    importlib.import_module("icac_jax.runs")  # says where icac cannot run, before anything else of it is loaded
    return importlib.import_module(f"icac_jax.cli.commands.{args[0].replace('-', '_')}").main(args[1:])


def _explained(error: Exception) -> tuple[int | None, str]:
    """The exit status of a failure and the line that says what it is; no status for one that is not expected."""
    from icac_jax import errors

    if (status := errors.exit_status(error)) is not None:
        return status, _because(error) + (str(error) or type(error).__name__)
    jax = sys.modules.get("jax")
    if jax is None:
        return None, ""
    first_line = str(error).partition("\n")[0]
    if isinstance(error, jax.errors.JaxRuntimeError):
        return 6, first_line
    from icac_jax.runs import devices

    try:  # without a device, nearly anything fails nearly anywhere
        devices.check()
    except errors.MachineError as cause:
        return 6, str(cause)
    return None, ""


def _because(error: Exception) -> str:
    """Why a training was stopped, where it was not a signal, as the beginning of the line."""
    from icac_jax import errors

    if not isinstance(error, errors.StoppedError):
        return ""
    from icac_jax.runs import signals

    return signals.reason()


def entry() -> None:
    """What the installed program `icac` calls."""
    # Before anything else: loading takes seconds, and an exception out of the middle of it would be a page of text.
    signal.signal(signal.SIGINT, lambda *_: _interrupted())
    # Pictures choose how they draw when one is wanted (`envs.pictures`). Told nothing, MuJoCo's import looks for GLFW
    # in a process of its own, which takes time, and which Ctrl-C ends with a page of text.
    os.environ.setdefault("MUJOCO_GL", "disable")
    from icac_jax import console, errors

    console.open_streams()
    try:
        from icac_jax.runs import signals
    except errors.ConfigError:  # said by the command, which needs the same
        sys.exit(main())
    signals.name_command(sys.argv[1] if len(sys.argv) > 1 and sys.argv[1] in COMMANDS else "")
    signals.listen()  # to the end of the process
    _leave(main())


def _interrupted() -> None:
    if sys.stderr is not None:
        os.write(2, b"icac: interrupted\n")
    os._exit(128 + signal.SIGINT)


def _leave(status: int) -> None:
    """Ends the process, never with another status because nobody reads."""
    from icac_jax import console

    try:
        sys.stderr.flush()
    except (OSError, ValueError):
        console.discard(sys.stderr)
    processes = sys.modules.get("icac_jax.runs.processes")
    if status not in _DONE and processes is not None and processes.joined():
        os._exit(status)  # leaving in order would tell the others that this process has done its share
    sys.exit(status)
