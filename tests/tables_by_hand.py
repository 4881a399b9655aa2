"""Results of runs that never ran: hand-made tables of episodes."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa

from icac_jax.paper import claims
from icac_jax.reports.results import Result
from icac_jax.runs import folder, records, store, summary
from icac_jax.settings.options import resolve


def result(name, reached, steps=None, arm="planar2", failed=(), oracle_steps=6.0, **columns):
    """A result from outcomes by seed and episode.

    reached: [S, E]; steps: [S, E] or None for 5 where reached; failed: pairs of a seed and the episodes it finished.
    """
    reached = np.asarray(reached, bool)
    seeds, episodes = reached.shape
    options = (claims.ALGORITHMS | claims.ABLATIONS)[name]
    settings = resolve(arm=arm, seeds=seeds, episodes=episodes, physics="kinematic", **options)
    steps = np.where(reached, 5, settings.params.horizon) if steps is None else np.asarray(steps)
    seed, episode = np.indices(reached.shape)
    given = {"seed": seed, "episode": episode, "steps": steps, "reached": reached}
    given |= {"extrinsic_reward": settings.params.goal_reward * reached} | columns
    zero = np.zeros(reached.shape)
    kept = np.ones(reached.shape, bool)
    for one, done in failed:
        kept[one, done:] = False
    arrays = [np.broadcast_to(given.get(field.name, zero), reached.shape)[kept] for field in records.SCHEMA]
    types = [field.type for field in records.SCHEMA]
    columns = [pa.array(values.astype(kind.to_pandas_dtype())) for values, kind in zip(arrays, types, strict=True)]
    table = pa.table(columns, schema=records.SCHEMA)
    summed_up = summary.summarise(settings, table, dict(failed), 0, int(steps.sum()), 1.0, oracle_steps)
    return Result(name, settings, table, summed_up, Path("nowhere"))


def write(made, place):
    """Writes a result as the run folder it could have come from."""
    place.mkdir(parents=True)
    folder.write_config(place, made.settings)
    store._write(place / store.EPISODES, made.table)
    (place / folder.SUMMARY).write_text(json.dumps(made.summary))
