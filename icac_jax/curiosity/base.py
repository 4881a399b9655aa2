"""What a map of experience and a signal of curiosity are: a few pure functions for one lane."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax


class MapInfo(NamedTuple):
    """What one stimulus did to a map.

    Attributes:
      node: [] int32, the node responsible for the stimulus: a new one if one was created, else the nearest.
      nearest: [] int32, the node that was nearest before anything was created.
      distance: [] distance from the stimulus to `nearest`, in the stimulus' own units.
      created: [] bool, a node was created.
      started: [] int32, slot of a node that is new and not responsible for this stimulus, whose predictor starts anew;
        N where there is none. None for a map whose new nodes are always the responsible ones.
    """

    node: jax.Array
    nearest: jax.Array
    distance: jax.Array
    created: jax.Array
    started: jax.Array | None = None


class Nodes(NamedTuple):
    """What a map holds, for pictures.

    Attributes:
      live: [N] bool, which slots are nodes.
      weights: [N, D] position of each node; meaningless where not live.
      edges: [N, N] bool, symmetric, or None for a map without edges.
    """

    live: jax.Array
    weights: jax.Array
    edges: jax.Array | None


class Slots(NamedTuple):
    """A state whose map may have fewer slots than its capacity N, at a lower cost per step, while its nodes fit.

    It is for maps whose new nodes take the first free slot, and whose `update` takes N from the arrays of the state.

    Attributes:
      capacity: N.
      cut: (state, slots) -> state with so many slots, the first ones.
      overflow: (state) -> [] int32, how many nodes have found no free slot so far.
    """

    capacity: int
    cut: Callable[[Any, int], Any]
    overflow: Callable[[Any], jax.Array]

    def inside(self, name: str) -> "Slots":
        """The same of a state that holds this one as a field of that name."""

        def cut(state: Any, slots: int) -> Any:
            return state.replace(**{name: self.cut(getattr(state, name), slots)})

        return Slots(self.capacity, cut, lambda state: self.overflow(getattr(state, name)))


class Map(NamedTuple):
    """A map of fixed capacity N over stimuli [D], as pure functions for one lane.

    Attributes:
      capacity: N, slots for nodes.
      init: (key, hyper) -> state.
      update: (state, stimulus [D], hyper, enabled) -> (state, `MapInfo`). Where `enabled` [] bool is False nothing is
        written.
      nodes: (state) -> `Nodes`.
      counts: (state) -> numbers [] by name, reported with each episode, such as `live_nodes`.
      slots: how its state has fewer slots; None where it needs all of them.
    """

    capacity: int
    init: Callable[[jax.Array, Any], Any]
    update: Callable[[Any, jax.Array, Any, jax.typing.ArrayLike], tuple[Any, MapInfo]]
    nodes: Callable[[Any], Nodes]
    counts: Callable[[Any], dict[str, jax.Array]]
    slots: Slots | None = None


class Step(NamedTuple):
    """What a signal sees of a transition.

    Attributes:
      sensed: [D] s_t, in [-1, 1].
      action: [A] a_t, in units of the action bound.
      next_sensed: [D] s_{t+1}.
    """

    sensed: jax.Array
    action: jax.Array
    next_sensed: jax.Array


class Paid(NamedTuple):
    """What a signal pays for a transition.

    Attributes:
      bonus: [] intrinsic reward.
      terms: numbers [] by name whose sum the bonus is; each is a column of the records. Empty where it has no parts.
      finite: [] bool; False freezes the lane, which counts as diverged.
    """

    bonus: jax.Array
    terms: dict[str, jax.Array]
    finite: jax.Array


class Signal(NamedTuple):
    """What pays for exploration, as pure functions for one lane; `agents.curious` puts it around an agent.

    Attributes:
      init: (key, hyper) -> state; a signal that has seen nothing.
      update: (state, `Step`, key, hyper, enabled) -> (state, `Paid`); learns from a transition and pays for it. Where
        `enabled` [] bool is False nothing is written.
      counts: (state) -> numbers [] by name, reported with each episode, such as `live_nodes`.
      map: the map that it builds, for pictures, whose state is `state.map`; None without one.
      slots: how its state has fewer slots of the map; None where it needs all of them.
    """

    init: Callable[[jax.Array, Any], Any]
    update: Callable[[Any, Step, jax.Array, Any, jax.typing.ArrayLike], tuple[Any, Paid]]
    counts: Callable[[Any], dict[str, jax.Array]] = lambda state: {}
    map: Map | None = None
    slots: Slots | None = None
