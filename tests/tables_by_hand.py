"""Results of runs that never ran: hand-made tables of episodes."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa

from icac_jax.paper import claims
from icac_jax.reports.results import Result
from icac_jax.runs import build, folder, records, store, summary
from icac_jax.settings.options import resolve

# What a learner with curiosity reports.
REPORTED = [
    *(pa.field(name, pa.float32()) for name in ("intrinsic_reward", "learning_progress", "perception_error")),
    *(pa.field(name, pa.int32()) for name in ("live_nodes", "overflow")),
]


def table(settings, given, kept):
    """Episodes [S, E] as a table with the columns that the learner has: those given by name, 0 in the others.

    kept: [S, E] bool, which episodes there are.
    """
    curious = build.agent(settings).map is not None
    schema = pa.schema([*records.SCHEMA, *REPORTED] if curious else records.SCHEMA)
    arrays = [np.broadcast_to(given.get(field.name, 0), kept.shape)[kept] for field in schema]
    columns = [
        pa.array(values.astype(field.type.to_pandas_dtype())) for values, field in zip(arrays, schema, strict=True)
    ]
    return pa.table(columns, schema=schema)


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
    kept = np.ones(reached.shape, bool)
    for one, done in failed:
        kept[one, done:] = False
    episodes = table(settings, given, kept)
    summed_up = summary.summarise(settings, episodes, dict(failed), int(steps.sum()), 1.0, oracle_steps)
    return Result(name, settings, episodes, summed_up, Path("nowhere"))


def write(made, place):
    """Writes a result as the run folder it could have come from."""
    place.mkdir(parents=True)
    folder.write_config(place, made.settings)
    store._write(place / store.EPISODES, [made.table])
    (place / folder.SUMMARY).write_text(json.dumps(made.summary))
