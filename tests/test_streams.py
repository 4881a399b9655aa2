"""Closed, full and lost streams; signals from the first instant to the last; a terminal of any width."""

import contextlib
import os
import pty
import random
import select
import signal
import subprocess
import sys
import time

import pytest

from icac_jax.cli import main
from icac_jax.runs import devices, progress, signals

TINY = ["train", "--physics", "kinematic", "--seeds", "2", "--episodes", "4", "--map-capacity", "16"]
LONG = [*TINY, "--episodes", "1000000", "--checkpoint-every", "0"]


def shell(line, cwd, **more):
    return subprocess.run(
        ["bash", "-c", line.replace("icac", f"{sys.executable} -m icac_jax", 1)],
        cwd=cwd,
        env=os.environ | more,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_a_run_trains_without_streams(tmp_path):
    done = shell(f"icac {' '.join(TINY)} --out run 0<&- >&- 2>&-", tmp_path)
    assert done.returncode == 0
    assert (tmp_path / "run" / "summary.json").is_file()
    assert (tmp_path / "run" / "lock").read_text().startswith("process")


def test_a_full_standard_output_is_not_a_folder_that_cannot_be_written(tmp_path):
    done = shell(f"icac {' '.join(TINY)} --out run >/dev/full", tmp_path)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("icac train: cannot write to standard output: No space left")
    assert (tmp_path / "run" / "summary.json").is_file()


@pytest.mark.parametrize("line", ["icac --help | head -1", "icac train --help | head -1"])
def test_a_reader_that_has_enough_is_no_failure(line, tmp_path):
    done = shell(f"set -o pipefail; {line}", tmp_path)
    assert (done.returncode, done.stdout.count("\n"), done.stderr) == (0, 1, "")


def test_main_works_without_standard_error_in_this_process(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stderr", None)
    assert main.main(["walk"]) == 2
    monkeypatch.setattr(sys, "stdout", None)
    assert main.main(["--version"]) == 0


def test_the_command_line_does_not_look_for_a_screen(tmp_path):
    """GLFW looks for one in a process of its own, which would answer Ctrl-C with a traceback of its own."""
    code = (
        "import atexit, sys; from icac_jax.cli.main import entry; "
        "atexit.register(lambda: print('mujoco' in sys.modules, 'glfw' in sys.modules)); "
        f"sys.argv = ['icac', *{TINY!r}, '--out', 'run']; entry()"
    )
    told = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    command = [sys.executable, "-c", code]
    said = subprocess.run(command, cwd=tmp_path, env=told, stdout=subprocess.PIPE, text=True, check=True).stdout
    assert said.splitlines()[-1] == "True False"


def test_version_and_help_do_not_wait_for_jax():
    for arg in ("--version", "--help", "help"):
        code = f"import sys; from icac_jax.cli import main; main.main([{arg!r}]); assert 'jax' not in sys.modules"
        assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


@contextlib.contextmanager
def begin(cwd, *args):
    default = {number: signal.SIG_DFL for number in signals.WATCHED}
    process = subprocess.Popen(
        [sys.executable, "-m", "icac_jax", *args],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell that starts something in the background has it ignore Ctrl-C.
        preexec_fn=lambda: [signal.signal(number, handler) for number, handler in default.items()],
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def loaded(process, name):
    """Waits until a library is in the memory of the process."""
    while name not in open(f"/proc/{process.pid}/maps").read():  # noqa: SIM115
        assert process.poll() is None, process.communicate()
        time.sleep(0.005)


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("moment", ["_socket", "jaxlib/_jax", "libmujoco", "compiling"])
def test_ctrl_c_while_it_starts_is_one_line(moment, tmp_path):
    with begin(tmp_path, *LONG, "--out", "run") as process:
        if moment == "compiling":
            process.stderr.readline()
        else:
            loaded(process, moment)
        time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        out, said = process.communicate(timeout=120)
    assert (process.returncode, out) == (130, "")
    lines = said.splitlines()
    assert "Traceback" not in said
    if moment == "compiling":
        assert lines[-1] == "icac train: stopped and saved; resume with: icac resume run"
    else:
        assert lines[-1].startswith("icac")
        assert lines[-1].endswith("interrupted")
        assert len(lines) == 1


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_ctrl_c_at_forty_moments_of_the_first_seconds_is_one_line(tmp_path):
    """From when the interpreter has come to our entry point: what is before, about 60 ms, is Python's own."""
    moments = random.Random(0)
    for number in range(40):
        delay = moments.uniform(0, 6)
        with begin(tmp_path, *LONG, "--out", f"run{number}") as process:
            loaded(process, "_socket")
            time.sleep(delay)
            process.send_signal(signal.SIGINT)
            out, said = process.communicate(timeout=120)
        assert (process.returncode, out) == (130, ""), (delay, said)
        # What the training itself says comes before.
        answers = [line for line in said.splitlines() if line.startswith(("icac: ", "icac train: "))]
        assert len(answers) == 1, (delay, said)
        assert answers[0] == said.splitlines()[-1]
        assert answers[0].endswith(("interrupted", f"stopped and saved; resume with: icac resume run{number}")), said
        assert "Traceback" not in said


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signal")
def test_a_closed_terminal_loses_nothing_and_a_second_signal_promises_nothing(tmp_path):
    for second in (None, signal.SIGTERM):
        with begin(tmp_path, *LONG, "--out", f"run{second}") as process:
            process.stderr.readline()
            time.sleep(0.2)
            process.send_signal(signal.SIGHUP)
            if second is not None:
                process.stderr.readline()
                process.send_signal(second)
            _, said = process.communicate(timeout=120)
        last = said.splitlines()[-1]
        if second is None:
            assert (process.returncode, "stopped and saved" in last) == (129, True)
        elif process.returncode != 129:  # it had not saved in the meantime
            assert process.returncode == 143
            assert last == "icac train: stopped at once; what was trained after the last checkpoint is lost"


def test_what_a_callback_swallows_still_ends_the_process(tmp_path):
    code = """
import os, signal, threading, time
from icac_jax.runs import signals
signals.listen()
threading.Timer(0.2, lambda: os.kill(os.getpid(), signal.SIGINT)).start()
while True:
    try:
        time.sleep(0.01)
    except BaseException:
        pass
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (130, "icac: interrupted\n")


def test_a_signal_removes_what_was_half_written(tmp_path):
    code = """
import os, pathlib, signal, time
from icac_jax.runs import files, signals
signals.listen()
with files.replacing(pathlib.Path('x')):
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(60)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, timeout=60, check=False)
    assert (done.returncode, list(tmp_path.iterdir())) == (143, [])


@pytest.mark.parametrize("width", [40, 60, 80, 120, 200])
def test_count_time_left_and_success_fit_any_terminal(width):
    note = "success 45% in each seed's last 100"
    for done, total in ((5, 40), (1_234_567, 2_000_000)):
        line = progress.one_line(width, "cacla_var planar2, program 1 of 12", done, total, "12:34", "1:02:03", note)
        assert len(line) <= width
        if width >= 60:
            for part in (f"{done:,}/{total:,}", "1:02:03 left", "success 45%"):
                assert part in line
        if width >= 80 and total < 100:
            assert "cacla_var planar2" in line


@pytest.mark.parametrize("width", [60, 80])
def test_the_line_on_a_terminal(width, monkeypatch):
    main_end, other_end = pty.openpty()
    monkeypatch.setenv("COLUMNS", str(width))
    with open(other_end, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with progress.Reporter("icac nico4", 20_000) as reporter:
            reporter.update(20_000, 75.0, "success 45% in each seed's last 100")
        said = ""
        while select.select([main_end], [], [], 0.5)[0]:  # a terminal hands over what it has, in parts
            said += os.read(main_end, 10_000).decode()
    lines = [line.removesuffix("\x1b[K") for line in said.strip().split("\r")]
    assert all(len(line) < width for line in lines)
    for part in ("20,000/20,000", "0:00 left", "success 45%"):
        assert part in lines[-1]
    os.close(main_end)


def test_other_systems(monkeypatch):
    monkeypatch.delattr(os, "sched_getaffinity")
    assert devices._cores() >= 1
    for missing in ("O_NOFOLLOW", "O_NONBLOCK", "sched_getaffinity"):
        code = f"import os; del os.{missing}; from icac_jax.runs import files, folder, devices; devices._cores()"
        assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0
    code = "import sys; sys.modules['fcntl'] = None; from icac_jax.cli import main; sys.argv = ['icac', 'runs', '.']"
    done = subprocess.run([sys.executable, "-c", f"{code}; main.entry()"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "icac runs: icac runs on Linux and macOS; on Windows, use it inside WSL\n"


def test_a_user_without_a_home(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)  # as where there is no entry for the user
    assert devices.cache_folder() is None
    devices.use_compile_cache()


def test_a_device_that_is_not_there_is_one_line(icac):
    for name in ("cuda", "nonsense"):
        done = icac(*TINY, env={"JAX_PLATFORMS": name})
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (6, "", 1), done.stderr
        assert done.stderr.startswith(f"icac train: JAX cannot start on {name}")


def test_jax_may_have_started_before(monkeypatch):
    import jax

    jax.devices()
    monkeypatch.setitem(jax.config.values, "jax_num_cpu_devices", -1)
    devices.use_every_core()
