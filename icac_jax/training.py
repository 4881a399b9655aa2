"""The Python door: `icac_jax.train` from names or objects to arrays, and to the folder that the command line writes."""

import contextlib
import dataclasses
import sys
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax import fields, tracking
from icac_jax.agents import registry
from icac_jax.agents.base import Agent
from icac_jax.agents.registry import Learner
from icac_jax.envs.base import Environment
from icac_jax.fields import ConfigError, close_match
from icac_jax.runs import build, demonstrations, devices, warm_maps
from icac_jax.runs import train as runs
from icac_jax.runs.loop import Chunk, Loop
from icac_jax.runs.observers import Observer, Observers, Run
from icac_jax.runs.progress import Reporter
from icac_jax.runs.warm_maps import WarmMap
from icac_jax.settings import options as settings_options
from icac_jax.settings.options import Settings, options_of, resolve
from icac_jax.trained import Trained, of_rows

# Where nothing says otherwise, for environments and agents of the user's own.
_SEEDS, _EPISODES = 20, 1000


def preset(env: str = "planar2", agent: str | None = None, name: str = "paper", **changes: Any) -> Settings:
    """The numbers of a preset: `spec` and `hyper` of the learner, `params` of the task, `run` for the rest.

    Args:
      env: name of an arm, or the path of an own arm's file.
      agent: name of a learner; the preset's own by default, or ICAC where it has none.
      name: of the preset.
      **changes: options that differ from the preset.

    Raises:
      ConfigError: with one line that names the option and what is allowed.
    """
    return resolve(arm=str(env), preset=name, **changes | ({} if agent is None else {"algo": agent}))


def train(
    env: str | Environment = "planar2",
    agent: str | Agent | Learner | None = None,
    *,
    seeds: int | Iterable[int] | np.ndarray | None = None,
    episodes: int | None = None,
    preset: str = "paper",
    hyper: Any = None,
    params: Any = None,
    root_seed: int = 0,
    out: str | Path | None = None,
    callback: Callable[[Chunk], None] | None = None,
    observers: Sequence[Observer | str] = (),
    progress: bool | None = None,
    **options: Any,
) -> Trained:
    """Trains learners, one per seed and setting, as lanes of one compiled program.

    NumPy broadcasting is the sweep: options and seeds may be arrays, and what comes back has their common shape.

    Args:
      env: name of an arm, path of an own arm's file, or an `Environment`.
      agent: name of a learner, a `Learner`, or an `Agent`, which then needs `hyper`; by default the preset's learner,
        which is ICAC for most.
      seeds: an array of seeds, or how many, seeds 0 to n - 1; 20 by default.
      episodes: per learner; what the preset says by default, 1,000 without one.
      preset: defaults of a named arm's options.
      hyper: traced numbers of an agent that is handed in.
      params: traced numbers of an environment that is handed in; its own by default.
      root_seed: randomness of the whole.
      out: a new or empty folder in which the run is kept as `icac train` does it. It takes names, one value per option
        and seeds 0 to n - 1.
      callback: called with each chunk of steps: lanes, progress, the episodes that ended.
      observers: told of each chunk: an `Observer`, or the name of a tracker, which needs `out`: "tensorboard", "wandb",
        "mlflow", "csv".
      progress: whether to show progress on standard error; by default where there is a terminal or a notebook.
      **options: of learner, task and run, by the names of the command line; numbers that are traced may be arrays.

    Returns:
      Arrays over seeds and settings, see `Trained`.

    Raises:
      ConfigError: with one line that names the option and what is allowed, before anything is compiled.
    """
    for name, argument in (("arm", "env"), ("algo", "agent")):
        if name in options:
            raise ConfigError(f"{name}: must be given as {argument}")
    devices.use_every_core()
    devices.use_kept()
    settings = warm = None
    watching = [*_observers(observers, out), *([callback] if callback is not None else [])]
    if isinstance(seeds, int | np.integer) and not isinstance(seeds, bool):
        fields.check_field(settings_options.COMMON["seeds"], int(seeds))
        seeds = range(int(seeds))
    if isinstance(env, str | Path) and (agent is None or isinstance(agent, str)):
        if hyper is not None or params is not None:
            raise ConfigError("hyper: must be left out with names, options take its place")
        chosen = options | {"preset": preset, "root_seed": root_seed}
        chosen |= {} if episodes is None else {"episodes": episodes}
        chosen |= {} if agent is None else {"algo": agent}
        algo = settings_options.learner_of(chosen | {"arm": str(env)})
        if not registry.replays(algo):
            devices.keep_loops()
        single = {name: value for name, value in chosen.items() if not _is_several(name, value, algo)}
        settings = resolve(arm=str(env), **single | {"algo": algo})
        several = {name: value for name, value in chosen.items() if name not in single}
        settings_options.check_applies(options_of(algo).keys() & several, settings.flat())
        numbers = np.arange(settings.run.seeds) if seeds is None else _whole(seeds)
        if out is not None:
            return _in_folder(settings, numbers, several, Path(out), watching)
        parts = build.agent(settings), build.environment(settings), settings.hyper, settings.params
        warm = warm_maps.load(settings)
        episodes = settings.run.episodes
    elif out is not None:
        raise ConfigError("out: must be left out with objects; a learner of one's own gets a name by an entry point")
    elif any(name in options for name in ("demonstrations", "demonstrated_episodes")):
        raise ConfigError("demonstrations: must be left out with objects, only named arms and learners start from them")
    else:
        agent = "icac" if agent is None else agent
        named = isinstance(agent, str | Learner)
        if not (registry.replays(agent) if named else isinstance(agent, Agent) and agent.flops):
            devices.keep_loops()
        parts, several = _parts(env, agent, hyper, params, options)
        numbers = np.arange(_SEEDS) if seeds is None else _whole(seeds)
        episodes = _EPISODES if episodes is None else episodes
        fields.check_field(settings_options.COMMON["episodes"], episodes)
    return _train(*parts, several, numbers, episodes, root_seed, watching, progress, settings, warm)


def _observers(observers: Sequence[Observer | str], out: str | Path | None) -> list[Observer]:
    """Observers, those of a name made.

    Raises:
      ConfigError: there is no such tracker, its extra is missing, or it has no folder to write to.
    """
    if out is None and any(isinstance(one, str) for one in observers):
        raise ConfigError("observers: must be objects without out, trackers by name write into the run's folder")
    found: list[Observer] = []
    for one in observers:
        found += tracking.trackers([one], warnings.warn) if isinstance(one, str) else [one]
    return found


def _told_options(hyper: Any, params: Any, flat: dict[str, np.ndarray]) -> dict[str, Any]:
    """The numbers of a training as observers are told them: one where all learners share it, a list otherwise."""
    options = {}
    for record in (params, hyper):
        for name in _names(record):
            values = np.asarray(flat[name] if name in flat else getattr(record, name))
            if values.ndim and values.size:
                options[name] = values[0].tolist() if (values == values[0]).all() else values.tolist()
    return options


def _is_several(name: str, value: Any, algo: str) -> bool:
    """Whether an option is given as an array over settings."""
    field = options_of(algo).get(name)
    tuples = field is not None and field.type == tuple[float, ...]  # walls may be nested lists, yet are one value
    return not tuples and np.ndim(value) > 0 and not isinstance(value, str)


def _whole(seeds: Any) -> np.ndarray:
    numbers = np.asarray(list(seeds) if isinstance(seeds, range) else seeds)
    if numbers.size == 0 or not np.issubdtype(numbers.dtype, np.integer) or numbers.min() < 0:
        raise ConfigError("seeds: must be whole numbers at least 0, at least one of them")
    return numbers


def _parts(
    env: Any, agent: Any, hyper: Any, params: Any, options: dict[str, Any]
) -> tuple[tuple[Agent, Environment, Any, Any], dict[str, Any]]:
    """Agent, environment and their numbers from objects, and the options that are arrays or change a number."""
    if not isinstance(env, Environment):
        task = preset(str(env), **{name: options.pop(name) for name in ("physics", "sub_steps") if name in options})
        env, params = build.environment(task), task.params if params is None else params
    params = env.params if params is None else params
    if isinstance(agent, str):
        agent = registry.find(agent)
    if isinstance(agent, Learner):
        static = {field.name for field in dataclasses.fields(agent.static)}
        spec = agent.static(**{name: options.pop(name) for name in [*options] if name in static})
        hyper = agent.traced() if hyper is None else hyper
        agent = registry.built(agent, spec, env)
    if not isinstance(agent, Agent):
        raise ConfigError(f"agent: must be a name, a Learner or an Agent, got {type(agent).__name__}")
    if hyper is None:
        raise ConfigError("hyper: must be given with an Agent, the record of its traced numbers")
    return (agent, env, hyper, params), options


def _train(
    agent: Agent,
    env: Environment,
    hyper: Any,
    params: Any,
    several: dict[str, Any],
    seeds: np.ndarray,
    episodes: int,
    root_seed: int,
    watching: list[Any],
    progress: bool | None,
    settings: Settings | None,
    warm: WarmMap | None,
) -> Trained:
    known = [*_names(hyper), *_names(params)]
    for name in several:
        if name not in known:
            raise ConfigError(f"{name}: no number that can be an array{close_match(name, known)}")
    arrays = {name: np.asarray(value) for name, value in several.items()}
    try:
        shape = np.broadcast_shapes(seeds.shape, *(value.shape for value in arrays.values()))
    except ValueError as error:
        shapes = ", ".join(f"{name} {value.shape}" for name, value in ({"seeds": seeds} | arrays).items())
        raise ConfigError(f"{next(iter(arrays))}: shapes must broadcast, got {shapes}") from error
    number = int(np.prod(shape))
    flat = {name: np.broadcast_to(value, shape).reshape(number) for name, value in arrays.items()}
    each = np.broadcast_to(seeds, shape).reshape(number)
    shown = None
    if settings is None:
        params = _on_jobs(params, flat, number)
    else:
        mine = [name for name in flat if name in _names(params)]
        _on_jobs(params, {name: flat[name] for name in mine}, number)  # checks them
        tasks = []
        for job, seed in enumerate(each):  # a seed's goal depends on all of the task's numbers
            changed = settings.params.replace(**{name: flat[name][job].item() for name in mine})
            its_own = dataclasses.replace(settings, params=changed)
            tasks.append((its_own, int(seed), build.task(its_own, int(seed))))
        params = fields.stacked([task for *_, task in tasks])
        shown = demonstrations.shown(tasks)
    hyper = _on_jobs(hyper, flat, number)
    loop = Loop(agent, env, hyper, params, each, np.full(number, episodes), root_seed, shown=shown, warm=warm)
    rows, chunk = [], None
    told = Observers(watching, Run("training", _told_options(hyper, params, flat), None, number * episodes))
    shown = _is_watched() if progress is None else progress
    with Reporter("training", number * episodes) if shown else contextlib.nullcontext() as reporter:
        for chunk in loop.chunks(loop.start()):
            rows.append(chunk.table)
            told.see(chunk)
            if reporter is not None:
                reached = chunk.table["reached"].to_numpy()
                note = f"success {reached.mean():.0%} of late" if len(reached) else ""
                reporter.update(int(chunk.episodes_done.sum()), chunk.seconds, note)
    told.end(None)
    assert chunk is not None
    lanes = jax.tree.map(lambda leaf: leaf[:number], jax.device_get(chunk.lanes.agent))
    varied = {"seed": np.broadcast_to(seeds, shape)} | {name: np.broadcast_to(arrays[name], shape) for name in arrays}
    return of_rows(agent, hyper, lanes, rows, chunk, varied, shape, episodes)


def _is_watched() -> bool:
    """Whether somebody sees standard error: a terminal or a notebook."""
    return "ipykernel" in sys.modules or (sys.stderr is not None and sys.stderr.isatty())


def _names(record: Any) -> list[str]:
    return [field.name for field in dataclasses.fields(record)] if dataclasses.is_dataclass(record) else []


def _on_jobs(record: Any, flat: dict[str, np.ndarray], number: int) -> Any:
    """A record of numbers with leaves [number, ...], those in `flat` as they are there.

    Raises:
      ConfigError: a value is not allowed.
    """
    if not dataclasses.is_dataclass(record):
        record = jax.tree.map(jnp.asarray, record)
        return jax.tree.map(lambda leaf: np.broadcast_to(leaf, (number, *leaf.shape)), record)
    strong = fields.strong(record)
    found = {}
    for name in _names(strong):
        leaf, values = getattr(strong, name), flat.get(name)
        if leaf is None and values is None:
            continue  # neutral: not in the program
        leaf = np.asarray(getattr(record, name), np.float32) if leaf is None else np.asarray(leaf)
        if values is not None and not np.can_cast(values.dtype, leaf.dtype, "same_kind"):
            raise ConfigError(f"{name}: must be numbers of the kind {leaf.dtype}, got {values.dtype}")
        found[name] = np.broadcast_to(leaf, (number, *leaf.shape)) if values is None else values.astype(leaf.dtype)
    made = type(record)(**dict.fromkeys(_names(strong)) | found)
    fields.check_traced(made)
    return made


def _in_folder(
    settings: Settings,
    seeds: np.ndarray,
    several: dict[str, Any],
    out: Path,
    watching: list[Any],
) -> Trained:
    """A run in a folder, by the code path of `icac train`."""
    if several:
        raise ConfigError(f"{next(iter(several))}: must be one value with out; `icac sweep` keeps a grid in a folder")
    if seeds.ndim != 1 or not np.array_equal(seeds, np.arange(len(seeds))):
        raise ConfigError("seeds: must be 0 to n - 1 with out")
    settings = resolve(**settings.flat() | {"seeds": len(seeds)})
    last: list[Chunk] = []
    rows: list[Any] = []

    def see(chunk: Chunk) -> None:
        rows.append(chunk.table)
        last[:] = [chunk]

    from icac_jax.analysis import run_page  # draws, which training does not need

    out = out.expanduser()
    runs.train(settings, out, observers=(see, *watching))
    run_page.after_training(out, warnings.warn)
    lanes = jax.tree.map(lambda leaf: leaf[: len(seeds)], jax.device_get(last[0].lanes.agent))
    hyper = _on_jobs(settings.hyper, {}, len(seeds))
    varied = {"seed": seeds}
    return of_rows(build.agent(settings), hyper, lanes, rows, last[0], varied, seeds.shape, settings.run.episodes)
