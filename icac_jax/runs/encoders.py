"""Encoders of pictures: trained on random configurations of an arm, measured on others, written as a file.

N is the number of configurations, V of views, P of pixels along a side, L of entries of an embedding, J of joints.
"""

import contextlib
import dataclasses
import functools
import io
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from icac_jax.envs import camera as seen
from icac_jax.envs import drawing, oracle
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.autoencoder import Decoder, Encoder
from icac_jax.envs.drawing import Camera
from icac_jax.envs.embedding import PARTS, Embedding, EncoderOptions, flattened, nested, raw_embedding
from icac_jax.errors import ConfigError
from icac_jax.runs import devices, files
from icac_jax.runs import folder as run_folder
from icac_jax.runs.progress import Reporter
from icac_jax.settings import arm_files, encoder_files
from icac_jax.settings.run_options import CameraOptions

_HELD_OUT = 2000  # configurations that nothing was trained with
_BLOCK = 500  # pictures that are drawn or encoded at a time
_STEPS_AT_ONCE = 50
_PACKAGES = ("icac_jax", "jax", "flax", "optax", "numpy")
# Streams of randomness beside the seed.
_TRAINING, _MEASURING, _WEIGHTS = 0, 1, 2

Tell = Callable[[str, int, int, float, float], None]
"""Told of a part, of its steps done and of all, of the seconds spent, and of the loss."""


class Configurations(NamedTuple):
    """Random configurations and what they look like.

    Attributes:
      truth: of the arm joints [N, J] in rad, of the goal its coordinates [N, axes] in m.
      pictures: of each of `PARTS`, [N, V, P, P] uint8, 255 for 1.
    """

    truth: dict[str, np.ndarray]
    pictures: dict[str, np.ndarray]


def drawn(arm: ArmSpec, camera: Camera, number: int, seed: tuple[int, ...]) -> Configurations:
    """Configurations uniform over the arm's joint limits; goals are where the tip is in others of them.

    Args:
      arm: which arm.
      camera: its camera.
      number: N.
      seed: of NumPy's generator.
    """
    rng = np.random.default_rng(seed)
    joints, others = rng.uniform(np.radians(arm.joint_low), np.radians(arm.joint_high), (2, number, arm.joints))
    tips = oracle.tips(arm, others)
    pictures = {"arm": _in_blocks(camera.arm, joints), "goal": _in_blocks(camera.goal, tips)}
    return Configurations({"arm": joints, "goal": tips[:, list(arm.goal_axes)]}, pictures)


def _in_blocks(draw: Callable[[jax.Array], jax.Array], rows: np.ndarray) -> np.ndarray:
    """Pictures [N, V, P, P] uint8 of rows [N, ...]."""
    return np.concatenate([np.asarray(_drawer(draw)(block)) for block in _blocks(rows.astype(np.float32))])


@functools.lru_cache(maxsize=8)
def _drawer(draw: Callable[[jax.Array], jax.Array]) -> Callable[[np.ndarray], jax.Array]:
    return jax.jit(jax.vmap(lambda row: jnp.round(255 * draw(row)).astype(jnp.uint8)))


def _blocks(rows: np.ndarray) -> Iterator[np.ndarray]:
    for start in range(0, len(rows), _BLOCK):
        yield rows[start : start + _BLOCK]


def _seen(pictures: jax.Array) -> jax.Array:
    """Pictures in [0, 1] of their bytes."""
    return pictures.astype(jnp.float32) / 255


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
        value, gradient = jax.value_and_grad(loss)(params, _seen(kept[rows]))
        updates, state = optimiser.update(gradient, state, params)
        return optax.apply_updates(params, updates), state, value

    state, started = optimiser.init(params), time.perf_counter()
    for number in range(options.steps):
        params, state, value = step(params, state, jnp.asarray(number))
        if (number + 1) % _STEPS_AT_ONCE == 0 or number + 1 == options.steps:
            tell(number + 1, time.perf_counter() - started, float(value))
    inside = (module["params"] for module in params)
    return {k: v for name, tree in zip(("encoder", "decoder"), inside, strict=True) for k, v in flattened(tree, name).items()}


def train(arm: ArmSpec, options: EncoderOptions, tell: Tell = lambda *_: None) -> Embedding:
    """Makes an encoder of the pictures of an arm and of its goal.

    Args:
      arm: which arm.
      options: of the encoder.
      tell: told how far it is.

    Returns:
      The encoder; its `facts` are those of `measured`, the seconds it took, and versions.
    """
    started = time.perf_counter()
    camera = drawing.camera(arm, options.picture_size)
    mine = drawn(arm, camera, options.pictures, (options.seed, _TRAINING))
    weights: dict[str, dict[str, np.ndarray]] = {}
    for number, part in enumerate(PARTS):
        key = jax.random.fold_in(jax.random.key(options.seed), number)
        made: dict[str, np.ndarray] = {}
        if options.method == "autoencoder":
            made = autoencoder(options, mine.pictures[part], key, functools.partial(_told, tell, part, options.steps))
        if options.method == "projection":
            rng = np.random.default_rng((options.seed, _WEIGHTS, number))
            made = {"projection": rng.standard_normal((options.latent_size, np.prod(camera.shape))).astype(np.float32)}
        raw = _embedded(functools.partial(raw_embedding, options, made), mine.pictures[part])
        low, high = raw.min(axis=0), raw.max(axis=0)
        weights[part] = made | {"middle": (low + high) / 2, "half": np.maximum((high - low) / 2, 1e-6)}
    weights["arm"]["example"] = np.asarray(camera.arm(seen.example(arm)))
    embedding = Embedding(options, arm.name, camera.shape, dict(weights), {})
    versions = run_folder.platform_facts()["versions"]
    facts = measured(embedding, drawn(arm, camera, _HELD_OUT, (options.seed, _MEASURING)))
    facts |= {"seconds": round(time.perf_counter() - started, 1), "versions": {name: versions[name] for name in _PACKAGES}}
    return embedding._replace(facts=facts)


def _told(tell: Tell, part: str, steps: int, done: int, seconds: float, loss: float) -> None:
    tell(part, done, steps, seconds, loss)


def _embedded(embed: Callable[[jax.Array], jax.Array], pictures: np.ndarray) -> np.ndarray:
    """Embeddings [N, L] of pictures [N, V, P, P] uint8."""
    several = jax.jit(jax.vmap(lambda picture: embed(_seen(picture))))
    return np.concatenate([np.asarray(several(block)) for block in _blocks(pictures)])


def embedded(embedding: Embedding, part: str, pictures: np.ndarray) -> np.ndarray:
    """Embeddings [N, L] of pictures [N, V, P, P] uint8 of one of `PARTS`."""
    return _embedded(functools.partial(embedding.embed, part), pictures)


def reconstructed(embedding: Embedding, part: str, pictures: np.ndarray) -> np.ndarray | None:
    """What the decoder makes of the latents of pictures [N, V, P, P] uint8: the same, in [0, 1]; None without one."""
    options, weights = embedding.options, embedding.weights[part]
    if options.method != "autoencoder":
        return None
    decoder = Decoder(*embedding.shape[:2])
    params = {"params": nested(weights, "decoder")}

    def one(picture: jax.Array) -> jax.Array:
        logits: Any = decoder.apply(params, raw_embedding(options, weights, picture))
        return jax.nn.sigmoid(logits)

    return _embedded(one, pictures)


def read_out(embeddings: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """R^2 [n] of a linear read-out of numbers [N, n] from embeddings [N, L]: fitted to one half, measured on the other."""
    half = len(truth) // 2
    known = np.column_stack([embeddings, np.ones(len(truth))])
    fit = np.linalg.lstsq(known[:half], truth[:half], rcond=None)[0]
    missed = np.sum((known[half:] @ fit - truth[half:]) ** 2, axis=0)
    return 1 - missed / np.sum((truth[half:] - truth[half:].mean(axis=0)) ** 2, axis=0)


def measured(embedding: Embedding, held_out: Configurations) -> dict[str, Any]:
    """How good an encoder is, on configurations that it was not trained with.

    Returns:
      By part: `error`, the squared error of reconstructions as a share of the pictures' variance (None without a
      decoder), and `read_out`, R^2 of each joint, or goal coordinate, as `read_out` gives it.
    """
    facts: dict[str, Any] = {}
    for part in PARTS:
        pictures, back = held_out.pictures[part], reconstructed(embedding, part, held_out.pictures[part])
        error = None
        if back is not None:
            real = pictures / 255
            error = float(np.sum((back - real) ** 2) / np.sum((real - real.mean(axis=0)) ** 2))
        found = read_out(embedded(embedding, part, pictures), held_out.truth[part])
        facts[part] = {"error": error, "read_out": [float(one) for one in found]}
    return facts


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
