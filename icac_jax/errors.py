"""What can go wrong with a command, and the exit status of each; the message is always one line."""


class ConfigError(ValueError):
    """A wrong setting; the message is one line that names the field and what is allowed."""


class DamagedError(Exception):
    """A file of the run cannot be read; the message is one line that names it."""


class WriteError(Exception):
    """The run folder could not be written while running; the last checkpoint is intact. One line."""


class MachineError(Exception):
    """The machine cannot do what was asked for, such as a device that is not there. One line."""


class StoppedError(Exception):
    """The run was asked to stop and has saved everything; the message says how to go on.

    Attributes:
      signal: the number of the signal that asked for it.
    """

    def __init__(self, message: str, asked: int) -> None:
        super().__init__(message)
        self.signal = asked


def exit_status(error: BaseException) -> int | None:
    """The exit status of a failure that can be expected, None for any other."""
    if isinstance(error, StoppedError):
        return 128 + error.signal
    kinds = ((ConfigError, 2), (DamagedError, 3), (WriteError | OSError, 4), (MachineError | MemoryError, 6))
    return next((status for kind, status in kinds if isinstance(error, kind)), None)
