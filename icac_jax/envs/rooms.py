"""Ways through joint space between walls: how many control steps away each place is, by search on a grid.

Only joints that some box keeps from part of their range are searched, W of them. The others are free: a step moves
every joint at once, so the number of steps to a place is the larger of what the walls ask for and what the free joints
do. K is the number of boxes, J the number of joints.
"""

import functools
import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from icac_jax.envs import walls

# Grid steps per action bound by the number of joints that are searched, fewer where there would be too many nodes.
_PER_STEP = {1: 10, 2: 5, 3: 2}
_MOST_NODES = 400_000
# For what can be reached at all: grid steps per cell that is asked for.
_PER_CELL = 4


class Space(NamedTuple):
    """Joint space with walls, hashable.

    Attributes:
      low: [J] lower joint limits, rad.
      high: [J] upper joint limits, rad.
      walls: [2 K J] the boxes as `walls.boxes` takes them, rad.
      bound: largest joint change of a control step, rad.
      start: [J] where all ways begin, rad.
    """

    low: tuple[float, ...]
    high: tuple[float, ...]
    walls: tuple[float, ...]
    bound: float
    start: tuple[float, ...]

    @property
    def boxes(self) -> np.ndarray:
        """The boxes, [K, 2, J]."""
        return walls.boxes(np.asarray(self.walls, float), len(self.low))

    @property
    def searched(self) -> np.ndarray:
        """[W] the joints that boxes divide."""
        boxes = self.boxes
        return np.flatnonzero(np.any((boxes[:, 0] > self.low) | (boxes[:, 1] < self.high), axis=0))


class Ways(NamedTuple):
    """The places on the grid that can be reached.

    Attributes:
      joints: [N, W] their angles of the searched joints, rad.
      steps: [N] least control steps to each on the grid; 0 at the start.
    """

    joints: np.ndarray
    steps: np.ndarray


@functools.lru_cache(maxsize=64)
def ways(space: Space, per_step: int = 0) -> Ways:
    """Every place of the grid that can be reached, and in how many control steps.

    The grid has the start as a node, and `per_step` of its steps are one action bound: 5 with two searched joints, so 2
    degrees with a bound of 10. A control step goes from a node to any node within the bound, on a line that touches no
    box. Each way found can be gone, so no place is nearer than the number of steps to it says; it may be one or two
    steps nearer still, where the best way bends between nodes.

    Args:
      space: joint space, with the start outside all boxes.
      per_step: grid steps per action bound; 0 for the usual ones.
    """
    joints = space.searched
    span = np.asarray(space.high)[joints] - np.asarray(space.low)[joints]
    fine = per_step or _PER_STEP.get(len(joints), 1)
    while not per_step and fine > 1 and np.prod(span / space.bound * fine + 1) > _MOST_NODES:
        fine -= 1
    return _searched(space, np.full(len(joints), space.bound / fine), fine)


@functools.lru_cache(maxsize=16)
def reachable(space: Space, bins: int) -> np.ndarray:
    """Which cells of a grid over the joints' range hold a place that can be reached, [bins] * J bool.

    Cell n of a joint is what lies between n and n + 1 times its range / bins above its lower limit. Places are searched
    for on a grid of a fourth of a cell: of a cell that a wall fills but for a narrower rim it may miss the rim.

    Args:
      space: joint space, with the start outside all boxes.
      bins: cells per joint.
    """
    joints = space.searched
    low, span = np.asarray(space.low), np.asarray(space.high) - np.asarray(space.low)
    found = _searched(space, span[joints] / (bins * _PER_CELL), 1).joints
    cells = np.clip(((found - low[joints]) / span[joints] * bins + 1e-9).astype(int), 0, bins - 1)
    grid = np.zeros((bins,) * len(joints), bool)
    grid[tuple(cells.T)] = True
    shape = [bins if joint in joints else 1 for joint in range(len(low))]
    return np.broadcast_to(grid.reshape(shape), (bins,) * len(low)).copy()


def _searched(space: Space, pitch: np.ndarray, hops: int) -> Ways:
    """Breadth-first search from the start, on a grid through it.

    Args:
      space: joint space.
      pitch: [W] distance of neighbours on the grid, rad.
      hops: how many of them a step may go along each joint.
    """
    joints, boxes = space.searched, space.boxes
    if not len(joints):
        return Ways(np.zeros((1, 0)), np.zeros(1, int))
    start = np.asarray(space.start)[joints]
    slack = 1e-9  # a limit that is a whole number of grid steps away is a node
    below = np.floor((start - np.asarray(space.low)[joints]) / pitch + slack).astype(int)
    above = np.floor((np.asarray(space.high)[joints] - start) / pitch + slack).astype(int)
    lines = [place + step * np.arange(-b, a + 1) for place, step, b, a in zip(start, pitch, below, above, strict=True)]
    nodes = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    moves = list(_moves(nodes, boxes[:, :, joints], pitch, hops))
    steps = np.full(nodes.shape[:-1], -1)
    front = np.zeros(nodes.shape[:-1], bool)
    front[tuple(below)] = True
    for step in itertools.count():
        steps[front] = step
        reached = np.zeros_like(front)
        for source, target, free in moves:
            reached[target] |= front[source] & free
        front = reached & (steps < 0)
        if not front.any():
            break
    known = steps >= 0
    return Ways(nodes[known], steps[known])


def _moves(
    nodes: np.ndarray, boxes: np.ndarray, pitch: np.ndarray, hops: int
) -> Iterator[tuple[tuple[slice, ...], tuple[slice, ...], np.ndarray]]:
    """Each move of a step on a grid: the slice where it begins, that where it ends, and where it is free.

    Args:
      nodes: [*grid, W] joint angles, rad.
      boxes: [K, 2, W] in rad.
      pitch: [W] distance of neighbours, rad.
      hops: how many of them a step may go along each joint.
    """
    size, reach = nodes.shape[:-1], hops * pitch
    near = walls.within(nodes, boxes + np.stack([-reach, reach]))  # only from there can a move touch a box
    for offset in itertools.product(range(-hops, hops + 1), repeat=len(size)):
        if any(offset):
            source = tuple(slice(max(0, -o), max(0, n - max(0, o))) for o, n in zip(offset, size, strict=True))
            target = tuple(slice(max(0, o), max(0, n + min(0, o))) for o, n in zip(offset, size, strict=True))
            free = np.ones(nodes[source].shape[:-1], bool)
            where = near[source]
            free[where] = ~walls.blocked(nodes[source][where], nodes[target][where], boxes)
            yield source, target, free
