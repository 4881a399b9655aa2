"""How far work is that several processes share: each says it of its own share, and all read what the others say."""

import dataclasses
import time
from collections.abc import Iterable
from pathlib import Path

from icac_jax.runs import folder as run_folder

# Folders may lie on a network, and a sweep may have thousands of shares.
_READ_EVERY = 10.0


def episodes_done(shares: Iterable[Path]) -> int:
    """Episodes that the processes of some shares have finished, by what they said last; 0 for one that said nothing.

    Args:
      shares: folders, each with the `status.json` of a share.
    """
    said = (run_folder.read_json(share / run_folder.STATUS).get("episodes_done") for share in shares)
    return sum(count for count in said if isinstance(count, int))


@dataclasses.dataclass
class Share:
    """The part of this process in work that it shares with others.

    Attributes:
      folder: where it says how far it is.
      others: the same of the others.
      leads: whether it also says how far the whole is, in the folder of the whole.
    """

    folder: Path
    others: tuple[Path, ...]
    leads: bool

    def __post_init__(self) -> None:
        self._read, self._count = -_READ_EVERY, 0

    def elsewhere(self) -> int:
        """Episodes that the others have finished, some seconds old."""
        now = time.monotonic()
        if now - self._read >= _READ_EVERY:
            self._read, self._count = now, episodes_done(self.others)
        return self._count
