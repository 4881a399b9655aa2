"""Compiled programs are kept between test runs, in the user's cache folder: to compile them is half of the tests' time.

Checkouts share them. What is kept is recognised by the program, the compiler and its options, so that nothing stale is
taken; what is older than a month is removed.
"""

import contextlib
import io
import os
import subprocess
import sys
import time
from pathlib import Path

import jax
import pytest
from hypothesis import settings

settings.register_profile("icac", deadline=None, max_examples=60)
settings.load_profile("icac")

_USERS = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
# Where there is no home, or none that can be written: in the checkout, in a folder that git ignores.
_HERE = Path(__file__).resolve().parents[1] / ".cache"
_SHARED = _USERS if _USERS.name == "icac_jax-tests" else _USERS / "icac_jax-tests"
CACHE = (_SHARED if os.access(_USERS, os.W_OK) else _HERE) / "xla"
_MONTH = 30 * 24 * 3600
os.environ["XDG_CACHE_HOME"] = str(CACHE.parent)  # of commands that a test runs in its own process
# The folder and the number of devices of such a process: what one has compiled the other need not.
DEVICES = 2
jax.config.update("jax_compilation_cache_dir", str(CACHE.parent / "icac_jax" / "xla"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_num_cpu_devices", DEVICES)


def pytest_sessionstart():
    for path in (CACHE.parent / "icac_jax" / "xla").glob("*-cache"):
        with contextlib.suppress(OSError):  # another worker may have removed it
            if time.time() - path.stat().st_mtime > _MONTH:
                path.unlink()


# Files that take longest begin first, so that none of them is left over for one worker at the end.
LONG = ("sweep", "resume", "reproduce", "archive", "tools", "hosts", "gymnasium", "own_arm", "arm_kinds", "training")


def pytest_collection_modifyitems(items):
    first = {f"test_{name}": place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: first.get(item.path.stem, len(LONG)))


def here(*args, cwd="."):
    """Runs the command line in this process: no start, no second compile; for all that needs no process of its own."""
    from icac_jax.cli import main

    out, said = io.StringIO(), io.StringIO()
    with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(said):
        status = main.main([str(arg) for arg in args])
    return subprocess.CompletedProcess(args, status, out.getvalue(), said.getvalue())


def apart(*args, cwd=None, env=None, **more):
    """Runs the command line in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "icac_jax", *map(str, args)],
        capture_output=True,
        text=True,
        cwd=cwd,
        env=os.environ | {"XDG_CACHE_HOME": str(CACHE.parent), "COLUMNS": "100"} | (env or {}),
        timeout=300,
        check=False,
        **more,
    )


@contextlib.contextmanager
def installed(place):
    """The packages in a folder as if they were installed, for commands in this process: it looks for learners anew."""
    from icac_jax.agents import registry
    from icac_jax.settings import options

    found = registry.learners, options.all_options, options._learners_own
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "path", [str(place), *sys.path])
        for module in Path(place).glob("*.py"):
            sys.modules.pop(module.stem, None)
        for cached in found:
            cached.cache_clear()
        try:
            yield
        finally:
            for cached in found:
                cached.cache_clear()


def also_on_path(place):
    """The environment of a process that finds the packages in a folder too."""
    return {"PYTHONPATH": os.pathsep.join(filter(None, [str(place), os.environ.get("PYTHONPATH")]))}


@pytest.fixture
def icac(tmp_path, monkeypatch):
    """Runs the command line in a folder of its own: with `env`, if only an empty one, in a process of its own."""
    monkeypatch.setenv("COLUMNS", "100")

    def run(*args, check=None, env=None):
        done = here(*args, cwd=tmp_path) if env is None else apart(*args, cwd=tmp_path, env=env)
        if check is not None:
            assert done.returncode == check, done.stderr
        return done

    return run
