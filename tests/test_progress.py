"""The line of progress: count, time left and success at every width, and nothing wider than the terminal."""

import io
import sys

import pytest

from icac_jax.runs import progress

NOTE = "success 39% in each seed's last 100"
SHORT = ("icac planar2", 4_210, 20_000, "1:02", "3:52", NOTE)
LONG = ("3 of 12: cacla_var nico4 sigma=0.5, all readings", 1_234_210, 20_000_000, "11:01:02", "13:03:52", NOTE)
SCREENS = {
    60: "icac planar2  4,210/20,000 episodes  3:52 left  success 39%",
    80: "icac planar2  4,210/20,000 episodes  1:02 spent  3:52 left  success 39%",
    120: "icac planar2  [####................]  4,210/20,000 episodes  1:02 spent  3:52 left  "
    "success 39% in each seed's last 100",
}


@pytest.mark.parametrize("width", SCREENS)
def test_screens_as_they_are(width):
    assert progress.one_line(width - 1, *SHORT) == SCREENS[width]


@pytest.mark.parametrize("width", [*range(56, 140, 7), 60, 80, 120])
def test_no_width_hides_count_time_left_or_success(width):
    for facts in (SHORT, LONG):
        line = progress.one_line(width - 1, *facts)
        assert len(line) < width
        for part in (f"{facts[1]:,}/{facts[2]:,}", f"{facts[4]} left", "success 39%"):
            assert part in line


class Terminal(io.StringIO):
    """A stream that says that it is a terminal."""

    def isatty(self):
        return True


@pytest.mark.parametrize("width", SCREENS)
def test_a_terminal_is_written_over_and_never_full(width, monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", str(width))
    with progress.Reporter("icac planar2", total=200) as reporter:
        reporter.update(200, 61.0, NOTE)
    assert screen.getvalue().count("\n") == 1  # at the end
    first, last = screen.getvalue().rstrip("\n").split("\r")[1:]
    assert "compiling" in first
    assert "200/200" in last
    assert "0:00 left" in last
    assert max(len(line.removesuffix("\x1b[K")) for line in (first, last)) < width


def test_a_log_has_whole_lines(monkeypatch):
    log = io.StringIO()
    monkeypatch.setattr(sys, "stderr", log)
    with progress.Reporter("icac planar2", total=200, done=100) as reporter:
        reporter.update(200, 61.0, NOTE)
    assert log.getvalue().splitlines() == [
        "icac planar2: compiling",
        f"icac planar2: 200 of 200 episodes, 1:01 spent, 0:00 left, {NOTE}",
    ]
