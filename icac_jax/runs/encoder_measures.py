"""Random configurations with their pictures, and how good an encoder is on them.

N is the number of configurations, V of views, P of pixels along a side, L of entries of an embedding, J of joints.
"""

import functools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.envs import oracle
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.autoencoder import Decoder
from icac_jax.envs.drawing import Camera
from icac_jax.envs.embedding import PARTS, Embedding, nested, raw_embedding

_BLOCK = 500  # pictures that are drawn or encoded at a time


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
    pictures = {
        part: np.concatenate([np.asarray(_drawer(draw)(block)) for block in _blocks(rows.astype(np.float32))])
        for part, draw, rows in zip(PARTS, (camera.arm, camera.goal), (joints, tips), strict=True)
    }
    return Configurations({"arm": joints, "goal": tips[:, list(arm.goal_axes)]}, pictures)


@functools.lru_cache(maxsize=8)
def _drawer(draw: Callable[[jax.Array], jax.Array]) -> Callable[[np.ndarray], jax.Array]:
    return jax.jit(jax.vmap(lambda row: jnp.round(255 * draw(row)).astype(jnp.uint8)))


def _blocks(rows: np.ndarray) -> Iterator[np.ndarray]:
    for start in range(0, len(rows), _BLOCK):
        yield rows[start : start + _BLOCK]


def as_numbers(pictures: jax.Array) -> jax.Array:
    """Pictures in [0, 1] of their bytes."""
    return pictures.astype(jnp.float32) / 255


def over(embed: Callable[[jax.Array], jax.Array], pictures: np.ndarray) -> np.ndarray:
    """A function of a picture [V, P, P] in [0, 1], of each of pictures [N, V, P, P] uint8: [N, ...]."""
    several = jax.jit(jax.vmap(lambda picture: embed(as_numbers(picture))))
    return np.concatenate([np.asarray(several(block)) for block in _blocks(pictures)])


def embedded(embedding: Embedding, part: str, pictures: np.ndarray) -> np.ndarray:
    """Embeddings [N, L] of pictures [N, V, P, P] uint8 of one of `PARTS`."""
    return over(functools.partial(embedding.embed, part), pictures)


def reconstructed(embedding: Embedding, part: str, pictures: np.ndarray) -> np.ndarray | None:
    """What the decoder makes of the latents of pictures [N, V, P, P] uint8: the same, in [0, 1]; None without one."""
    options, weights = embedding.options, embedding.weights[part]
    if options.method != "autoencoder":
        return None
    decoder, params = Decoder(*embedding.shape[:2]), {"params": nested(weights, "decoder")}

    def one(picture: jax.Array) -> jax.Array:
        logits: Any = decoder.apply(params, raw_embedding(options, weights, picture))
        return jax.nn.sigmoid(logits)

    return over(one, pictures)


def read_out(embeddings: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A linear read-out of numbers [N, n] from embeddings [N, L], fitted to the first half.

    Returns:
      The numbers of the second half, [N / 2, n], and what is read out for them.
    """
    half = len(truth) // 2
    known = np.column_stack([embeddings, np.ones(len(truth))])
    fit = np.linalg.lstsq(known[:half], truth[:half], rcond=None)[0]
    return truth[half:], known[half:] @ fit


def determined(truth: np.ndarray, said: np.ndarray) -> np.ndarray:
    """R^2 [n] of what is said of numbers [N, n]."""
    return 1 - np.sum((said - truth) ** 2, axis=0) / np.sum((truth - truth.mean(axis=0)) ** 2, axis=0)


def measured(embedding: Embedding, held_out: Configurations) -> dict[str, Any]:
    """How good an encoder is, on configurations that it was not trained with.

    Returns:
      By part: `error`, the squared error of reconstructions as a share of the pictures' variance (None without a
      decoder), and `read_out`, R^2 of a linear read-out of each joint, or goal coordinate.
    """
    facts: dict[str, Any] = {}
    for part in PARTS:
        pictures, back = held_out.pictures[part], reconstructed(embedding, part, held_out.pictures[part])
        error = None
        if back is not None:
            real = pictures / 255
            error = float(np.sum((back - real) ** 2) / np.sum((real - real.mean(axis=0)) ** 2))
        found = determined(*read_out(embedded(embedding, part, pictures), held_out.truth[part]))
        facts[part] = {"error": error, "read_out": [float(one) for one in found]}
    return facts
