"""Compiled programs are kept between test runs, in a folder that git ignores; MJX takes long to compile."""

import os
from pathlib import Path

import jax
import pytest
from hypothesis import settings

settings.register_profile("icac", deadline=None, max_examples=60)
settings.load_profile("icac")

CACHE = Path(__file__).resolve().parents[1] / ".cache" / "xla"
os.environ["XDG_CACHE_HOME"] = str(CACHE.parent)  # of commands that a test runs in its own process
jax.config.update("jax_compilation_cache_dir", str(CACHE))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)
jax.config.update("jax_num_cpu_devices", 2)


@pytest.fixture
def icac(tmp_path):
    """Runs the command line in a process of its own, in a folder of its own; returns the finished process."""
    import subprocess
    import sys

    def run(*args, check=None, **more):
        environment = os.environ | {"XDG_CACHE_HOME": str(CACHE.parent), "COLUMNS": "100"}
        done = subprocess.run(
            [sys.executable, "-m", "icac_jax", *map(str, args)],
            capture_output=True,
            text=True,
            cwd=more.pop("cwd", tmp_path),
            env=environment | more.pop("env", {}),
            timeout=300,
            check=False,
            **more,
        )
        if check is not None:
            assert done.returncode == check, done.stderr
        return done

    return run
