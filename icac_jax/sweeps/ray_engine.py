"""Sweeps on a Ray cluster: each group of cells of one program is a task. Optional extra `ray`.

A task that a lost worker took with it is run again elsewhere. Workers need the package but no common folder: records
come back to the driver, which alone writes.
"""

import json
import logging
import socket
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from icac_jax.agents import registry
from icac_jax.fields import ConfigError
from icac_jax.runs import files, processes, records, session, signals
from icac_jax.runs import folder as run_folder
from icac_jax.runs.jobs import DONE, read_done
from icac_jax.runs.links import Facts
from icac_jax.runs.loop import Job
from icac_jax.runs.processes import Process
from icac_jax.runs.progress import Reporter
from icac_jax.runs.session import StoppedError
from icac_jax.runs.signals import StopRequest
from icac_jax.runs.store import Store
from icac_jax.settings.options import resolve
from icac_jax.sweeps import groups
from icac_jax.sweeps.engine import Batch, Plan

try:
    import ray
    import ray.exceptions
except ImportError as error:
    raise ConfigError("engine: ray needs the extra, pip install 'icac_jax[ray]'") from error

# Learners of one task: enough to fill a core's lanes, few enough that a lost worker costs little.
_MOST_JOBS = 80
_ATTEMPTS = 5
_LOOK_EVERY = 0.5
_PATIENCE = 10.0  # seconds for a cluster to answer


def train_here(
    jobs: list[tuple[dict[str, Any], int]], lanes: int | None, driver: Facts
) -> tuple[dict[str, Any], pa.Table]:
    """Trains jobs in this process and gives back what `jobs.read_done` would say, and the rows of the record.

    Args:
      jobs: options and seed of each.
      lanes: how many train at once.
      driver: `processes.facts` of the process that drives the cluster.

    Raises:
      ConfigError: this node has other versions.
    """
    processes.need_same_versions([driver, processes.facts()])
    from icac_jax.runs import devices

    settings: dict[str, Any] = {}
    for options, _ in jobs:
        settings.setdefault(json.dumps(options), resolve(**options))
    if any(not registry.replays(one.algo) for one in settings.values()):
        devices.keep_loops()
    devices.use_full_precision()
    devices.use_compile_cache()
    from icac_jax.runs.loop import Training

    training = Training(
        [Job(settings[json.dumps(options)], seed) for options, seed in jobs], groups.lanes_at_once(len(jobs), lanes)
    )
    started, rows, chunk = time.monotonic(), [], None
    for chunk in training.chunks(training.start()):
        rows.append(chunk.table)
    assert chunk is not None
    facts = {name: getattr(chunk.progress, name).tolist() for name in ("episodes_done", "failed", "steps")} | {
        "seconds": time.monotonic() - started,
        "lanes": training.width,
    }
    return facts, records.joined(rows)


class Ray:
    """A Ray cluster, or one started on this machine.

    Attributes:
      process: one process alone drives the cluster.
      most_jobs: learners of one task.

    Args:
      address: of the cluster's head, "auto" for one that runs here already; None starts one on this machine's cores.
    """

    process: Process = processes.ALONE
    most_jobs: int | None = _MOST_JOBS

    def __init__(self, address: str | None) -> None:
        _must_answer(address)
        try:
            if not ray.is_initialized():
                ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR, include_dashboard=False)
        except (ConnectionError, ValueError, RuntimeError) as error:
            reason = str(error).partition("\n")[0]
            raise ConfigError(f"address: no Ray cluster answers at {address!r} ({reason})") from error
        signals.listen_again()  # Ray's own handler of SIGTERM aborts the process three seconds later

    def train(self, batch: Batch, home: Path, plan: Plan, before: int, total: int) -> None:
        """Trains the groups of a batch that have not finished yet, as tasks; see `engine.Engine`."""
        gpus = 1 if ray.cluster_resources().get("GPU") else 0
        task = ray.remote(num_cpus=1, num_gpus=gpus, max_retries=_ATTEMPTS)(train_here)
        driver = processes.facts()
        waiting: dict[Any, groups.Group] = {}
        done = before
        for group in batch.groups:
            facts = read_done(batch.place(group))
            if facts:
                done += sum(facts["episodes_done"])
            else:
                jobs = [(job.settings.flat(), job.seed) for job in group.jobs()]
                waiting[task.remote(jobs, plan.lanes, driver)] = group
        session.write_status(home, "running", done, total, "on Ray")
        started = time.monotonic()
        with StopRequest() as stop, Reporter(f"{len(waiting)} tasks on Ray", total, done) as reporter:
            while waiting:
                ready, _ = ray.wait(list(waiting), timeout=_LOOK_EVERY)
                for one in ready:
                    group = waiting.pop(one)
                    done += _keep(batch.place(group), *_result(one))
                    note = f"{len(waiting)} left"
                    session.write_status(home, "running", done, total, note)
                    reporter.update(done, time.monotonic() - started, note)
                if stop.signal is not None and waiting:
                    for one in waiting:
                        ray.cancel(one, force=True)
                    session.write_status(home, "stopped", done, total)
                    run_folder.record(home, "stopped", signal=stop.signal.name, episodes_done=done)
                    raise StoppedError(
                        f"stopped, finished tasks are kept; resume with: icac resume {home}", stop.signal
                    )


def _result(task: Any) -> tuple[dict[str, Any], pa.Table]:
    """What a task gives back.

    Raises:
      ConfigError: a node has other versions.
      MemoryError: its workers were lost again and again.
    """
    try:
        return ray.get(task)
    except ray.exceptions.RayTaskError as error:
        if isinstance(error.cause, ConfigError):  # without the stack that Ray makes part of the message
            raise ConfigError(str(error.cause)) from error
        raise  # what went wrong in the training itself
    except ray.exceptions.RayError as error:
        reason = str(error).partition("\n")[0]
        raise MemoryError(f"a task was lost {_ATTEMPTS + 1} times, perhaps for lack of memory ({reason})") from error


def _must_answer(address: str | None) -> None:
    """Refuses host:port where nobody listens; Ray itself would try for minutes."""
    host, colon, port = (address or "").removeprefix("ray://").rpartition(":")
    if not colon:
        return  # none, or a word such as auto
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()
    except (OSError, ValueError, OverflowError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"address: no Ray cluster answers at {address!r} ({reason})") from error


def _keep(folder: Path, facts: dict[str, Any], table: pa.Table) -> int:
    """Writes a finished group as `train_jobs` would; returns its episodes."""
    files.make_folder(folder)
    store = Store(folder)
    store.compact(np.zeros(len(facts["episodes_done"]), int))  # what an earlier attempt left
    store.add(table)
    store.flush()
    store.compact(np.array(facts["episodes_done"]))
    files.write_text(folder / DONE, json.dumps(facts) + "\n")
    return sum(facts["episodes_done"])
