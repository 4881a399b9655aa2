"""The host loop around compiled chunks: no files, no terminal; what happens between chunks is the caller's."""

import time
from collections.abc import Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
from jax.sharding import Mesh

from icac_jax import rollout
from icac_jax.envs import reach
from icac_jax.experiment import devices, records
from icac_jax.experiment.settings import Settings
from icac_jax.rollout import LaneState

CHUNK_STEPS = 500
# Records of one chunk stay under about this many steps x lanes.
_CHUNK_ENTRIES = 5_000_000


class Chunk(NamedTuple):
    """What the loop tells after each chunk.

    Attributes:
      lanes: the state of all lanes, padding included; valid until the next chunk is asked for.
      table: the episodes that ended in the chunk (`records.SCHEMA`).
      episodes_done: [S] finished episodes of each seed.
      failed: [S] bool, lanes frozen because a number stopped being finite.
      lane_steps: steps taken so far by running lanes.
      seconds: time spent in chunks so far, compilation left out.
    """

    lanes: LaneState
    table: pa.Table
    episodes_done: np.ndarray
    failed: np.ndarray
    lane_steps: int
    seconds: float


class Training:
    """A run on this machine's devices: compiled once, stepped chunk by chunk.

    Args:
      settings: of the run.
      mesh: devices to spread the lanes over; all of them by default.
    """

    def __init__(self, settings: Settings, mesh: Mesh | None = None) -> None:
        self.settings = settings
        run = settings.run
        self.mesh = mesh if mesh is not None else devices.lane_mesh(run.seeds)
        self.env = reach.make(settings.arm, run.physics, run.sub_steps)
        # Padding lanes fill the mesh evenly; they run no episode.
        padded = -(-run.seeds // self.mesh.size) * self.mesh.size
        self.seeds = np.arange(padded, dtype=np.int32)
        episodes = np.where(self.seeds < run.seeds, run.episodes, 0).astype(np.int32)
        where = devices.over_lanes(self.mesh)
        self.episodes = jax.device_put(episodes, where)
        self.hyper = jax.device_put(rollout.broadcast(settings.hyper.traced(), padded), where)
        self.params = jax.device_put(rollout.broadcast(settings.params.traced(), padded), where)
        self.length = max(1, min(CHUNK_STEPS, _CHUNK_ENTRIES // padded))

    def start(self) -> LaneState:
        """Fresh lanes, laid out over the mesh."""
        lanes = rollout.init_lanes(
            self.settings.spec,
            self.env,
            jax.random.key(self.settings.run.root_seed),
            jnp.asarray(self.seeds),
            self.hyper,
            self.params,
        )
        return self.place(lanes)

    def place(self, lanes: LaneState) -> LaneState:
        """Lays lanes out over the mesh."""
        return jax.device_put(lanes, devices.over_lanes(self.mesh))

    def chunks(self, lanes: LaneState) -> Iterator[Chunk]:
        """Runs until every lane has finished or failed, one chunk at a time.

        Args:
          lanes: where to begin; consumed.
        """
        spec, run = self.settings.spec, self.settings.run
        args = (spec, self.env, lanes, self.hyper, self.params, self.episodes)
        compiled = rollout.run_chunk.lower(*args, length=self.length, mesh=self.mesh).compile()
        seconds = 0.0
        while True:
            started = time.perf_counter()
            lanes, log = compiled(lanes, self.hyper, self.params, self.episodes)
            log, done, failed, steps = jax.device_get((log, lanes.episode, lanes.failed, lanes.step))
            seconds += time.perf_counter() - started
            chunk = Chunk(
                lanes=lanes,
                table=records.rows(log, self.seeds),
                episodes_done=done[: run.seeds],
                failed=failed[: run.seeds],
                lane_steps=int(steps.sum()),
                seconds=seconds,
            )
            yield chunk
            if self.is_over(chunk):
                return

    def has_finished(self, lanes: LaneState) -> bool:
        """Whether lanes on the host have nothing left to do."""
        run = self.settings.run
        done, failed = np.asarray(lanes.episode)[: run.seeds], np.asarray(lanes.failed)[: run.seeds]
        return bool(np.all(failed | (done >= run.episodes)))

    def is_over(self, chunk: Chunk) -> bool:
        """Whether every lane has finished or failed."""
        return bool(np.all(chunk.failed | (chunk.episodes_done >= self.settings.run.episodes)))

    def overflow(self, lanes: LaneState) -> int:
        """Nodes that could not be created because a map was full, over all lanes."""
        curious = lanes.agent.curiosity
        return 0 if curious is None else int(np.sum(jax.device_get(curious.map.overflow)))
