"""What a learner gets of a picture in its place: its latent, a random projection of it, or its pixels. Pure functions.

V is the number of views, P of pixels along a side, L of entries of an embedding.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.envs.autoencoder import DIVISOR, Encoder
from icac_jax.fields import ConfigError, check_record, param

Method = Literal["autoencoder", "projection", "pixels"]
# What an encoder looks at: the arm and the goal, each alone in its picture.
PARTS = ("arm", "goal")
# Weights that every part has: middle and half range of each entry, with which it is scaled to [-1, 1].
SCALE = ("middle", "half")


@dataclasses.dataclass(frozen=True)
class EncoderOptions:
    """What an encoder is, and how it is trained."""

    method: Method = param("autoencoder", "autoencoder, or a control: projection, pixels", source="own")
    picture_size: int = param(32, "side of a picture", unit="pixels", source="own", low=DIVISOR, high=128)
    latent_size: int = param(8, "entries of an embedding; pixels: one each", source="trials", low=1, high=1024)
    pictures: int = param(10000, "random configurations to train with", source="own", low=100, high=10**6)
    steps: int = param(3000, "gradient steps, for arm and goal each", source="trials", low=1, high=10**7)
    batch_size: int = param(32, "pictures per gradient step", source="own", low=1, high=4096)
    rate: float = param(0.002, "learning rate at first, of Adam", source="trials", low=0.0, open_low=True)
    seed: int = param(0, "randomness of configurations and weights", source="own", low=0, high=2**32 - 1)

    def __post_init__(self) -> None:
        """Checks every field."""
        check_record(self)
        if self.picture_size % DIVISOR:
            raise ConfigError(f"picture_size: must be a multiple of {DIVISOR}, got {self.picture_size}")


Weights = Mapping[str, Any]
"""Arrays by name: `SCALE`, and those of the method; of an autoencoder `encoder/LAYER/NAME` and `decoder/LAYER/NAME`."""


class Embedding(NamedTuple):
    """An encoder of the pictures of an arm and of its goal.

    Attributes:
      options: how it was made.
      arm: name of the arm.
      shape: V, P, P of its pictures.
      weights: of each of `PARTS`.
      facts: what else is known of it, as JSON holds it: errors, versions.
    """

    options: EncoderOptions
    arm: str
    shape: tuple[int, int, int]
    weights: dict[str, Weights]
    facts: dict[str, Any]

    @property
    def size(self) -> int:
        """L."""
        return embedding_size(self.options, self.shape)

    def embed(self, part: str, picture: jax.Array) -> jax.Array:
        """The embedding [L] of a picture [V, P, P], each entry in [-1, 1] over the configurations it was made with."""
        mine = self.weights[part]
        raw = raw_embedding(self.options, mine, picture)
        return (raw - jnp.asarray(mine["middle"])) / jnp.asarray(mine["half"])


def embedding_size(options: EncoderOptions, shape: tuple[int, int, int]) -> int:
    """L, for pictures [V, P, P]."""
    return int(np.prod(shape)) if options.method == "pixels" else options.latent_size


def raw_embedding(options: EncoderOptions, weights: Weights, picture: jax.Array) -> jax.Array:
    """The embedding [L] of a picture [V, P, P] before it is scaled."""
    if options.method == "pixels":
        return picture.ravel()
    if options.method == "projection":
        return jnp.asarray(weights["projection"]) @ picture.ravel()
    latent: Any = Encoder(options.latent_size).apply({"params": nested(weights, "encoder")}, picture)
    return latent


def flattened(tree: Any, name: str) -> dict[str, np.ndarray]:
    """The parameters of a flax module by `NAME/LAYER/NAME`."""
    return {
        "/".join([name, *(str(key.key) for key in path)]): np.asarray(leaf)
        for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]
    }


def nested(weights: Weights, name: str) -> dict[str, dict[str, Any]]:
    """The parameters of a flax module from what `flattened` gives."""
    found: dict[str, dict[str, Any]] = {}
    for full, leaf in weights.items():
        module, *path = full.split("/")
        if module == name and len(path) == 2:
            found.setdefault(path[0], {})[path[1]] = jnp.asarray(leaf)
    return found
