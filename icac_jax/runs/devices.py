"""Which devices a run uses, and the compile cache. Must be set before JAX starts its backend."""

import contextlib
import os
from pathlib import Path

import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from icac_jax.errors import MachineError
from icac_jax.runs import cache


def use_every_core() -> None:
    """Asks for one CPU device a core, unless the user asked for another number through XLA_FLAGS or JAX.

    One XLA program uses about one core for operations this small, so lanes are spread over several devices.
    """
    asked = "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    if not asked and jax.config.values["jax_num_cpu_devices"] < 0:
        with contextlib.suppress(RuntimeError):  # JAX has started already, and keeps the devices that it has
            jax.config.update("jax_num_cpu_devices", _cores())


def keep_loops() -> None:
    """Asks XLA not to unroll loops, unless the user asked for something else of that kind through XLA_FLAGS.

    Of a loop over sixteen lanes it makes sixteen operations before it looks for vectors, and finds none then: a step
    with lanes last takes three times as long (docs/performance.md). The compiler has it for a whole process only, and
    learners with replay are a fifth slower with it. It must be asked for before JAX starts; later it changes nothing.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_backend_extra_options" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_KEPT_LOOPS}".strip()


_KEPT_LOOPS = "--xla_backend_extra_options=xla_cpu_disable_loop_unrolling=true"


def _cores() -> int:
    """How many cores this process may use; all of the machine where the system does not say."""
    mine = getattr(os, "sched_getaffinity", None)  # not on macOS
    return len(mine(0)) if mine is not None else os.cpu_count() or 1


def check() -> None:
    """Starts JAX's devices, after which they cannot be chosen any more.

    Raises:
      MachineError: there is none of the kind that was asked for.
    """
    try:
        jax.devices()
    except Exception as error:  # an assertion among them
        asked = jax.config.values["jax_platforms"]
        reason = str(error).partition("\n")[0] or "nothing of the kind was found"
        raise MachineError(f"JAX cannot start on {asked or 'this machine'} (JAX_PLATFORMS): {reason}") from error


def use_full_precision() -> None:
    """Asks for true float32 products: some GPUs round their factors to ten bits unless told otherwise."""
    jax.config.update("jax_default_matmul_precision", "highest")


def cache_folder() -> Path | None:
    """The user's folder for what a later start can use again; None for a user without a home folder."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    return Path(base) / "icac_jax" if os.path.isabs(base) else None


def use_compile_cache() -> None:
    """Keeps compiled programs and what was traced for them on disk, so that the second start skips the compiler."""
    folder = use_kept()
    if folder is None:
        return
    if jax.config.values["jax_compilation_cache_dir"] is None:
        jax.config.update("jax_compilation_cache_dir", str(folder / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)  # a start has some that take a tenth each


def use_kept() -> Path | None:
    """Keeps what was traced on disk, JAX's own settings left alone; the folder, or None if it cannot be used."""
    folder = cache_folder()
    if folder is None or not _writable(folder):
        return None
    cache.use(folder / "kept")
    return folder


def _writable(folder: Path) -> bool:
    """Whether files can be kept in a folder, which is made for it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK | os.X_OK)


def lane_mesh(lanes: int) -> Mesh:
    """A mesh with one axis `lane` over this process's devices, no more of them than lanes."""
    devices = jax.local_devices()[: max(1, min(lanes, jax.local_device_count()))]
    return Mesh(np.array(devices), ("lane",))


# Lanes of a block: as many as the widest vectors have numbers. A core's cache holds the state of several blocks.
LANES_PER_BLOCK = 16


def lanes_last(large: bool = False) -> bool:
    """Whether steps are faster with the lanes last: on a CPU, but for learners with replay buffers.

    Args:
      large: whether lanes have replay buffers: the arithmetic of those learners is in large products.
    """
    return not large and jax.default_backend() == "cpu"


def blocks(lanes: int, mesh: Mesh, large: bool = False) -> tuple[int, int]:
    """In how many equal parts a device runs its lanes, one after the other, and how many lanes that makes with padding.

    A block has always as many lanes, so that a learner's numbers do not depend on how many learners there are.

    Args:
      lanes: of this process.
      mesh: that they are spread over.
      large: as for `lanes_last`; then, and elsewhere than on a CPU, a device runs all of its lanes together.
    """
    each = -(-lanes // mesh.size)
    if not lanes_last(large):
        return 1, each * mesh.size
    number = -(-each // LANES_PER_BLOCK)
    return number, number * LANES_PER_BLOCK * mesh.size


def over_lanes(mesh: Mesh) -> NamedSharding:
    """How arrays with a leading lane axis lie on the mesh."""
    return NamedSharding(mesh, PartitionSpec("lane"))
