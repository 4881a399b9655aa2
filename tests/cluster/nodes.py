"""Nodes on one machine: network namespaces on a bridge, each with an address, a host's name and its own processes.

What a real node shares with the others over a network file system is here the file system of the machine.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CPU = {"JAX_PLATFORMS": "cpu", "JAX_NUM_CPU_DEVICES": "1", "PYTHONPATH": str(ROOT)}
PATIENCE = 300  # seconds after which something hangs
_BRIDGE = "icac-bridge"
_PROGRAMS = {"ip": "iproute2"} | dict.fromkeys(("nsenter", "taskset", "unshare"), "util-linux")
# A name of its own and a table of hosts of its own, which no other process of the machine sees.
_ENTER = 'mount --bind "$1" /etc/hosts && hostname "$2" && shift 2 && exec "$@"'


def ip(*args, check=True):
    return subprocess.run(["ip", *map(str, args)], check=check, capture_output=True, text=True).stdout


class Node:
    """A host: `start` starts something on it, `die` is a power cut."""

    def __init__(self, number, place):
        self.name, self.address = f"node{number}", f"10.177.0.{number + 1}"
        self.space, self.place = f"icac-node{number}", place
        self.core = None  # the one that it has; all, if not said
        self._plug = f"icac-plug{number}"

    def connect(self):
        ip("netns", "add", self.space)
        ip("link", "add", self._plug, "type", "veth", "peer", "name", "eth0", "netns", self.space)
        ip("link", "set", self._plug, "master", _BRIDGE, "up")
        ip("-n", self.space, "addr", "add", f"{self.address}/24", "dev", "eth0")
        for device in ("eth0", "lo"):
            ip("-n", self.space, "link", "set", device, "up")

    def disconnect(self):
        """Takes away what `connect` made; the link first, for a namespace goes some time after it is told to."""
        self.die()
        ip("link", "del", self._plug, check=False)
        ip("netns", "del", self.space, check=False)

    def start(self, command, log, **environment):
        """Starts a program on this node, what it says goes to the end of a file."""
        pin = [] if self.core is None else ["taskset", "--cpu-list", self.core]
        enter = [
            *map(str, pin),
            "nsenter",
            f"--net=/run/netns/{self.space}",
            "unshare",
            "--mount",
            "--uts",
            "sh",
            "-c",
            _ENTER,
            "sh",
        ]
        with (self.place / log).open("a") as said:
            return subprocess.Popen(
                [*enter, self.place / "hosts", self.name, *map(str, command)],
                env=_environment() | CPU | environment,
                stdin=subprocess.DEVNULL,
                stdout=said,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def icac(self, *args, log, **environment):
        """Starts `icac` on this node."""
        return self.start([sys.executable, "-m", "icac_jax", *args], log, **environment)

    def processes(self):
        """Numbers and command lines of what runs on this node."""
        found = {}
        for number in map(int, ip("netns", "pids", self.space, check=False).split()):
            with contextlib.suppress(OSError):
                found[number] = Path(f"/proc/{number}/cmdline").read_text().replace("\0", " ")
        return found

    def kill(self, word):
        """Kills the processes of this node whose command lines hold a word; how many there were."""
        numbers = [number for number, command in self.processes().items() if word in command]
        for number in numbers:
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        return len(numbers)

    def die(self):
        """Kills all that runs on this node, and what that may have started meanwhile."""
        while self.kill(""):
            time.sleep(0.05)


def _environment():
    """That of this process without proxies, which no node could reach."""
    return {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}


@contextlib.contextmanager
def nodes(number, place):
    """So many nodes that see each other, and nothing of them left behind."""
    mine = [Node(index, place) for index in range(number)]
    lines = ["127.0.0.1 localhost", *(f"{node.address} {node.name}" for node in mine)]
    (place / "hosts").write_text("\n".join(lines) + "\n")
    ip("link", "add", _BRIDGE, "type", "bridge")  # before `try`: it fails where another such cluster is up
    try:
        ip("link", "set", _BRIDGE, "up")
        for node in mine:
            node.connect()
        yield mine
    finally:
        for node in mine:
            node.disconnect()
        ip("link", "del", _BRIDGE, check=False)


def until(condition, what, patience=PATIENCE):
    """Waits for something; an error that names it if it does not come."""
    end = time.monotonic() + patience
    while not (there := condition()):
        if time.monotonic() > end:
            raise TimeoutError(f"waited {patience} s for {what}")
        time.sleep(0.02)
    return there


def finished(*processes):
    """Waits for the end of programs; their exit statuses."""
    return [process.wait(timeout=PATIENCE) for process in processes]


def lacking(modules):
    """The line that says what kinds of clusters lack here, Debian's packages or root; empty if nothing.

    Args:
      modules: of the kinds, each with the `PROGRAMS` that it starts.
    """
    programs = _PROGRAMS | {program: package for module in modules for program, package in module.PROGRAMS.items()}
    packages = sorted({package for program, package in programs.items() if not shutil.which(program, path=_PATH)})
    if packages:
        return f"missing: apt-get install {' '.join(packages)}"
    # Root of a container may not have the right, or its system no bridges.
    trial = subprocess.run(["unshare", "--net", "ip", "link", "add", _BRIDGE, "type", "bridge"], capture_output=True)
    return "needs root that may make network namespaces and bridges" if trial.returncode else ""


def new_place():
    """A folder for what programs write; the tests' cache of compiled programs is used."""
    os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache" / "icac_jax-tests"))
    place = Path(tempfile.mkdtemp(prefix="icac-cluster-"))
    place.chmod(0o755)  # munged wants its clients to see its socket
    return place


_PATH = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/sbin"])
