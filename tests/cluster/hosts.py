"""Plain hosts: processes that find each other through `jax.distributed`, one per node."""

from tests.cluster.nodes import finished
from tests.cluster.work import Trial, in_the_middle

NAME = "plain hosts"
PROGRAMS = {}
NODES = 4


def together(nodes, count, args, log):
    shared = ["--coordinator", f"{nodes[0].name}:4000", "--num-processes", count]
    """Starts `icac` on the first nodes."""
    return [
        node.icac(*args, *shared, "--process-id", index, log=f"{log}-{index}.log")
        for index, node in enumerate(nodes[:count])
    ]


def trials(nodes, work):
    """Kills one of the processes in the middle, and resumes on all nodes."""
    for kind, count, victim in (("train", 2, 1), ("train", 2, 0), ("train", 4, 2), ("sweep", 2, 1), ("sweep", 2, 0)):
        folder = work.folder()
        processes = together(nodes, count, work.command(kind, folder), folder.name)
        in_the_middle(folder)
        nodes[victim].die()
        statuses = finished(*processes)
        resumed = finished(*together(nodes, count, ["resume", folder], f"{folder.name}-resumed"))
        assert 0 not in statuses, f"{folder}: ended as if nothing had happened, {statuses}"
        yield Trial(kind, f"process {victim} of {count}", work.equal(kind, count, folder) and not any(resumed))
