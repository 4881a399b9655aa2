"""Maps with fewer slots than their capacity: the same learners to the bit, however often a chunk needs more of them."""

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from icac_jax.runs import build, capacity, checkpoints, loop, programs, train
from icac_jax.runs.loop import Job, Training
from icac_jax.settings.options import resolve
from tests.test_sweep import Compiles, Killed, killed_after

QUICK = {"algo": "icac", "physics": "kinematic", "seeds": 4, "episodes": 40, "map_capacity": 16, "e_max": 0.6}


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Four slots are enough to begin with, and a training of many chunks."""
    monkeypatch.setattr(capacity, "LEAST", 4)
    monkeypatch.setattr(loop, "CHUNK_STEPS", 100)


def trained(training, lanes=None, progress=None):
    """All episodes, and the lanes at the end."""
    tables = []
    for chunk in training.chunks(training.start() if lanes is None else lanes, progress):
        tables.append(chunk.table)
    return pa.concat_tables(tables), jax.device_get(chunk.lanes)


def same(one, other):
    """Whether states are equal to the bit."""
    leaves = zip(jax.tree.leaves(jax.device_get(one)), jax.tree.leaves(jax.device_get(other)), strict=True)
    plain = [
        [jax.random.key_data(x) if jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key) else x for x in pair]
        for pair in leaves
    ]
    return all(np.array_equal(a, b, equal_nan=np.issubdtype(a.dtype, np.floating)) for a, b in plain)


def both(monkeypatch, jobs, lanes=None):
    """What a training gives with few slots, and with all of them; how many programs the first one was."""
    with Compiles() as compiles:
        few = trained(Training(jobs, lanes))
    monkeypatch.setattr(capacity, "LEAST", 10**6)
    programs.PROGRAMS.clear()
    return few, trained(Training(jobs, lanes)), compiles.number


@pytest.mark.parametrize(
    "options",
    [{}, {"physics": "servo"}, {"predictors": "single", "map_capacity": 64}],
    ids=["kinematic", "servo", "single"],
)
def test_the_same_to_the_bit(options, monkeypatch):
    settings = resolve(**QUICK | options)
    few, every, compiles = both(monkeypatch, loop.jobs_of(settings))
    assert 4 < few[0]["live_nodes"].to_numpy().max() < 16  # more than it began with
    assert compiles >= 2
    assert few[0].equals(every[0])
    assert same(few[1], every[1])


def test_the_same_where_the_map_becomes_full(monkeypatch):
    settings = resolve(**QUICK | {"map_capacity": 8, "e_max": 0.3})
    few, every, _ = both(monkeypatch, loop.jobs_of(settings))
    assert few[0]["overflow"].to_numpy().max() > 0
    assert few[0].equals(every[0])
    assert same(few[1], every[1])


def test_the_same_where_jobs_wait_for_lanes(monkeypatch):
    settings = [resolve(**QUICK | {"e_max": e_max, "episodes": 15}) for e_max in (0.9, 0.6)]
    jobs = [Job(one, seed) for one in settings for seed in range(4)]
    few, every, _ = both(monkeypatch, jobs, 4)
    assert few[0].equals(every[0])
    assert same(few[1], every[1])


@pytest.mark.parametrize("saves", [1, 4])
def test_killed_and_resumed(saves, tmp_path, monkeypatch):
    settings = resolve(**QUICK)
    with monkeypatch.context() as patch:
        killed_after(saves, patch, checkpoints, "save")
        with pytest.raises(Killed):
            train.train(settings, tmp_path / "killed", checkpoint_every=0)
    train.resume(tmp_path / "killed", checkpoint_every=0)
    monkeypatch.setattr(capacity, "LEAST", 10**6)
    train.train(settings, tmp_path / "whole")
    killed, whole = (pq.read_table(tmp_path / name / "episodes.parquet") for name in ("killed", "whole"))
    assert killed.equals(whole)


def test_a_checkpoint_has_all_slots_and_needs_no_more_than_its_nodes():
    training = Training.of_run(resolve(**QUICK))
    chunks = training.chunks(training.start())
    for _ in range(4):
        chunk = next(chunks)
    lanes = jax.device_get(chunk.lanes)
    assert lanes.agent.curiosity.map.weights.shape[1] == 16
    live = np.flatnonzero(lanes.agent.curiosity.map.live.any(axis=0)).max() + 1
    held = capacity.Capacity(training.agent, training.place(lanes), training.fresh)
    assert held.sizes == [4, 8, 16]
    assert live <= held.sizes[held.place] <= 2 * live


@pytest.mark.parametrize(
    "options",
    [{"map": "gng"}, {"map": "som"}, {"algo": "cacla", "map_capacity": None, "e_max": None}, {"map_capacity": 4}],
)
def test_who_needs_all_slots_gets_them(options):
    chosen = {name: value for name, value in (QUICK | options).items() if value is not None}
    if "map" in options:
        del chosen["e_max"]
    if options.get("map") == "som":
        del chosen["map_capacity"]
    training = Training.of_run(resolve(**chosen))
    held = capacity.Capacity(training.agent, training.start(), training.fresh)
    assert held.sizes == []
    assert held.is_whole


def test_a_replay_buffer_is_not_copied_for_a_smaller_map():
    training = Training.of_run(resolve(algo="curious_td3", physics="kinematic", seeds=2, episodes=5))
    assert training.agent.slots is not None
    assert capacity.Capacity(training.agent, training.start(), training.fresh).sizes == []


def test_what_coverage_counts_stays_as_it_is():
    settings = resolve(**QUICK | {"coverage_bins": 10})
    slots = build.agent(settings).slots
    assert slots is not None
    training = Training.of_run(settings)
    lanes = training.start()
    less = capacity.Capacity(training.agent, lanes, training.fresh).cut(lanes)
    assert less.agent.visited.shape == lanes.agent.visited.shape
    assert less.agent.agent.curiosity.bank.params.shape[1] == 4
