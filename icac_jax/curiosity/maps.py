"""The maps by name. A map more is a module, a line here and its name in `options.MapName`."""

from collections.abc import Callable
from typing import NamedTuple

from icac_jax.curiosity import gng, grid, itm, som
from icac_jax.curiosity.base import Map
from icac_jax.curiosity.options import CuriositySpec


class Kind(NamedTuple):
    """A kind of map.

    Attributes:
      title: what figures and tables call it.
      build: (static choices) -> `Map`.
    """

    title: str
    build: Callable[[CuriositySpec], Map]


MAPS: dict[str, Kind] = {
    "itm": Kind("ITM", lambda spec: itm.topological_map(spec.map_capacity, spec.map_size, spec.spacing_removal)),
    "gng": Kind("growing neural gas", lambda spec: gng.growing_neural_gas(spec.map_capacity, spec.map_size)),
    "som": Kind(
        "self-organising map", lambda spec: som.self_organising_map(spec.som_side, spec.som_dimensions, spec.map_size)
    ),
    "grid": Kind("grid", lambda spec: grid.grid_map(spec.grid_side, spec.map_size)),
}


def build(spec: CuriositySpec) -> Map:
    """The map that the choices name; equal choices give the same object.

    Args:
      spec: static choices, sizes included.

    Raises:
      ConfigError: a lattice would have more nodes than a map may have.
    """
    return MAPS[spec.map].build(spec)
