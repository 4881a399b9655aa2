"""Crashes before and after every act on the disk: what a kill at that moment would leave, and that nothing is lost."""

import contextlib
import os
import shutil


class Crash(BaseException):
    """Stands for a kill: nothing catches it."""


# By these everything of this package changes a disk; Path's and shutil's functions end in them too.
ACTS = ("replace", "rename", "fsync", "ftruncate", "unlink", "rmdir", "mkdir")


def crashing_at(monkeypatch, number):
    """Lets the process die at its `number`-th act on the file system, before the act or after it; counts them."""
    count = 0

    def guard(name):
        act = getattr(os, name)

        def guarded(*args, **options):
            nonlocal count
            count += 1
            if count == number:
                raise Crash
            done = act(*args, **options)
            count += 1
            if count == number:
                raise Crash
            return done

        monkeypatch.setattr(os, name, guarded)

    for name in ACTS:
        guard(name)
    return lambda: count


def every(monkeypatch, base, place, begin, again, check, numbers=None, step=1):
    """Dies at one act after the other, each time from the same beginning, and goes on.

    Args:
      monkeypatch: pytest's.
      base: a folder that each try begins with a copy of, or None for no folder.
      place: where the tries lie.
      begin: (folder) -> None, what is killed.
      again: (folder) -> None, what a user does then.
      check: (folder, number) -> None, asserts that nothing is lost.
      numbers: the acts; by default all of them.
      step: where all of them are too many, every how many of them.

    Returns:
      How many crashes there were, and how many acts there are.
    """
    crashes, acts = 0, None
    for number in numbers if numbers is not None else range(1, 10**6, step):
        folder = place / f"try{number}"
        if base is not None:
            shutil.copytree(base, folder)
        with monkeypatch.context() as patched:
            count = crashing_at(patched, number)
            try:
                begin(folder)
                acts = count()
            except Crash:
                crashes += 1
        again(folder)
        check(folder, number)
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(folder)
        if acts is not None and numbers is None:
            break
    return crashes, acts
