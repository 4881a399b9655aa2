"""Ray: a head that trains nothing and two nodes of one core each. A training is a study of one cell there."""

import secrets
import sys

from tests.cluster.nodes import finished, until
from tests.cluster.work import Trial

NAME = "ray"
PROGRAMS = {}
NODES = 3
_RAY = [sys.executable, "-m", "ray.scripts.scripts"]
_PORT = 6379


class Ray:
    """A cluster of two nodes and a head, on which the driver runs."""

    def __init__(self, nodes, place):
        self.head, *self.nodes = nodes
        self.place = place
        self.address = f"{self.head.address}:{_PORT}"
        # A token of its own: a head that finds one of the user's asks nodes for it, which do not send it unasked.
        (place / "token").write_text(secrets.token_hex(32))
        self.environment = {"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(place / "token")}
        self.start()

    def start(self):
        """Starts what does not run; nodes whose head has died are started again."""
        here = (
            "--include-dashboard=false",
            "--disable-usage-stats",
            "--num-cpus=0",
            f"--port={_PORT}",
            f"--temp-dir={self.place}/ray",
        )
        if not self.head.processes():
            for node in self.nodes:
                node.die()
            self._start(self.head, "--head", f"--temp-dir={self.place}/ray", *here)
        for node in self.nodes:
            if not node.processes():
                self._start(node, f"--address={self.address}", "--num-cpus=1")

    def _start(self, node, *options):
        command = [*_RAY, "start", f"--node-ip-address={node.address}", *options]
        command += ["--object-store-memory=100000000", f"--temp-dir={self.place}/ray"][
            : 2 if "--head" in options else 1
        ]
        started = node.start(command, f"ray-{node.name}.log", **self.environment)
        assert finished(started) == [0], f"Ray does not start on {node.name}"

    def sweep(self, args, log):
        """Starts the driver of a study on the head."""
        return self.head.icac(*args, "--engine", "ray", "--address", self.address, log=log, **self.environment)


def trials(nodes, work):
    """Kills a node, the driver, the head."""
    cluster = Ray(nodes, work.place)
    for killed in ("node", "driver", "head"):
        folder = work.folder()
        command = work.command("sweep", folder)
        driver = cluster.sweep(command, f"{folder.name}.log")
        victim = until(lambda: next((one for one in cluster.nodes if _trains(one)), None), "a task")
        if killed == "node":
            victim.die()
            statuses = finished(driver)
        else:
            _ = cluster.head.kill("icac_jax") if killed == "driver" else cluster.head.die()
            assert finished(driver) != [0], f"{folder}: ended as if nothing had happened"
            cluster.start()
            statuses = finished(cluster.sweep(command, f"{folder.name}-again.log"))
        yield Trial("sweep", killed, work.equal("sweep", 1, folder) and statuses == [0])
        cluster.start()


def _trains(node):
    return any("train_here" in command for command in node.processes().values())
