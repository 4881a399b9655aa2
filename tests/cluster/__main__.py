"""`make test-cluster`: trains on clusters that it starts itself, under kills, and compares with one process.

`python -m tests.cluster [--short] [KIND ...]`, for some of hosts, slurm and ray. Needs root, for the network namespaces
that are the nodes, and prints a table at the end. The short form does the first trial of each kind that can be started
here.
"""

import importlib
import itertools
import shutil
import sys
import time

from tests.cluster.nodes import lacking, new_place, nodes
from tests.cluster.work import Work

KINDS = ("hosts", "slurm", "ray")


def main(kinds, short=False):
    """Tries kinds of clusters; whether nothing was lost on any of them.

    Args:
      kinds: some of `KINDS`.
      short: the first trial of each, without the kinds that lack something here.
    """
    modules = [importlib.import_module(f"tests.cluster.{'on_ray' if kind == 'ray' else kind}") for kind in kinds]
    for module in list(modules):
        if line := lacking([module]):
            print(f"{module.NAME}: {line}", flush=True)
            if not short:
                return False
            modules.remove(module)
    place = new_place()
    rows = []
    try:
        for module in modules:
            rows += tried(module, place, 1 if short else None)
    except BaseException:
        print(f"what all programs said is in {place}")
        raise
    table(rows)
    if not all(trial.equal for _, trial in rows):
        print(f"what all programs said is in {place}")
        return False
    shutil.rmtree(place)
    return True


def tried(module, place, most):
    """The trials of a kind of cluster, with its name; the first ones or all."""
    mine = place / module.__name__.rpartition(".")[2]
    mine.mkdir()
    rows = []
    with nodes(module.NODES, mine) as cluster:
        started = time.monotonic()
        for trial in itertools.islice(module.trials(cluster, Work(mine)), most):
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
    short = "--short" in sys.argv
    given = [kind for kind in sys.argv[1:] if kind != "--short"] or list(KINDS)
    if unknown := set(given) - set(KINDS):
        sys.exit(f"kinds: must be some of {', '.join(KINDS)}, got {', '.join(sorted(unknown))}")
    sys.exit(not main(given, short))
