"""The small feed-forward networks of the paper, and one gradient step on them.

A network is a description (`Network`, static) and a flat parameter vector [P]; a flat vector makes a bank of networks
one array, and touching one of them one gather and one scatter.
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from icac_jax.fast.sums import product


class Network(NamedTuple):
    """A fully connected network: tanh hidden layers and a linear or tanh output (Sec. IV).

    Attributes:
      sizes: widths from input to output, e.g. (7, 12, 4).
      output: activation of the last layer.
    """

    sizes: tuple[int, ...]
    output: Literal["linear", "tanh"] = "linear"

    @property
    def size(self) -> int:
        """Number of parameters P, biases included."""
        return sum((before + 1) * after for before, after in zip(self.sizes, self.sizes[1:], strict=False))


def init(net: Network, key: jax.Array, scale: jax.typing.ArrayLike) -> jax.Array:
    """Random parameters [P], uniform in +-`scale` (the paper only says "randomly initialize", Alg. 2 line 1)."""
    return jnp.asarray(scale) * jax.random.uniform(key, (net.size,), minval=-1.0, maxval=1.0)


def layers(net: Network, params: jax.Array) -> list[tuple[jax.Array, jax.Array]]:
    """Weights [after, before] and biases [after] of each layer, from the input on, of parameters [P]."""
    found, offset = [], 0
    for before, after in zip(net.sizes, net.sizes[1:], strict=False):
        end = offset + (before + 1) * after
        both = params[offset:end].reshape(after, before + 1)
        found.append((both[:, :-1], both[:, -1]))
        offset = end
    return found


def apply(net: Network, params: jax.Array, inputs: jax.Array) -> jax.Array:
    """Output [sizes[-1]] of the network for one input [sizes[0]] with parameters [P]."""
    return _activations(net, layers(net, params), inputs)[-1]


def descent(net: Network, params: jax.Array, inputs: jax.Array, target: jax.Array) -> jax.Array:
    """Minus the gradient [P] of 1/2 |target - output|^2, the direction of Eq. 3, Eq. 5 and the predictors."""
    each = layers(net, params)
    *values, output = _activations(net, each, inputs)
    error = target - output
    if net.output == "tanh":
        error = error * (1.0 - output**2)
    # Written out because the derivative of cutting layers out of [P] is a sum of arrays of that size, one a layer.
    parts = []
    for (weights, _), entering in zip(reversed(each), reversed(values), strict=True):
        parts.append(jnp.ravel(error[:, None] * jnp.append(entering, 1.0)))
        error = product(weights.T, error) * (1.0 - entering**2)
    return jnp.concatenate(parts[::-1])


def _activations(net: Network, each: list[tuple[jax.Array, jax.Array]], inputs: jax.Array) -> list[jax.Array]:
    """What enters each layer, and what leaves the last."""
    values = [inputs]
    for number, (weights, biases) in enumerate(each):
        leaving = product(weights, values[-1]) + biases
        if number < len(each) - 1 or net.output == "tanh":
            leaving = jnp.tanh(leaving)
        values.append(leaving)
    return values
