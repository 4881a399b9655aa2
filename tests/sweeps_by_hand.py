"""Sweeps that never ran: made-up episodes for every cell of a study."""

import numpy as np

from icac_jax.sweeps import sweep_file, tables
from icac_jax.sweeps.grid import Grid
from tests.tables_by_hand import table

BASE = "[base]\nseeds = {seeds}\nepisodes = {episodes}\nphysics = 'kinematic'\n"


def trained(cell, steps, rng, nodes=20.0):
    """A result of a cell whose seeds all get to about `steps` in the end, and its row of the table."""
    run, horizon = cell.settings.run, cell.settings.params.horizon
    seed, episode = np.indices((run.seeds, run.episodes))
    end = steps + rng.normal(0, 1.5, (run.seeds, 1))
    mean = end + (horizon - end) * np.exp(-6 * episode / run.episodes)
    taken = np.clip(np.round(mean + rng.normal(0, 4, mean.shape)), 1, horizon)
    given = {"seed": seed, "episode": episode, "steps": taken, "reached": taken < horizon}
    given |= {"live_nodes": np.minimum(2 + episode // 4, nodes)}
    none = [0] * run.seeds
    jobs = {"episodes_done": [run.episodes] * run.seeds, "failed": none, "steps": none}
    result = tables.result_of(cell, table(cell.settings, given, np.ones(mean.shape, bool)), jobs)
    return result, tables.row(cell, result, jobs)


def grid(text, steps, seeds=8, episodes=60, cells=None):
    """A study trained to `steps(varied)`; `cells` for a search."""
    chosen = sweep_file.parse(
        'claim = "What is it that matters?"\n' + text + BASE.format(seeds=seeds, episodes=episodes)
    )
    cells = chosen.cells() if cells is None else [chosen.cell(place, varied) for place, varied in enumerate(cells)]
    rng = np.random.default_rng(0)
    made = [trained(cell, steps(cell.varied), rng, 20 / cell.settings.flat().get("e_max", 1.0)) for cell in cells]
    varying = chosen.varying([cell.varied for cell in cells])
    settings = [cell.settings for cell in cells]
    return Grid(chosen, [row for _, row in made], [result for result, _ in made], settings, varying)
