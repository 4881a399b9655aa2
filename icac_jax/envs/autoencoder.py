"""A convolutional autoencoder of small pictures (flax), for one picture at a time.

The convolutions are as far apart as they are wide, so that each is a product of matrices: on a CPU a step of training
takes a tenth of the time that overlapping ones do, and a picture costs a lane little.

V is the number of channels, P of pixels along a side, L of entries of a latent.
"""

import flax.linen as nn
import jax
import jax.numpy as jnp

# Side and channels of each convolution; P must be a multiple of `DIVISOR`.
_LAYERS = ((4, 16), (2, 32))
_HIDDEN = 64
DIVISOR = 8


class Encoder(nn.Module):
    """A picture [V, P, P] to its latent [L].

    Attributes:
      latent_size: L.
    """

    latent_size: int

    @nn.compact
    def __call__(self, picture: jax.Array) -> jax.Array:
        """The latent [L] of a picture [V, P, P]."""
        hidden = jnp.moveaxis(picture, 0, -1)
        for side, channels in _LAYERS:
            rows, columns, before = hidden.shape
            patches = hidden.reshape(rows // side, side, columns // side, side, before).swapaxes(1, 2)
            hidden = nn.relu(nn.Dense(channels)(patches.reshape(rows // side, columns // side, -1)))
        return nn.Dense(self.latent_size)(nn.relu(nn.Dense(_HIDDEN)(hidden.ravel())))


class Decoder(nn.Module):
    """A latent [L] to the logits [V, P, P] of a picture.

    Attributes:
      views: V.
      size: P.
    """

    views: int
    size: int

    @nn.compact
    def __call__(self, latent: jax.Array) -> jax.Array:
        """The logits [V, P, P] of the picture of a latent [L]."""
        places, (_, channels) = self.size // DIVISOR, _LAYERS[-1]
        hidden = nn.relu(nn.Dense(places * places * channels)(nn.relu(nn.Dense(_HIDDEN)(latent))))
        hidden = hidden.reshape(places, places, channels)
        outputs = [channels for _, channels in _LAYERS[-2::-1]] + [self.views]
        for (side, _), channels in zip(_LAYERS[::-1], outputs, strict=True):
            rows, columns, _ = hidden.shape
            if rows > places:
                hidden = nn.relu(hidden)
            patches = nn.Dense(side * side * channels)(hidden).reshape(rows, columns, side, side, channels)
            hidden = patches.swapaxes(1, 2).reshape(rows * side, columns * side, channels)
        return jnp.moveaxis(hidden, -1, 0)
