"""`make test-cluster`: trains on clusters that it starts itself, under kills, and compares with one process.

`python -m tests.cluster [KIND ...]`, for some of hosts, slurm and ray. Needs root, for the network namespaces that are
the nodes, and prints a table at the end.
"""

import importlib
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from tests.cluster.nodes import missing, nodes
from tests.cluster.work import Work

KINDS = ("hosts", "slurm", "ray")
_NODES = {"ip": "iproute2", "nsenter": "util-linux", "unshare": "util-linux"}


def main(kinds):
    """Tries kinds of clusters; whether nothing was lost on any of them."""
    modules = [importlib.import_module(f"tests.cluster.{'on_ray' if kind == 'ray' else kind}") for kind in kinds]
    needed = _NODES | {program: package for module in modules for program, package in module.PROGRAMS.items()}
    if lacking := missing(needed):
        print(lacking)
        return False
    if os.geteuid():
        print("needs root, to make network namespaces: sudo make test-cluster")
        return False
    os.environ.setdefault("XDG_CACHE_HOME", str(Path.home() / ".cache" / "icac_jax-tests"))
    place = Path(tempfile.mkdtemp(prefix="icac-cluster-"))
    place.chmod(0o755)  # munged wants its clients to see its socket
    rows = []
    try:
        for module in modules:
            rows += tried(module, place)
    except BaseException:
        print(f"what all programs said is in {place}")
        raise
    table(rows)
    if not all(trial.equal for _, trial in rows):
        print(f"what all programs said is in {place}")
        return False
    shutil.rmtree(place)
    return True


def tried(module, place):
    """The trials of a kind of cluster, with its name."""
    mine = place / module.__name__.rpartition(".")[2]
    mine.mkdir()
    rows = []
    with nodes(module.NODES, mine) as cluster:
        started = time.monotonic()
        for trial in module.trials(cluster, Work(mine)):
            said = "equal" if trial.equal else "LOST"
            seconds, started = time.monotonic() - started, time.monotonic()
            print(f"{module.NAME}: {trial.kind}, {trial.killed}: {said} ({seconds:.0f} s)", flush=True)
            rows.append((module.NAME, trial))
    return rows


def table(rows):
    """Prints how many trials there were of each kind, and how many lost something."""
    print(f"\n{'kind':14}{'work':8}{'killed':40}{'trials':>7}{'equal':>7}{'lost':>6}")
    for name, kind, killed in dict.fromkeys((name, trial.kind, trial.killed) for name, trial in rows):
        mine = [trial.equal for where, trial in rows if (where, trial.kind, trial.killed) == (name, kind, killed)]
        print(f"{name:14}{kind:8}{killed:40}{len(mine):>7}{sum(mine):>7}{len(mine) - sum(mine):>6}")


if __name__ == "__main__":
    given = sys.argv[1:] or list(KINDS)
    if unknown := set(given) - set(KINDS):
        sys.exit(f"kinds: must be some of {', '.join(KINDS)}, got {', '.join(sorted(unknown))}")
    sys.exit(not main(given))
