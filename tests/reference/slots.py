"""Puts the reference's objects into the package's arrays, so that both can take the same step from the same state."""

import itertools

import numpy as np
import optax

from icac_jax.agents.cacla import CaclaState
from icac_jax.curiosity.intrinsic import CuriosityState
from icac_jax.curiosity.itm import ItmState
from icac_jax.curiosity.predictors import BankState
from tests.reference.learner import Net


def unflatten(params, sizes, squash):
    """A reference network from flat parameters: rows of each layer are (weights, bias)."""
    layers, offset = [], 0
    for before, after in itertools.pairwise(sizes):
        block = np.asarray(params[offset : offset + after * (before + 1)], float).reshape(after, before + 1)
        layers.append((block[:, :-1], block[:, -1]))
        offset += after * (before + 1)
    return Net(layers, squash)


def flatten(net):
    return np.concatenate([np.column_stack([w, b]).ravel() for w, b in net.layers])


class Slots:
    """Which slot each node of the reference has, kept as the package does it: a new one takes the first free slot."""

    def __init__(self, capacity):
        self.capacity = capacity
        self.of = {0: 0, 1: 1}

    def for_birth(self, pruned):
        """The slot that a node born in this step takes; slots of nodes pruned in line 8 are free again by then."""
        taken = {slot for name, slot in self.of.items() if name not in pruned}
        return min(slot for slot in range(self.capacity) if slot not in taken)

    def follow(self, nodes, pruned):
        """Brings the table up to date after a step of the reference."""
        born = [name for name in nodes if name not in self.of]
        if born:
            self.of[born[0]] = self.for_birth(pruned)
        self.of = {name: slot for name, slot in self.of.items() if name in nodes}

    def map_arrays(self, nodes, size):
        weights = np.zeros((self.capacity, size))
        live = np.zeros(self.capacity, bool)
        adjacency = np.zeros((self.capacity, self.capacity), bool)
        for name, node in nodes.items():
            slot = self.of[name]
            weights[slot], live[slot] = node.place, True
            for other in node.neighbours:
                adjacency[slot, self.of[other]] = True
        degree = adjacency.sum(1).astype(np.int32)
        return ItmState(weights=weights, live=live, adjacency=adjacency, degree=degree, overflow=np.int32(0))

    def bank_arrays(self, nodes, fresh, window):
        params, errors = np.array(fresh), np.zeros((self.capacity, window))
        queries = np.zeros(self.capacity, np.int32)
        for name, node in nodes.items():
            slot = self.of[name]
            params[slot] = flatten(node.predictor)
            queries[slot] = len(node.errors)
            for number, error in list(enumerate(node.errors))[-window:]:
                errors[slot, number % window] = error
        return BankState(params=params, fresh=np.asarray(fresh), errors=errors, queries=queries)


def cacla_arrays(learner):
    return CaclaState(
        actor=flatten(learner.actor),
        critic=flatten(learner.critic),
        critic_previous=None,
        actor_optimizer=optax.EmptyState(),
        critic_optimizer=optax.EmptyState(),
        variance=np.float64(learner.variance),
    )


def curiosity_arrays(learner, slots, fresh, window, size, step):
    return CuriosityState(
        map=slots.map_arrays(learner.map.nodes, size),
        bank=slots.bank_arrays(learner.map.nodes, fresh, window),
        step=np.int32(step),
        last_created=np.int32(0),
    )
