"""Slurm: munged, slurmctld on the first node, a slurmd on each of two others; Debian's packages slurm-wlm and munge."""

import contextlib
import os
import shlex
import sys

from tests.cluster.nodes import PATIENCE, finished, until
from tests.cluster.work import Trial, in_the_middle

NAME = "slurm"
PROGRAMS = {name: "slurm-wlm" for name in ("slurmctld", "slurmd", "srun", "sbatch", "scontrol")} | {"munged": "munge"}
NODES = 3
_CONTROLLER = "controller and srun"
# Credentials expire soon, because a requeued job waits for that before it starts again. InactiveLimit ends the job of
# an srun that has died.
_CONFIGURATION = """ClusterName=icac
SlurmctldHost=node0
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={place}/munge.socket,cred_expire=10
CredType=cred/munge
MpiDefault=none
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
StateSaveLocation={place}/state
SlurmctldPidFile={place}/slurmctld.pid
SlurmdPidFile={place}/slurmd-%n.pid
SlurmdSpoolDir={place}/spool-%n
SlurmdParameters=config_overrides
SlurmdTimeout=10
KillWait=2
InactiveLimit=5
ReturnToService=2
JobRequeue=1
SchedulerParameters=batch_sched_delay=0,sched_interval=2
NodeName=node[1-2] CPUs=1 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


class Slurm:
    """A cluster of two nodes and what controls it."""

    def __init__(self, nodes, place):
        self.head, *self.nodes = nodes
        self.place, self.environment = place, {"SLURM_CONF": str(place / "slurm.conf")}
        (place / "slurm.conf").write_text(_CONFIGURATION.format(place=place))
        (place / "munge.key").write_bytes(os.urandom(128))
        (place / "munge.key").chmod(0o600)
        (place / "state").mkdir()
        self.start()

    def start(self):
        """Starts what does not run."""
        if not any("munged" in command for command in self.head.processes().values()):
            files = [
                f"--{name}={self.place}/munge.{name.split('-')[0]}" for name in ("key-file", "pid-file", "seed-file")
            ]
            socket = f"--socket={self.place}/munge.socket"
            self.head.start(["munged", "--foreground", "--force", socket, *files], "munged.log")
            until((self.place / "munge.socket").exists, "munged")
        self._daemon(self.head, ["slurmctld", "-D"])
        for node in self.nodes:
            self._daemon(node, ["slurmd", "-D"])
        until(lambda: self.say("sinfo", "--noheader", "--format=%t %D").split() == ["idle", "2"], "two idle nodes")

    def _daemon(self, node, command):
        if not any(command[0] in running for running in node.processes().values()):
            node.start(command, f"{command[0]}-{node.name}.log", **self.environment)

    def say(self, *command):
        """What a command of Slurm answers on the first node; nothing where it fails."""
        name = f"said-{command[0]}"
        (self.place / name).unlink(missing_ok=True)
        self.head.start(command, name, **self.environment).wait(timeout=PATIENCE)
        return (self.place / name).read_text()

    def srun(self, args, log):
        """Starts `icac` as two tasks, one per node; where one fails, srun ends the other."""
        options = ["--nodes=2", "--ntasks=2", "--kill-on-bad-exit=1"]
        icac = [sys.executable, "-m", "icac_jax", *args]
        return self.head.start(["srun", *options, *icac], log, **self.environment)

    @contextlib.contextmanager
    def array(self, args, tasks, log):
        """Submits a study as an array, whose number it gives, and what puts it together, for which it waits."""
        assert finished(self.head.icac(*args, "--slurm", tasks, log=log)) == [0]
        line = (self.place / log).read_text().strip()
        collecting = self.say("sh", "-c", line).split()[-1]
        yield int(collecting) - 1
        self.wait(collecting)

    def wait(self, *jobs):
        """Waits until jobs have ended."""
        states = ["squeue", "--noheader", "--states=all", "--format=%T", f"--jobs={','.join(jobs)}"]
        over = {"COMPLETED", "FAILED", "CANCELLED"}
        until(lambda: (said := set(self.say(*states).split())) and said <= over, f"jobs {jobs}")


def trials(nodes, work):
    """Kills a task, a node, the controller; requeues a job."""
    slurm = Slurm(nodes, work.place)
    for kind, killed in (("train", "task"), ("train", "node"), ("sweep", "task"), ("sweep", _CONTROLLER)):
        yield _killed(slurm, work, kind, killed)
    yield _requeued(slurm, work)
    yield _array(slurm, work)


def _killed(slurm, work, kind, killed):
    """A step of two tasks, and `icac resume` by srun, once the nodes are there and free."""
    folder = work.folder()
    step = slurm.srun(work.command(kind, folder), f"{folder.name}.log")
    in_the_middle(folder)
    if killed == "task":
        assert slurm.nodes[1].kill("icac_jax"), "no task runs on node2"
    else:
        (slurm.head if killed == _CONTROLLER else slurm.nodes[1]).die()
    finished(step)  # with status 0 where a node has failed
    assert not (folder / "summary.json").exists(), f"{folder}: finished as if nothing had happened"
    slurm.start()
    status = finished(slurm.srun(["resume", folder], f"{folder.name}-resumed.log"))
    return Trial(kind, killed, work.equal(kind, 2, folder) and status == [0])


def _requeued(slurm, work):
    """A job that begins or resumes, whichever its folder is ready for, is put back into the queue in the middle."""
    folder = work.folder()
    icac = [sys.executable, "-m", "icac_jax"]
    both = work.command("train", folder), ["resume", folder]
    begin, resume = (shlex.join(map(str, [*icac, *args])) for args in both)
    script = work.place / f"{folder.name}.sh"
    script.write_text(f"#!/bin/sh\nif [ -e {folder}/config.toml ]; then exec srun {resume}; fi\nexec srun {begin}\n")
    options = ["--parsable", "--requeue", "--nodes=2", "--ntasks=2", f"--output={work.place}/{folder.name}.log"]
    job = slurm.say("sbatch", *options, "--open-mode=append", script).strip()
    in_the_middle(folder)
    slurm.say("scontrol", "requeue", job)
    slurm.wait(job)
    return Trial("train", "job, requeued", work.equal("train", 2, folder))


def _array(slurm, work):
    """`icac sweep --slurm`: a task of the array is put back into the queue in the middle, then all are put together."""
    folder = work.folder()
    with slurm.array(work.command("sweep", folder), 2, f"{folder.name}.log") as first:
        in_the_middle(folder)
        slurm.say("scontrol", "requeue", f"{first}_1")
    return Trial("sweep", "task of an array, requeued", work.equal("sweep", 2, folder))
