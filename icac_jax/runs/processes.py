"""Several processes, on one host or on many, that share a run or a sweep through `jax.distributed` and a common folder.

Lanes never talk to each other, so each process trains its share of the jobs on its own devices, at its own pace, and
keeps its own records and checkpoints; process 0 puts the records together. The compiled program is the same as on one
host and holds no collectives.
"""

import dataclasses
import os
import platform
import socket
import time
from pathlib import Path

import jax
from jax._src import distributed

import icac_jax
from icac_jax.fields import ConfigError
from icac_jax.runs import links, signals

_PATIENCE = 120
# Variables that say how many tasks a launcher has started: Slurm's srun and Open MPI's mpirun, as JAX reads them.
_LAUNCHERS = ("SLURM_STEP_NUM_TASKS", "OMPI_COMM_WORLD_SIZE")


@dataclasses.dataclass(frozen=True)
class Process:
    """This process among those that share the work.

    Attributes:
      index: its number from 0; process 0 puts the results together.
      count: how many there are.
    """

    index: int = 0
    count: int = 1

    def folder(self, whole: Path) -> Path:
        """Where this process keeps its share of what belongs into `whole`."""
        return whole if self.count == 1 else whole / f"host-{self.index:04d}-of-{self.count:04d}"

    def others(self, whole: Path) -> list[Path]:
        """The folders of all processes, this one's included, in order."""
        return [Process(index, self.count).folder(whole) for index in range(self.count)]


ALONE = Process()
_joined = False


def connect(coordinator: str | None, num_processes: int | None, process_id: int | None) -> Process:
    """Joins the other processes. Must be called before JAX starts its backend.

    Args:
      coordinator: host:port of process 0; all three or none must be given. Under Slurm or Open MPI, none is needed.
      num_processes: how many processes there are.
      process_id: the number of this one, from 0.

    Raises:
      ConfigError: only some are given, a number is not allowed, or the coordinator cannot be reached.
    """
    given = (coordinator, num_processes, process_id)
    launched = any(int(os.environ.get(name, "1") or 1) > 1 for name in _LAUNCHERS)
    if all(one is None for one in given) and not launched:
        return ALONE
    if any(one is None for one in given) and not all(one is None for one in given):
        raise ConfigError("coordinator: must be given with num_processes and process_id, or none of them")
    if num_processes is not None and process_id is not None:
        if num_processes < 1:
            raise ConfigError(f"num_processes: must be a whole number at least 1, got {num_processes}")
        if not 0 <= process_id < num_processes:
            raise ConfigError(
                f"process_id: must be a whole number at least 0 and less than {num_processes}, got {process_id}"
            )
        if num_processes == 1:
            return ALONE
    # JAX's own handler of SIGTERM would take the place of ours, which saves.
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(
            coordinator,
            num_processes,
            process_id,
            initialization_timeout=_PATIENCE,
            shutdown_timeout_seconds=_PATIENCE,
        )
        # A launcher's variables say who and where; public functions of JAX do not, or start its devices first.
        state = distributed.global_state
        process, address = Process(state.process_id, state.num_processes), state.coordinator_address
        assert address is not None
        # It has brought them together and is not needed any more. When a process died, it would notice after 100
        # seconds and abort the others, with a stack and unsaved.
        jax.distributed.shutdown()
        # Each computes by itself with the devices of its host. One of several would compile its own program, and keep
        # it in the cache for the next start in process 0 alone.
        state.process_id, state.num_processes = 0, 1
    except (RuntimeError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise ConfigError(f"coordinator: the processes cannot be brought together ({reason})") from error
    _link(process, address)
    return process


def _link(process: Process, address: str) -> None:
    """Refuses processes that would not compute the same, and has each stop when another ends."""
    global _joined
    everyone, connections = links.join(address, process.index, facts(), process.count)
    _joined = True
    need_same_versions(everyone)

    def ended(index: int) -> None:
        signals.stop_because(f"process {index} of {process.count} ({everyone[index]['host']}) has ended")

    links.watch(connections, ended)


def need_same_versions(everyone: list[links.Facts]) -> None:
    """Refuses processes of which one would not compute what the others do.

    Args:
      everyone: the `facts` of each process.

    Raises:
      ConfigError: versions differ.
    """
    first = everyone[0]
    for index, other in enumerate(everyone):
        for name, version in first["versions"].items():
            if other["versions"].get(name) != version:
                raise ConfigError(
                    f"versions: {name} must be the same everywhere, process 0 ({first['host']}) has {version}, "
                    f"process {index} ({other['host']}) has {other['versions'].get(name)}"
                )


def facts() -> links.Facts:
    """The name of this host, and the versions here of what decides the bits of the results."""
    versions = {"icac_jax": icac_jax.__version__, "jax": jax.__version__, "python": platform.python_version()}
    return {"host": socket.gethostname(), "versions": versions}


def wait_for(*paths: Path, every: float = 0.2) -> None:
    """Waits until one of these files, which another process writes, is there; should it end, this one ends too."""
    while not any(path.exists() for path in paths):
        time.sleep(every)


def joined() -> bool:
    """Whether this process shares its work with others."""
    return _joined
