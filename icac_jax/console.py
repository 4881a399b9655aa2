"""What is said on the terminal: names and texts of others made harmless, in lines short enough to be read."""

import contextlib
import os
import sys
from typing import IO

LONGEST = 300


def shown(value: object, most: int = LONGEST) -> str:
    r"""A text in one line: what cannot be printed is escaped, and of a long one the middle is left out.

    Args:
      value: a text, a path, an error; of any characters. A byte that was no UTF-8 is shown as `\xNN`.
      most: characters of the result at most.
    """
    text = _cut(str(value), 4 * most)  # a text of megabytes is not gone through
    return _cut("".join(letter if letter.isprintable() else _escaped(letter) for letter in text), most)


def _cut(text: str, most: int) -> str:
    """The beginning and the end of a long text: the one names what it is about, the other what is allowed."""
    if len(text) <= most:
        return text
    tail = (most - 3) // 3
    return f"{text[: most - 3 - tail]}...{text[len(text) - tail :]}"


def _escaped(letter: str) -> str:
    if "\udc80" <= letter <= "\udcff":
        return f"\\x{ord(letter) - 0xDC00:02x}"
    return letter.encode("unicode_escape").decode()


def say(line: object) -> None:
    """Writes a line to standard error; that nobody reads it is no reason to stop."""
    with contextlib.suppress(OSError, ValueError):
        if sys.stderr is not None:
            print(shown(line), file=sys.stderr, flush=True)


def output(text: str) -> None:
    """Writes a result to standard output, if there is one, and sees that it got there.

    Raises:
      OSError: it did not: nobody reads it any more (BrokenPipeError), or the disk is full.
    """
    stream = sys.stdout
    if stream is None or not text:
        return
    if stream.isatty():
        text = "".join(letter if letter.isprintable() or letter in "\n\t" else _escaped(letter) for letter in text)
    try:
        stream.write(text)
    except UnicodeEncodeError:  # names of any bytes go through a pipe as they are; signs that it has not, escaped
        encoding = stream.encoding or "utf-8"
        try:
            data = text.encode(encoding, "surrogateescape")
        except UnicodeEncodeError:
            data = text.encode(encoding, "backslashreplace")
        buffer = getattr(stream, "buffer", None)
        if buffer is None:
            stream.write(data.decode(encoding, "backslashreplace"))
        else:
            stream.flush()
            buffer.write(data)
    stream.flush()


def discard(stream: IO[str] | None) -> None:
    """Lets what a stream could not write go nowhere, so that leaving does not fail over it once more."""
    with contextlib.suppress(OSError, ValueError, AttributeError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(nowhere, stream.fileno())  # pyright: ignore[reportOptionalMemberAccess]
        finally:
            os.close(nowhere)


def open_streams() -> None:
    """Opens what the shell has closed (`2>&-`) on the null device.

    A file opened later would otherwise get the free number, and whatever a library writes to standard error.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115


def columns(stream: IO[str]) -> int:
    """Width of the terminal behind a stream; `COLUMNS` wins, 80 if it is not known."""
    with contextlib.suppress(ValueError):
        if (asked := int(os.environ.get("COLUMNS", "0"))) > 0:
            return asked
    with contextlib.suppress(OSError, ValueError):
        return os.get_terminal_size(stream.fileno()).columns or 80
    return 80
