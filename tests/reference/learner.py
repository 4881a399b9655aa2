"""The learner of the paper once more: plain NumPy, float64, growing lists and sets, one object at a time.

Written from the paper and the rules of the map, not from the package; slow on purpose. Randomness comes in from outside
(initial weights, fresh predictors, actions), so that both implementations can be fed the same.
"""

import math

import numpy as np


class Net:
    """Fully connected, tanh hidden layers, linear or tanh output."""

    def __init__(self, layers, squash):
        # layers: list of (matrix, bias)
        self.layers = [(np.array(w, float), np.array(b, float)) for w, b in layers]
        self.squash = squash

    def copy(self):
        return Net(self.layers, self.squash)

    def forward(self, x):
        seen = [np.asarray(x, float)]
        for number, (w, b) in enumerate(self.layers):
            z = w.dot(seen[-1]) + b
            final = number == len(self.layers) - 1
            seen.append(np.tanh(z) if (not final or self.squash) else z)
        return seen

    def __call__(self, x):
        return self.forward(x)[-1]

    def train(self, x, target, rate):
        """One gradient step on 1/2 |target - y|^2, by back-propagation written out."""
        seen = self.forward(x)
        back = target - seen[-1]
        if self.squash:
            back = back * (1.0 - seen[-1] ** 2)
        fresh = []
        for number in reversed(range(len(self.layers))):
            w, b = self.layers[number]
            fresh.append((w + rate * np.outer(back, seen[number]), b + rate * back))
            if number > 0:
                back = w.T.dot(back) * (1.0 - seen[number] ** 2)
        self.layers = fresh[::-1]


class Node:
    """A node of the map with its predictor and the list of its prediction errors."""

    def __init__(self, place, predictor=None):
        self.place = np.array(place, float)
        self.neighbours = set()
        self.predictor = predictor
        self.errors = []


class Map:
    """Algorithm 1 with objects: `nodes` is a dictionary from a name that is never used again to a node."""

    def __init__(self, first, second, e_max, epsilon):
        self.nodes = {0: Node(first), 1: Node(second)}
        self.nodes[0].neighbours.add(1)
        self.nodes[1].neighbours.add(0)
        self.e_max, self.epsilon = e_max, epsilon
        self.next_name = 2
        self.pruned = set()  # names deleted by the latest stimulus in line 8
        self.events = {"cut": 0, "pruned": 0, "born": 0, "too close": 0}

    def drop(self, name):
        for other in self.nodes[name].neighbours:
            self.nodes[other].neighbours.discard(name)
        del self.nodes[name]

    def adapt(self, s, capacity=math.inf):
        """Returns (name of n, distance to n before it moved, name of the new node or None, whether it overflowed)."""
        s = np.asarray(s, float)
        self.pruned = set()
        # line 1
        names = list(self.nodes)
        away = np.sqrt(np.sum((s - np.array([self.nodes[name].place for name in names])) ** 2, axis=1))
        first, next_one = np.argsort(away, kind="stable")[:2]
        n, second, distance = names[first], names[next_one], float(away[first])
        winner, runner = self.nodes[n], self.nodes[second]
        # line 2
        winner.place = winner.place + self.epsilon * (s - winner.place)
        # line 3
        winner.neighbours.add(second)
        runner.neighbours.add(n)
        # lines 4-11
        for m in sorted(winner.neighbours):
            other = self.nodes[m]
            if np.sum((winner.place - runner.place) * (other.place - runner.place)) < 0:
                winner.neighbours.discard(m)
                other.neighbours.discard(n)
                self.events["cut"] += 1
                if not other.neighbours:
                    del self.nodes[m]
                    self.pruned.add(m)
        # lines 12-14
        born, full = None, False
        outside = np.sqrt(np.sum((s - winner.place) ** 2)) > self.e_max
        if outside and np.sum((winner.place - s) * (runner.place - s)) > 0:
            if len(self.nodes) < capacity:
                born = self.next_name
                self.next_name += 1
                self.nodes[born] = Node(s)
                self.nodes[born].neighbours.add(n)
                winner.neighbours.add(born)
                self.events["born"] += 1
            else:
                full = True
        # lines 19-21, two nodes are kept
        if np.sqrt(np.sum((winner.place - runner.place) ** 2)) < 0.5 * self.e_max and len(self.nodes) > 2:
            self.drop(second)
            self.events["too close"] += 1
        self.events["pruned"] += len(self.pruned)
        return n, distance, born, full


def average(errors, mu):
    """Eq. 9 over those errors that there are."""
    recent = errors[-mu:]
    return sum(recent) / len(recent)


class Learner:
    """Algorithm 2 for cacla, cacla_var and icac with the default choices at every open point."""

    def __init__(
        self, algo, actor, critic, map_=None, *, gamma, actor_rate, critic_rate, predictor_rate, beta, mu, lag
    ):
        self.algo, self.actor, self.critic, self.map = algo, actor, critic, map_
        self.gamma, self.beta, self.mu, self.lag = gamma, beta, mu, lag
        self.actor_rate, self.critic_rate, self.predictor_rate = actor_rate, critic_rate, predictor_rate
        self.variance = 1.0

    def wonder(self, s, a, s_next, fresh):
        """Lines 8-9: the map, one predictor, the intrinsic reward. `fresh(name)` makes a new node's predictor."""
        n, distance, born, _ = self.map.adapt(s)
        if born is not None:
            self.map.nodes[born].predictor = fresh(born)
        # The node of s_t may be gone only if it was n', never n.
        node = self.map.nodes[n if born is None else born]
        inputs = np.concatenate([s, a])
        error = float(np.sqrt(np.sum((node.predictor(inputs) - s_next) ** 2)))
        node.predictor.train(inputs, s_next, self.predictor_rate)
        node.errors.append(error)
        progress = 0.0
        if len(node.errors) > self.lag:
            progress = abs(average(node.errors, self.mu) - average(node.errors[: -self.lag], self.mu))
        return progress, distance

    def learn(self, obs, a, reward, next_obs, state_size, fresh=None):
        """Lines 8-17; returns (delta, updates of the actor, learning progress, perception error)."""
        progress = perception = 0.0
        if self.algo == "icac":
            progress, perception = self.wonder(obs[:state_size], a, next_obs[:state_size], fresh)
        r = reward + progress + perception
        y = r + self.gamma * self.critic(next_obs)[0]
        delta = y - self.critic(obs)[0]
        self.critic.train(obs, np.array([y]), self.critic_rate)
        self.variance = (1 - self.beta) * self.variance + self.beta * delta * delta
        times = 0
        if delta > 0:
            times = 1 if self.algo == "cacla" else math.ceil(delta / math.sqrt(self.variance))
            for _ in range(times):
                self.actor.train(obs, a, self.actor_rate)
        return delta, times, progress, perception
