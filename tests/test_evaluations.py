"""`icac train --evaluate-every`: it changes nothing in the training, and survives being stopped."""

import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from icac_jax.errors import DamagedError
from icac_jax.fields import ConfigError
from icac_jax.policies import evaluate, saved
from icac_jax.runs import best_policies, checkpoints, evaluations, session, train
from icac_jax.runs.loop import Training
from icac_jax.settings.options import resolve

SETTINGS = resolve(physics="kinematic", algo="cacla_var", seeds=2, episodes=70, joint_high=(90.0, 90.0))


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch):
    monkeypatch.setattr("icac_jax.runs.loop.CHUNK_STEPS", 100)


def arrays(folder):
    with np.load(checkpoints.listed(folder / "checkpoints")[-1]) as archive:
        return {name: archive[name] for name in archive.files if name != "meta"}


def same_training(one, other):
    assert pq.read_table(one / "episodes.parquet").equals(pq.read_table(other / "episodes.parquet"))
    first, second = arrays(one), arrays(other)
    assert all(first[name].tobytes() == second[name].tobytes() for name in first)


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    folder = tmp_path_factory.mktemp("evaluated") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("icac_jax.runs.loop.CHUNK_STEPS", 100)
        train.train(SETTINGS, folder, 0, evaluate_every=10)
    return folder


def test_rows_and_no_change_in_the_training(evaluated, tmp_path):
    train.train(SETTINGS, tmp_path / "plain")
    same_training(evaluated, tmp_path / "plain")
    rows = evaluations.read(evaluated)
    assert not (tmp_path / "plain" / evaluations.FILE).exists()
    passed = [row["passed"] for row in rows if row["seed"] == 0]
    assert passed == sorted(set(passed))
    assert passed[-1] == 70
    assert len(passed) >= 4
    assert [row["seed"] for row in rows] == [0, 1] * len(passed)
    assert all(row["passed"] <= row["episode"] <= 70 for row in rows)


def test_the_last_row_is_what_icac_evaluate_finds(evaluated):
    found = evaluate.evaluate(evaluated, evaluations.PAIRS)
    last = evaluations.read(evaluated)[-2:]
    for name in ("success_rate", "steps", "final_distance"):
        assert found["by_seed"][name] == pytest.approx([row[name] for row in last])


class Killed(Exception):
    pass


def best_file(folder):
    with np.load(folder / best_policies.FILE) as archive:
        return {name: archive[name].tobytes() for name in archive.files}


def test_a_killed_run_has_each_row_once(evaluated, tmp_path, monkeypatch):
    """Killed after rows were written that the last checkpoint does not know of; a half-written line besides."""
    folder = tmp_path / "run"
    chunks = Training.chunks

    def dies(self, lanes, progress):
        for number, chunk in enumerate(chunks(self, lanes, progress)):
            if number == 14:
                raise Killed
            yield chunk

    saves = session.Session._save
    monkeypatch.setattr(Training, "chunks", dies)
    monkeypatch.setattr(session.Session, "_save", lambda self, chunk, note: early(self, chunk, note))

    def early(self, chunk, note):
        if chunk.episodes_done.min() < 15:
            saves(self, chunk, note)

    with pytest.raises(Killed):
        train.train(SETTINGS, folder, 0, evaluate_every=10)
    before = {row["passed"] for row in evaluations.read(folder)}
    assert max(before) >= 20
    with (folder / evaluations.FILE).open("a") as file:
        file.write('{"passed": 30, "se')
    monkeypatch.setattr(Training, "chunks", chunks)
    monkeypatch.setattr(session.Session, "_save", saves)
    train.resume(folder)
    same_training(folder, evaluated)
    assert evaluations.read(folder) == evaluations.read(evaluated)
    assert (folder / evaluations.FILE).read_bytes() == (evaluated / evaluations.FILE).read_bytes()
    assert best_file(folder) == best_file(evaluated)


def test_each_seeds_best_policy_is_kept_and_taken(evaluated):
    rows = evaluations.read(evaluated)
    best = [
        max((r for r in rows if r["seed"] == seed), key=lambda r: (r["success_rate"], -r["steps"])) for seed in (0, 1)
    ]
    newest = evaluate.evaluate(evaluated, evaluations.PAIRS)
    kept = evaluate.evaluate(evaluated, evaluations.PAIRS, seed=0, policy="best")
    for name in ("success_rate", "steps", "final_distance"):
        assert kept["by_seed"][name] == pytest.approx([row[name] for row in best])
    assert kept["episodes_trained"] == [row["episode"] for row in best]
    # Chosen on some pairs, it is judged on others.
    assert (newest["pair_seed"], evaluate.evaluate(evaluated, 3, policy="best")["pair_seed"]) == (0, 1)
    first = min((0, 1), key=lambda seed: (-best[seed]["success_rate"], best[seed]["steps"]))
    learner = saved.pick(evaluated, policy="best")
    assert (learner.seed, learner.episodes) == (first, best[first]["episode"])


def test_what_is_kept_is_small_and_refused_where_it_is_not_there_or_damaged(tmp_path):
    settings = resolve(physics="kinematic", algo="td3", seeds=2, episodes=12, buffer_size=512, warm_up=20)
    train.train(settings, tmp_path / "run", evaluate_every=5)
    states, _ = evaluate.learners(tmp_path / "run", settings)
    assert all(name.startswith("learned.actor.") for name in best_policies.acting(settings, states))
    train.train(settings, tmp_path / "plain")
    with pytest.raises(ConfigError, match="policy: best needs an evaluation of every seed"):
        evaluate.evaluate(tmp_path / "plain", 3, policy="best")
    with pytest.raises(ConfigError, match="policy: must be one of newest, best, got 'last'"):
        evaluate.evaluate(tmp_path / "plain", 3, policy="last")
    file = tmp_path / "run" / best_policies.FILE
    shutil.copy(file, tmp_path / "plain")
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(DamagedError, match=r"best\.npz: not a readable"):
        evaluate.evaluate(tmp_path / "run", 3, policy="best")
    np.savez(file, **{"agent.other": np.zeros(2), **dict.fromkeys(("success_rate", "steps", "episode"), np.zeros(2))})
    with pytest.raises(DamagedError, match=r"best\.npz: not the best policies of this run"):
        evaluate.evaluate(tmp_path / "run", 3, policy="best")


def test_better_is_more_success_then_fewer_steps_then_earlier():
    def better(best, success_rate, steps, episode):
        parts = {"actor": np.array([[episode], [episode]])}
        return best_policies.better(best, np.array(success_rate), np.array(steps), np.array([episode, episode]), parts)

    best = better(None, [0.5, np.nan], [20.0, 20.0], 1)
    assert best.known.tolist() == [True, False]
    best = better(best, [0.5, 0.1], [20.0, 45.0], 2)
    assert best.episode.tolist() == [1, 2]
    best = better(best, [0.5, 0.0], [19.0, 50.0], 3)
    best = better(best, [np.nan, np.nan], [0.0, 0.0], 4)
    assert best.episode.tolist() == best.parts["actor"][:, 0].tolist() == [3, 2]
