"""`icac export`: the policy of a seed as a file of its own, for NumPy alone, ONNX or `jax.export`, or as a folder.

The file for NumPy is an archive of float32 arrays, `weights_K` [after, before] and `bias_K` [after] of layer K, and of
`header`, the bytes of a JSON object; `docs/policy_reader.py` reads it.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import export as jax_export

from icac_jax.agents.base import Layers
from icac_jax.envs.model import joint_names, tip_bounds, tip_box
from icac_jax.fields import ConfigError
from icac_jax.policies import card, onnx_file, saved
from icac_jax.policies.saved import Learner
from icac_jax.runs import best_policies, build
from icac_jax.runs import folder as run_folder
from icac_jax.settings.worlds import need_joints

FORMATS = {"npz": ".npz", "jax": ".jaxexport", "onnx": ".onnx"}
FOLDER = "folder"
VERSION = 1
_PLATFORMS = ("cpu", "cuda", "tpu")
_SAMPLES = 2000  # configurations from which it is known how far the tip gets
_PACKAGES = ("icac_jax", "jax", "mujoco", "numpy")


def header(learner: Learner, layers: Layers) -> dict[str, Any]:
    """What a reader of the policy must know, as JSON can hold it: names, units, scaling, limits, origin."""
    settings, arm = learner.settings, learner.settings.arm
    versions = run_folder.platform_facts()["versions"]
    return {
        "format": "icac_jax policy",
        "format_version": VERSION,
        "arm": arm.name,
        "joints": list(joint_names(arm)),
        "units": {"joints": "deg", "goal": "m, in the world frame of the model", "observation": "1", "action": "1"},
        "observation": {
            "order": "joints, then the goal's coordinates on goal_axes; each scaled by 2 (x - low) / (high - low) - 1",
            "joint_low": list(settings.params.joint_low),
            "joint_high": list(settings.params.joint_high),
            "goal_axes": list(arm.goal_axes),
            "goal_low": list(arm.goal_low),
            "goal_high": list(arm.goal_high),
        },
        "action": {
            "meaning": "joint change of a control step in units of bound; the target is clipped to the joint limits",
            "clip": [-1.0, 1.0],
            "bound": settings.params.action_bound,
            "bound_unit": "deg",
        },
        "network": {
            "sizes": [layers.weights[0].shape[1], *(len(bias) for bias in layers.biases)],
            "hidden": layers.hidden,
            "output": layers.output,
        },
        "reach": reach(learner),
        "goal_radius": settings.params.goal_radius,
        "physics": settings.run.physics,
        "algo": settings.algo,
        "preset": settings.run.preset,
        "seed": learner.seed,
        "root_seed": settings.run.root_seed,
        "episodes": learner.episodes,
        "versions": {name: versions[name] for name in _PACKAGES},
    }


def reach(learner: Learner) -> dict[str, Any]:
    """Where goals can be, the goal radius included: no farther than `most` from `base`, in `box`; in m."""
    settings = learner.settings
    params, slack = settings.params, settings.params.goal_radius
    low, high, most = tip_box(settings.arm, params.joint_low, params.joint_high, _SAMPLES)
    base = np.mean(tip_bounds(settings.arm), axis=0)
    return {
        "base": [round(float(value), 6) for value in base],
        "most": float(most) + slack,
        "box": [(low - slack).tolist(), (high + slack).tolist()],
    }


def layers_of(learner: Learner) -> Layers:
    """The policy as layers.

    Raises:
      ConfigError: it is no such network.
    """
    layers = build.agent(learner.settings).layers
    if layers is None:
        raise ConfigError(f"format: npz and onnx hold layers of a network, not {learner.settings.algo}'s; take jax")
    return layers(jax.tree.map(jnp.asarray, learner.agent))


def arrays(learner: Learner) -> dict[str, np.ndarray]:
    """The actor's layers by name, and the header as bytes.

    Raises:
      ConfigError: the policy is no network of layers.
    """
    layers = layers_of(learner)
    named = {"header": np.frombuffer(json.dumps(header(learner, layers)).encode(), np.uint8)}
    for layer, (weights, bias) in enumerate(zip(layers.weights, layers.biases, strict=True)):
        named |= {f"weights_{layer}": np.asarray(weights), f"bias_{layer}": np.asarray(bias)}
    return named


def artifact(learner: Learner) -> bytes:
    """The policy as `jax.export` serialises it: float32 observations [b, O] to actions [b, A], for any b.

    Raises:
      ConfigError: the library with which jax writes it is missing.
    """
    agent, hyper = build.agent(learner.settings), learner.settings.hyper.traced()
    state = jax.tree.map(jnp.asarray, learner.agent)

    def actions(observations: jax.Array) -> jax.Array:
        return jax.vmap(lambda observation: agent.greedy(state, observation, hyper))(observations)

    shape = jax_export.symbolic_shape(f"b, {build.environment(learner.settings).observation_size}")
    exported = jax_export.export(jax.jit(actions), platforms=_PLATFORMS)(jax.ShapeDtypeStruct(shape, jnp.float32))
    try:
        return bytes(exported.serialize())
    except ImportError as error:
        raise ConfigError("format: jax needs flatbuffers, pip install 'icac_jax[export]'; npz does not") from error


def export(
    folder: Path,
    seed: str = saved.BEST,
    format: str = "npz",
    out: Path | None = None,
    warn: Callable[[str], None] = lambda _: None,
    policy: str = best_policies.NEWEST,
) -> Path:
    """Writes the policy of a seed of a run; returns the file or the folder written.

    Args:
      folder: of the run.
      seed: a number or "best", see `saved.pick`.
      format: "npz" for NumPy alone, "onnx", "jax" for `jax.export.deserialize`, or "folder": the file for NumPy, the
        program that reads it, and a card.
      out: the file or the folder; by default in the run folder.
      warn: told of checkpoints that cannot be read.
      policy: "newest" or "best", see `evaluate.learners`.

    Raises:
      ConfigError: an option is not allowed, or the file cannot be written.
      DamagedError: no checkpoint can be read.
    """
    if format not in (FOLDER, *FORMATS):
        raise ConfigError(f"format: must be one of {', '.join((FOLDER, *FORMATS))}, got {format!r}")
    learner = saved.pick(folder, seed, warn, policy)
    need_joints(learner.settings, "run", "a policy file")
    if format == FOLDER:
        return _folder(folder, learner, out or folder / f"policy-seed-{learner.seed}")
    out = out or folder / f"policy-seed-{learner.seed}{FORMATS[format]}"
    with saved.writing(out) as file:
        if format == "npz":
            np.savez(file, **arrays(learner))  # pyright: ignore[reportArgumentType]  (names are array names)
        elif format == "onnx":
            layers = layers_of(learner)
            file.write(onnx_file.model(layers, header(learner, layers)))
        else:
            file.write(artifact(learner))
    return out


def _folder(run: Path, learner: Learner, out: Path) -> Path:
    """Writes the policy file, its reader and its card into a folder."""
    layers = layers_of(learner)
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        raise ConfigError(f"out: cannot write {out}: {error.strerror or error}") from error
    with saved.writing(out / card.POLICY) as file:
        np.savez(file, **arrays(learner))  # pyright: ignore[reportArgumentType]  (names are array names)
    for name, text in ((card.READER, card.reader()), (card.CARD, card.card(run, learner, header(learner, layers)))):
        with saved.writing(out / name) as file:
            file.write(text.encode(errors="backslashreplace"))
    return out
