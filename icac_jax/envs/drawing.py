"""Pictures of an arm and of its goal, drawn in JAX: pure, differentiable, for one lane; under jit, vmap and grad.

A capsule seen from far away, by orthographic projection, is a capsule in the plane of the picture, and a sphere a disc.
Each pixel asks how far its middle is from the nearest of them; the edge is a soft step of that signed distance.

P is the number of pixels along a side, V the number of views: one of an arm whose goals lie in a plane, two of any
other, along two axes at right angles. K is the number of capsules, J of joints.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from icac_jax.envs import capsules
from icac_jax.envs.arms import ArmSpec
from icac_jax.envs.model import tip_bounds

# Width of the soft step in pixels: an edge goes from a tenth to nine tenths within 1.1 pixels.
SOFTNESS = 0.25
_MARGIN = 1.1  # so much more than the arm's reach is in the picture
_LEAST_DISC = 1.5  # radius in pixels, below which a disc is hardly seen
_TINY = 1e-12  # m^2; a distance of 0 has a gradient


class Window(NamedTuple):
    """What of the world is in the pictures.

    Attributes:
      axes: [V, 2] which axes of the world run to the right and upwards in each view.
      centre: [3] what is in the middle, in m.
      half: half a side, in m.
    """

    axes: np.ndarray
    centre: np.ndarray
    half: float


class Camera(NamedTuple):
    """Draws an arm and its goal.

    Attributes:
      size: P.
      window: what is in the pictures.
      arm: joints [J] in rad -> [V, P, P] in [0, 1], 1 where the arm is; the first row is the uppermost.
      goal: place [3] in m -> [V, P, P] likewise, of a disc as large as the arm's own goal zone, or just visible.
    """

    size: int
    window: Window
    arm: Callable[[jax.Array], jax.Array]
    goal: Callable[[jax.Array], jax.Array]

    @property
    def shape(self) -> tuple[int, int, int]:
        """V, P, P."""
        return len(self.window.axes), self.size, self.size


def window(arm: ArmSpec) -> Window:
    """The views of an arm: all that it can reach, about its base."""
    first, *rest = arm.goal_axes
    flat = [(first, rest[0] if rest else (first + 1) % 3)]
    axes = [(1, 2), (0, 2)] if len(rest) == 2 else flat  # along x, then along y: gravity pulls downwards
    low, high = tip_bounds(arm)
    return Window(np.array(axes), (low + high) / 2, _MARGIN * float(np.max(high - low)) / 2)


def pixels(seen: Window, size: int) -> np.ndarray:
    """The middles of the pixels, [P, P, 2] in m from the centre of the window, to the right and upwards."""
    places = ((np.arange(size) + 0.5) / size * 2 - 1) * seen.half
    across, up = np.meshgrid(places, places[::-1])
    return np.stack([across, up], axis=-1).astype(np.float32)


def distances(places: jax.Array, ends: jax.Array, radii: jax.Array) -> jax.Array:
    """Signed distance [P, P] in m from the nearest of some capsules, negative within it.

    Args:
      places: [P, P, 2] in m.
      ends: [K, 2, 2] of the capsules' middle lines; both the same for a disc.
      radii: [K].
    """
    across, up = places[..., 0], places[..., 1]
    nearest = jnp.full(across.shape, jnp.inf)
    # One capsule after the other, a coordinate at a time: an axis of two numbers costs twenty times as much.
    for (start, end), radius in zip(ends, radii, strict=True):
        apart, above = across - start[0], up - start[1]
        way, rise = end - start
        share = jnp.clip((apart * way + above * rise) / (way * way + rise * rise + _TINY), 0.0, 1.0)
        apart, above = apart - share * way, above - share * rise
        nearest = jnp.minimum(nearest, jnp.sqrt(apart * apart + above * above + _TINY) - radius)
    return nearest


def drawn(seen: Window, size: int, ends: jax.Array, radii: jax.Array) -> jax.Array:
    """A picture [V, P, P] of capsules.

    Args:
      seen: what is in it.
      size: P.
      ends: [K, 2, 3] in m.
      radii: [K] in m.
    """
    places, pixel = jnp.asarray(pixels(seen, size)), 2 * seen.half / size
    from_centre = ends - jnp.asarray(seen.centre, jnp.float32)
    views = [distances(places, from_centre[..., axes], radii) for axes in seen.axes]
    return jax.nn.sigmoid(-jnp.stack(views) / jnp.float32(SOFTNESS * pixel))


@functools.cache
def camera(arm: ArmSpec, size: int) -> Camera:
    """The camera of an arm; the same arm and size give the same object.

    Args:
      arm: which arm.
      size: P.

    Raises:
      ConfigError: the model does not load.
    """
    seen, ends = window(arm), capsules.ends_function(arm)
    radii = jnp.asarray(capsules.of_arm(arm).radii, jnp.float32)
    disc = jnp.asarray([max(arm.goal_radius, _LEAST_DISC * 2 * seen.half / size)], jnp.float32)

    def of_goal(place: jax.Array) -> jax.Array:
        return drawn(seen, size, jnp.broadcast_to(place, (1, 2, 3)), disc)

    return Camera(size, seen, lambda joints: drawn(seen, size, ends(joints), radii), of_goal)
