"""The host loop around compiled chunks: no files, no terminal; what happens between chunks is the caller's.

A job is one learner to be trained: settings and a seed. Jobs that share a program run together, each in a lane of its
own; when there are more jobs than lanes, the next job takes over the lane of one that has ended, without a recompile.
J is the number of jobs, L the number of lanes.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
from jax.sharding import Mesh

from icac_jax import rollout
from icac_jax.agents import imitation
from icac_jax.agents.base import Agent
from icac_jax.agents.imitation import Demonstrations
from icac_jax.envs.base import Environment
from icac_jax.fields import stacked
from icac_jax.rollout import LaneState
from icac_jax.runs import build, capacity, demonstrations, devices, programs, records, warm_maps
from icac_jax.runs.capacity import Capacity
from icac_jax.runs.warm_maps import WarmMap
from icac_jax.settings.options import Settings

CHUNK_STEPS = 500
# Records of one chunk stay under about this many steps x lanes.
_CHUNK_ENTRIES = 5_000_000
_NO_JOB = -1


class Job(NamedTuple):
    """One learner to be trained.

    Attributes:
      settings: its numbers; `settings.run.episodes` is how long it trains.
      seed: its randomness, within `settings.run.root_seed`.
    """

    settings: Settings
    seed: int


class Progress(NamedTuple):
    """How far the jobs are, on the host.

    Attributes:
      slots: [L] int32, the job in each lane; -1 in a lane that only fills the mesh.
      begun: jobs that have had a lane so far; the others wait in order.
      episodes_done: [J] finished episodes of each job.
      failed: [J] bool, jobs that diverged; their lanes are frozen.
      steps: [J] steps taken.
    """

    slots: np.ndarray
    begun: int
    episodes_done: np.ndarray
    failed: np.ndarray
    steps: np.ndarray


class Chunk(NamedTuple):
    """What the loop tells after each chunk.

    Attributes:
      progress: how far the jobs are.
      table: the episodes that ended in the chunk (see `records`); its column `seed` holds numbers of jobs.
      seconds: time spent in chunks so far, compilation left out.
      whole: () -> `lanes`.
    """

    progress: Progress
    table: pa.Table
    seconds: float
    whole: Callable[[], LaneState]

    @property
    def lanes(self) -> LaneState:
        """The state of all lanes, padding included; valid until the next chunk is asked for."""
        return self.whole()

    @property
    def episodes_done(self) -> np.ndarray:
        """[J] finished episodes of each job."""
        return self.progress.episodes_done

    @property
    def failed(self) -> np.ndarray:
        """[J] bool, jobs that diverged: a number of theirs stopped being finite."""
        return self.progress.failed

    @property
    def lane_steps(self) -> int:
        """Steps taken so far by all jobs."""
        return int(self.progress.steps.sum())


def jobs_of(settings: Settings) -> list[Job]:
    """A run's jobs: job k has seed k."""
    return [Job(settings, seed) for seed in range(settings.run.seeds)]


def program(settings: Settings) -> Hashable:
    """What settings must share to run in one compiled program."""
    # All of a run but what a job says for itself or what has gone into the other records already.
    run = dataclasses.replace(settings.run, seeds=1, episodes=1, preset="", task="")
    shapes = len(settings.params.walls), settings.goals.goal_per == "seed" or bool(settings.params.goal_joints)
    return run, settings.spec, shapes


@functools.partial(jax.jit, donate_argnames="lanes")
def _exchange(lanes: LaneState, fresh: LaneState, anew: jax.Array) -> LaneState:
    """Puts fresh lanes in where `anew` [L] says so."""

    def one(old: jax.Array, new: jax.Array) -> jax.Array:
        return jnp.where(anew.reshape(anew.shape + (1,) * (old.ndim - 1)), new, old)

    return jax.tree.map(one, lanes, fresh)


class Loop:
    """Any agent in any environment on this machine's devices: compiled once, stepped chunk by chunk.

    Args:
      agent: who learns.
      env: where.
      hyper: traced numbers of the agent, leaves [J, ...].
      params: traced numbers of the environment, leaves [J, ...].
      seeds: [J] int32, within `root_seed`.
      episodes: [J] int32, how long each job trains.
      root_seed: randomness of the whole.
      lanes: how many train at once; all of them by default.
      mesh: devices to spread the lanes over; all of them by default.
      shown: gives what the learners are shown before they train, leaves [J, ...]; called when lanes are begun. None for
        nothing.
      warm: the map that lanes start with; a fresh one by default.
    """

    def __init__(
        self,
        agent: Agent,
        env: Environment,
        hyper: Any,
        params: Any,
        seeds: np.ndarray,
        episodes: np.ndarray,
        root_seed: int = 0,
        lanes: int | None = None,
        mesh: Mesh | None = None,
        shown: Callable[[], Demonstrations] | None = None,
        warm: WarmMap | None = None,
    ) -> None:
        number = len(seeds)
        self._shown = None if shown is None else functools.cache(shown)
        self.warm = warm
        if warm is not None:
            warm.rows(np.asarray(seeds))  # says what is missing before anything is compiled
        self.agent, self.env, self.root_seed = agent, env, root_seed
        self.seeds, self.episodes = np.asarray(seeds, np.int32), np.asarray(episodes, np.int32)
        self._hyper, self._params = hyper, params
        self.width = min(lanes or number, number)
        self.mesh = mesh if mesh is not None else devices.lane_mesh(self.width)
        # Padding lanes fill the devices and their blocks evenly; they have no job and run no episode.
        large = bool(agent.flops)
        self._blocks, self.padded = devices.blocks(self.width, self.mesh, large)
        self._lanes_last = devices.lanes_last(large)
        self.length = max(1, min(CHUNK_STEPS, _CHUNK_ENTRIES // self.padded))

    @property
    def program(self) -> programs.Chunk:
        """What a chunk of `length` steps is compiled for."""
        return programs.Chunk(self.agent, self.env, self.length, self.mesh, self._blocks, self._lanes_last)

    def first(self) -> Progress:
        """Nothing done yet; the first jobs are in the lanes."""
        number = len(self.seeds)
        slots = np.where(np.arange(self.padded) < self.width, np.arange(self.padded), _NO_JOB).astype(np.int32)
        done, steps = np.zeros(number, np.int64), np.zeros(number, np.int64)
        return Progress(slots, self.width, done, np.zeros(number, bool), steps)

    def on_lanes(self, slots: np.ndarray) -> tuple[Any, Any, jax.Array]:
        """Traced numbers of learner and task, and episodes to run, of the jobs in the lanes; leaves [L, ...]."""
        jobs = np.maximum(slots, 0)
        episodes = np.where(slots >= 0, self.episodes[jobs], 0).astype(np.int32)
        hyper, params = jax.tree.map(lambda leaf: leaf[jobs], (self._hyper, self._params))
        return jax.device_put((hyper, params, episodes), devices.over_lanes(self.mesh))

    def start(self, slots: np.ndarray | None = None) -> LaneState:
        """Lanes at the beginning of the jobs in the lanes, laid out over the mesh; of the first jobs by default."""
        slots = self.first().slots if slots is None else slots
        lanes = self.fresh(slots)
        if self.warm is not None:
            lanes = self.place(self.warm.onto(lanes, self.seeds[np.maximum(slots, 0)]))
        if self._shown is None:
            return lanes
        jobs = np.maximum(slots, 0)
        shown = jax.tree.map(lambda leaf: leaf[jobs], self._shown())
        shown = jax.device_put(shown, devices.over_lanes(self.mesh))
        hyper, params, _ = self.on_lanes(slots)
        taught = imitation.imitated(self.agent, self.env, lanes.agent, shown, lanes.noise_key, hyper, params)
        return self.place(lanes.replace(agent=taught))

    def fresh(self, slots: np.ndarray | None = None) -> LaneState:
        """Lanes as in `start`, but of learners that know nothing yet: what has the structure of a checkpoint."""
        slots = self.first().slots if slots is None else slots
        hyper, params, _ = self.on_lanes(slots)
        seeds = self.seeds[np.maximum(slots, 0)]
        root = jax.random.key(self.root_seed)
        lanes = rollout.init_lanes(self.agent, self.env, root, jnp.asarray(seeds), hyper, params)
        return self.place(lanes)

    def place(self, lanes: LaneState) -> LaneState:
        """Lays lanes out over the mesh."""
        return jax.device_put(lanes, devices.over_lanes(self.mesh))

    def reached(self, lanes: LaneState) -> Progress:
        """How far lanes on the host are whose jobs are still the first ones, as in every run of one setting."""
        start, number = self.first(), self.width
        for name, leaf in (("episodes_done", lanes.episode), ("failed", lanes.failed), ("steps", lanes.step)):
            getattr(start, name)[:number] = np.asarray(leaf)[:number]  # jobs beyond these still wait for a lane
        return start

    def chunks(self, lanes: LaneState, progress: Progress | None = None) -> Iterator[Chunk]:
        """Runs until every job has finished or failed, one chunk at a time.

        Args:
          lanes: where to begin; consumed.
          progress: how far the jobs are; nothing done by default.
        """
        progress = self.first() if progress is None else progress
        args = self.on_lanes(progress.slots)
        fresh = (
            None if self.warm is None and not progress.steps.any() else functools.partial(self.fresh, progress.slots)
        )
        waiting = self.warm is not None and progress.begun < len(self.seeds)
        map_slots = Capacity(self.agent, lanes, fresh, waiting)
        lanes = map_slots.cut(lanes)
        seconds = 0.0
        while True:
            slots, begun = self._next_slots(progress)
            if begun > progress.begun:
                args = self.on_lanes(slots)
                anew = jax.device_put(slots != progress.slots, devices.over_lanes(self.mesh))
                lanes = _exchange(lanes, map_slots.cut(self.start(slots)), anew)
            lanes, log, spent = self._chunk(map_slots, lanes, args, slots)
            progress = _noted(progress._replace(slots=slots, begun=begun), log)
            seconds += spent
            yield Chunk(
                progress, records.rows(log[0], slots), seconds, functools.partial(self._whole, map_slots, lanes, slots)
            )
            if self.is_over(progress):
                return

    def _chunk(self, map_slots: Capacity, lanes: LaneState, args: tuple[Any, ...], slots: np.ndarray) -> Any:
        """A chunk, with more slots of the map where it needs them: lanes, what the host reads of them, seconds."""
        while True:
            program = programs.program(self.program, lanes, args)
            started = time.perf_counter()
            kept = None if map_slots.is_whole else capacity.copied(lanes)
            ran, log = program(lanes, *args)
            read = jax.device_get((log, ran.episode, ran.failed, ran.step))
            seconds = time.perf_counter() - started
            if kept is None or not map_slots.lacked(kept, ran):
                return ran, read, seconds
            lanes = map_slots.more(kept, self.fresh(slots))

    def _whole(self, map_slots: Capacity, lanes: LaneState, slots: np.ndarray) -> LaneState:
        """The lanes of a chunk with all slots of their maps."""
        return lanes if map_slots.is_whole else self.place(capacity.whole(lanes, self.fresh(slots)))

    def _next_slots(self, progress: Progress) -> tuple[np.ndarray, int]:
        """Who is in the lanes next: waiting jobs take the lanes of those that have ended, in order."""
        held = np.maximum(progress.slots, 0)
        ended = (progress.slots >= 0) & self._ended(progress)[held]
        free = np.flatnonzero(ended)[: len(self.seeds) - progress.begun]
        slots = progress.slots.copy()
        slots[free] = progress.begun + np.arange(len(free))
        return slots, progress.begun + len(free)

    def _ended(self, progress: Progress) -> np.ndarray:
        return progress.failed | (progress.episodes_done >= self.episodes)

    def is_over(self, progress: Progress) -> bool:
        """Whether every job has finished or failed."""
        return bool(np.all(self._ended(progress)))


class Training(Loop):
    """Jobs of one program, as settings describe them.

    Args:
      jobs: what to train; `program` gives the same for all of them.
      lanes: how many train at once; all of them by default.
      mesh: devices to spread the lanes over; all of them by default.
    """

    def __init__(self, jobs: Sequence[Job], lanes: int | None = None, mesh: Mesh | None = None) -> None:
        self.jobs = list(jobs)
        self.settings = jobs[0].settings
        tasks = [build.task(job.settings, job.seed) for job in jobs]
        super().__init__(
            build.agent(self.settings),
            build.environment(self.settings),
            stacked([job.settings.hyper for job in jobs]),
            stacked(tasks),
            np.array([job.seed for job in jobs], np.int32),
            np.array([job.settings.run.episodes for job in jobs], np.int32),
            self.settings.run.root_seed,
            lanes,
            mesh,
            demonstrations.shown([(job.settings, job.seed, task) for job, task in zip(jobs, tasks, strict=True)]),
            warm_maps.load(self.settings),
        )

    @classmethod
    def of_run(cls, settings: Settings, mesh: Mesh | None = None) -> "Training":
        """All seeds of one run at once."""
        return cls(jobs_of(settings), mesh=mesh)


def _noted(progress: Progress, read: tuple[Any, np.ndarray, np.ndarray, np.ndarray]) -> Progress:
    """Progress with what the lanes [L] say about their jobs."""
    held = progress.slots >= 0
    jobs = progress.slots[held]
    changed = {}
    for name, values in zip(("episodes_done", "failed", "steps"), read[1:], strict=True):
        known = getattr(progress, name).copy()
        known[jobs] = values[held]
        changed[name] = known
    return progress._replace(**changed)
