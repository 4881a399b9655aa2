"""Encoders of pictures: trained on random configurations of an arm, measured on others, written as a file.

N is the number of configurations, V of views, P of pixels along a side, L of entries of an embedding, J of joints.
"""

import contextlib
import dataclasses
import functools
import io
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from icac_jax.envs import camera as seen
from icac_jax.envs import drawing
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.autoencoder import Decoder, Encoder
from icac_jax.envs.embedding import PARTS, Embedding, EncoderOptions, flattened, raw_embedding
from icac_jax.errors import ConfigError
from icac_jax.runs import devices, encoder_measures, files
from icac_jax.runs import folder as run_folder
from icac_jax.runs.progress import Reporter
from icac_jax.settings import arm_files, encoder_files
from icac_jax.settings.run_options import CameraOptions

_HELD_OUT = 2000  # configurations that nothing was trained with
_STEPS_AT_ONCE = 50
_PACKAGES = ("icac_jax", "jax", "flax", "optax", "numpy")
# Streams of randomness beside the seed.
_TRAINING, _MEASURING, _WEIGHTS = 0, 1, 2

Tell = Callable[[str, int, int, float, float], None]
"""Told of a part, of its steps done and of all, of the seconds spent, and of the loss."""


def autoencoder(options: EncoderOptions, pictures: np.ndarray, key: jax.Array, tell: Callable) -> dict[str, np.ndarray]:
    """Trains an autoencoder: cross-entropy of each pixel, Adam, a rate that goes to 0 as a cosine.

    Args:
      options: of the encoder.
      pictures: [N, V, P, P] uint8.
      key: initial weights and batches.
      tell: told of steps done, seconds spent and the loss.

    Returns:
      The weights of encoder and decoder by name.
    """
    views, size = pictures.shape[1:3]
    encoder, decoder = Encoder(options.latent_size), Decoder(views, size)
    first, second, batches = jax.random.split(key, 3)
    params = (
        encoder.init(first, jnp.zeros((views, size, size))),
        decoder.init(second, jnp.zeros(options.latent_size)),
    )
    optimiser = optax.adam(optax.cosine_decay_schedule(options.rate, options.steps))
    kept = jnp.asarray(pictures)

    def loss(params: Any, batch: jax.Array) -> jax.Array:
        def one(picture: jax.Array) -> jax.Array:
            logits: Any = decoder.apply(params[1], encoder.apply(params[0], picture))
            return jnp.sum(optax.sigmoid_binary_cross_entropy(logits, picture))

        return jnp.mean(jax.vmap(one)(batch))

    @functools.partial(jax.jit, donate_argnums=(0, 1))
    def step(params: Any, state: Any, number: jax.Array) -> tuple[Any, Any, jax.Array]:
        rows = jax.random.randint(jax.random.fold_in(batches, number), (options.batch_size,), 0, len(kept))
        value, gradient = jax.value_and_grad(loss)(params, encoder_measures.as_numbers(kept[rows]))
        updates, state = optimiser.update(gradient, state, params)
        return optax.apply_updates(params, updates), state, value

    state, started = optimiser.init(params), time.perf_counter()
    for number in range(options.steps):
        params, state, value = step(params, state, jnp.asarray(number))
        if (number + 1) % _STEPS_AT_ONCE == 0 or number + 1 == options.steps:
            tell(number + 1, time.perf_counter() - started, float(value))
    trees = {"encoder": params[0]["params"], "decoder": params[1]["params"]}
    return {full: leaf for name, tree in trees.items() for full, leaf in flattened(tree, name).items()}


def train(arm: ArmSpec, options: EncoderOptions, tell: Tell = lambda *_: None) -> Embedding:
    """Makes an encoder of the pictures of an arm and of its goal.

    Args:
      arm: which arm.
      options: of the encoder.
      tell: told how far it is.

    Returns:
      The encoder; its `facts` are those of `encoder_measures.measured`, the seconds it took, and versions.
    """
    started = time.perf_counter()
    camera = drawing.camera(arm, options.picture_size)
    mine = encoder_measures.drawn(arm, camera, options.pictures, (options.seed, _TRAINING))
    weights: dict[str, dict[str, np.ndarray]] = {}
    for number, part in enumerate(PARTS):
        key = jax.random.fold_in(jax.random.key(options.seed), number)
        made: dict[str, np.ndarray] = {}
        if options.method == "autoencoder":
            made = autoencoder(options, mine.pictures[part], key, functools.partial(_told, tell, part, options.steps))
        if options.method == "projection":
            rng = np.random.default_rng((options.seed, _WEIGHTS, number))
            made = {"projection": rng.standard_normal((options.latent_size, np.prod(camera.shape))).astype(np.float32)}
        raw = encoder_measures.over(functools.partial(raw_embedding, options, made), mine.pictures[part])
        low, high = raw.min(axis=0), raw.max(axis=0)
        if options.method == "pixels":  # most are hardly ever anything but white
            low, high = np.zeros_like(low), np.ones_like(high)
        weights[part] = made | {"middle": (low + high) / 2, "half": np.maximum((high - low) / 2, 1e-6)}
    weights["arm"]["example"] = np.asarray(jax.jit(camera.arm)(seen.example(arm)))
    embedding = Embedding(options, arm.name, camera.shape, dict(weights), {})
    held_out = encoder_measures.drawn(arm, camera, _HELD_OUT, (options.seed, _MEASURING))
    facts = encoder_measures.measured(embedding, held_out)
    versions = run_folder.platform_facts()["versions"]
    facts["seconds"] = round(time.perf_counter() - started, 1)
    facts["versions"] = {name: versions[name] for name in _PACKAGES}
    return embedding._replace(facts=facts)


def _told(tell: Tell, part: str, steps: int, done: int, seconds: float, loss: float) -> None:
    tell(part, done, steps, seconds, loss)


def content(embedding: Embedding) -> bytes:
    """The bytes of an encoder's file."""
    arrays = {f"{part}/{name}": np.asarray(leaf) for part in PARTS for name, leaf in embedding.weights[part].items()}
    meta = {
        "format": encoder_files.FORMAT,
        "arm": embedding.arm,
        "shape": list(embedding.shape),
        "options": dataclasses.asdict(embedding.options),
        "facts": embedding.facts,
    }
    meta["sha256"] = encoder_files.digest(meta, arrays)
    buffer = io.BytesIO()
    text = np.frombuffer(json.dumps(meta).encode(), np.uint8)
    np.savez(buffer, **{encoder_files.META: text}, **arrays)  # pyright: ignore[reportArgumentType]
    return buffer.getvalue()


def write(path: Path, embedding: Embedding) -> None:
    """Writes an encoder as a file; one that is there is replaced.

    Raises:
      ConfigError: it cannot be written.
    """
    try:
        with files.replacing(path) as file:
            file.write(content(embedding))
    except OSError as error:
        raise ConfigError(f"out: cannot write to {path}: {error.strerror or error}") from error


def read(path: str | Path, arm: ArmSpec) -> Embedding:
    """An encoder from its file.

    Raises:
      ConfigError: it cannot be read, is damaged or is of another arm.
    """
    return encoder_files.read(encoder_files.found(CameraOptions(str(path)), arm), arm)


def encode(
    arm: str = "planar2", out: str | Path | None = None, *, tip: str = "", progress: bool = False, **options: Any
) -> Embedding:
    """Makes an encoder of the pictures of an arm and of its goal, as `icac encode` does it.

    Args:
      arm: name of an arm, or the path of an own arm's file.
      out: file to write it to, which `icac_jax.train(..., encoder=out)` takes; none by default.
      tip: of an own arm that is a model file.
      progress: whether to show progress on standard error.
      **options: of `EncoderOptions`.

    Raises:
      ConfigError: with one line that names the option and what is allowed.
    """
    known = [field.name for field in dataclasses.fields(EncoderOptions)]
    for name in options:
        if name not in known:
            raise ConfigError(f"{name}: no such option of an encoder; there are {', '.join(known)}")
    chosen, spec = EncoderOptions(**options), arm_files.find(arm, tip).arm
    if not spec.joints:
        raise ConfigError(f"arm: must be an arm, {arm} has no joints to be drawn")
    devices.use_every_core()
    total = len(PARTS) * chosen.steps if chosen.method == "autoencoder" else 0
    spent = {part: 0.0 for part in PARTS}
    with Reporter("encode", total, unit="steps") if progress and total else contextlib.nullcontext() as reporter:

        def tell(part: str, done: int, steps: int, seconds: float, loss: float) -> None:
            spent[part] = seconds
            if reporter is not None:
                reporter.update(PARTS.index(part) * steps + done, sum(spent.values()), f"{part}: loss {loss:.1f}")

        embedding = train(spec, chosen, tell)
    if out is not None:
        write(Path(out).expanduser(), embedding)
    return embedding
