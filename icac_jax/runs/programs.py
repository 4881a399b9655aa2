"""Chunks of steps as compiled programs; the last ones are kept, for the batches of a search."""

import functools
from collections.abc import Hashable
from typing import Any, NamedTuple

import jax
from jax.sharding import Mesh

from icac_jax import rollout
from icac_jax.agents.base import Agent
from icac_jax.envs.base import Environment
from icac_jax.fast import compiling
from icac_jax.rollout import LaneState

# Compiled programs of this process, the newest last.
PROGRAMS: dict[Hashable, Any] = {}
_KEPT = 4


class Chunk(NamedTuple):
    """What a program is compiled for, beside the shapes of its arrays; fields as `rollout.run_chunk` has them.

    Attributes:
      agent: the learner.
      env: the world.
      length: steps.
      mesh: devices.
      blocks: parts of a device's lanes.
      lanes_last: layout of the arrays.
    """

    agent: Agent
    env: Environment
    length: int
    mesh: Mesh
    blocks: int
    lanes_last: bool

    def lowered(self, lanes: LaneState, args: tuple[Any, ...]) -> jax.stages.Lowered:
        """The program for lanes and their numbers, not compiled yet."""
        return rollout.run_chunk.lower(
            self.agent,
            self.env,
            lanes,
            *args,
            length=self.length,
            mesh=self.mesh,
            blocks=self.blocks,
            lanes_last=self.lanes_last,
        )

    def compiled(self, lanes: LaneState, args: tuple[Any, ...]) -> Any:
        """The program for lanes and their numbers: (lanes, *args) -> (lanes, records)."""
        apart = compiling.APART if self.mesh.size > 1 or self.lanes_last else {}
        wide = compiling.WIDE if self.lanes_last else {}
        return compiling.compiled(self.lowered(lanes, args), apart | wide)


def program(chunk: Chunk, lanes: LaneState, args: tuple[Any, ...]) -> Any:
    """The program of a chunk, compiled if it is not among those that are kept."""
    if jax.config.values["jax_disable_jit"]:  # no program then: one operation after the other, to look into them
        return functools.partial(rollout.run_chunk, chunk.agent, chunk.env, length=chunk.length, blocks=chunk.blocks)
    shapes = tuple((leaf.shape, leaf.dtype) for leaf in jax.tree.leaves((lanes, args)))
    if (chunk, shapes) not in PROGRAMS:
        while len(PROGRAMS) >= _KEPT:
            del PROGRAMS[next(iter(PROGRAMS))]
        PROGRAMS[chunk, shapes] = chunk.compiled(lanes, args)
    return PROGRAMS[chunk, shapes]
