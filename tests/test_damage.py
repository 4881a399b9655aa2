"""Damage to files of runs and sweeps is refused in one line or harmless; `make fuzz` goes on longer."""

import os
import random

import pytest

from tests import damage, fuzz


@pytest.fixture(scope="module")
def fuzzer(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        place = tmp_path_factory.mktemp("damage")
        patch.setenv("XDG_CACHE_HOME", str(place / "cache"))
        yield fuzz.Fuzzer(place)


@pytest.mark.slow
@pytest.mark.parametrize("kind", damage.KINDS[:-2], ids=lambda kind: kind.__name__)
def test_each_damage_to_some_files(kind, fuzzer, monkeypatch):
    """Those files that commands answer at once."""
    monkeypatch.setattr(damage, "KINDS", (kind,))
    rng = random.Random(kind.__name__)
    for whole, commands in (
        (fuzzer.run, [["runs"], ["export", "--out", fuzzer.place / "p.npz"]]),
        (fuzzer.sweep, [["best"]]),
    ):
        for _ in range(2):
            fuzzer.folder("folder", whole, commands, rng)
            fuzz.clean(fuzzer.place)
    for once in (fuzzer.study, fuzzer.config, fuzzer.arm):
        once(rng)
        fuzz.clean(fuzzer.place)
    assert fuzzer.faults == []


def test_a_fault_is_seen(monkeypatch):
    """The fuzzer notices a traceback, a wrong status, a second line and a hang."""
    from icac_jax.cli import main

    def raising(args):
        raise KeyError

    def hanging(args):
        while True:
            os.getpid()

    for broken in (raising, hanging, lambda args: 7, lambda args: print("a\nb") or 2):
        monkeypatch.setattr(main, "main", broken)
        assert fuzz.call("runs", seconds=1)[2] is not None
