"""Which devices a run uses, and the compile cache. Must be set before JAX starts its backend."""

import os
from pathlib import Path

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from icac_jax.runs import cache


def use_every_core() -> None:
    """Asks for one CPU device a core, unless the user asked for another number through XLA_FLAGS or JAX.

    One XLA program uses about one core for operations this small, so lanes are spread over several devices.
    """
    asked = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if not asked and jax.config.values["jax_num_cpu_devices"] < 0:
        jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))


def use_full_precision() -> None:
    """Asks for true float32 products: some GPUs round their factors to ten bits unless told otherwise."""
    jax.config.update("jax_default_matmul_precision", "highest")


def cache_folder() -> Path:
    """The user's folder for what a later start can use again."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "icac_jax"


def use_compile_cache() -> None:
    """Keeps compiled programs and what was traced for them on disk, so that the second start skips the compiler."""
    cache.use(cache_folder() / "kept")
    if jax.config.values["jax_compilation_cache_dir"] is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


def lane_mesh(lanes: int) -> Mesh:
    """A mesh with one axis `lane` over this process's devices, no more of them than lanes."""
    devices = jax.local_devices()[: max(1, min(lanes, jax.local_device_count()))]
    return Mesh(np.array(devices), ("lane",))


def over_lanes(mesh: Mesh) -> NamedSharding:
    """How arrays with a leading lane axis lie on the mesh."""
    return NamedSharding(mesh, PartitionSpec("lane"))
