"""Damage done to files, as disks, editors and strangers do it; for the fuzzer and for tests."""

import json
import os
import shutil

SCALARS = [
    None,
    True,
    0,
    -1,
    2,
    10**400,
    1e308,
    float("nan"),
    "",
    "x",
    "icac",
    "\x1b[31m\n",
    "m$x^{$",
    [],
    {},
    [[]],
    "é" * 300,
]


def _bytes(path, change):
    data = bytearray(path.read_bytes()) or bytearray(b" ")
    change(data)
    path.write_bytes(data)


def empty(path, rng):
    path.write_bytes(b"")


def cut(path, rng):
    data = path.read_bytes()
    path.write_bytes(data[: rng.randrange(len(data) + 1)])


def flipped(path, rng):
    def change(data):
        for _ in range(rng.choice([1, 1, 3, 50])):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)

    _bytes(path, change)


def spliced(path, rng):
    def change(data):
        at, other = rng.randrange(len(data)), rng.randrange(len(data))
        data[at : at + rng.randrange(20)] = data[other : other + rng.randrange(40)]

    _bytes(path, change)


def huge(path, rng):
    with path.open("r+b") as file:  # a hole: no bytes on the disk
        file.truncate(2**33)


def other_kind(path, rng):
    text = rng.choice(["hello", "[]", "{}", "3", '"x"', "[[", "a = 1", "<mujoco/>", "PK\x03\x04", "PAR1"])
    path.write_text(text)


def pipe(path, rng):
    path.unlink()
    os.mkfifo(path)


def link(path, rng):
    path.unlink()
    path.symlink_to(rng.choice(["/dev/zero", "/dev/full", "nowhere", path.name, "/"]))


def directory(path, rng):
    path.unlink()
    path.mkdir()


def gone(path, rng):
    path.unlink()


def value(path, rng):
    """One value within a JSON text, or one line of a text of lines, is something else."""
    lines = path.read_text(errors="replace").splitlines()
    if not lines:
        return
    try:
        facts = json.loads("\n".join(lines))
    except ValueError:
        at = rng.randrange(len(lines))
        name, equals, _ = lines[at].partition("=")
        lines[at] = f"{name}= {json.dumps(rng.choice(SCALARS))}" if equals else rng.choice(["", "{}", lines[at][:-1]])
        path.write_text("\n".join(lines), errors="replace")
        return
    path.write_text(json.dumps(_changed(facts, rng)))


def _changed(facts, rng):
    if facts and isinstance(facts, dict | list) and rng.random() < 0.85:
        key = rng.choice(list(facts)) if isinstance(facts, dict) else rng.randrange(len(facts))
        if rng.random() < 0.1:
            del facts[key]
        else:
            facts[key] = _changed(facts[key], rng)
        return facts
    return rng.choice(SCALARS)


KINDS = (empty, cut, flipped, spliced, huge, other_kind, pipe, link, directory, gone, value, value, value)


def do(path, rng):
    """Damages a file; returns how."""
    kind = rng.choice(KINDS)
    kind(path, rng)
    return kind.__name__


def copy(source, target):
    """A copy to be damaged."""
    shutil.copytree(source, target)
    return target
