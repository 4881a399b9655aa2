"""`icac train --evaluate-every`: it changes nothing in the training, and survives being stopped."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from icac_jax.policies import evaluate
from icac_jax.runs import checkpoints, evaluations, session, train
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
