"""The other maps once more: plain NumPy, float64, growing dictionaries, one object at a time.

Written from Fritzke (1995), Kohonen (1990) and the sentence that says what a grid is, not from the package.
"""

import math

import numpy as np


class Gas:
    """Growing neural gas: `places` and `errors` by names that are never used again, `ages` by pairs of names."""

    def __init__(self, first, second, lam, a_max, e_b, e_n, alpha, d):
        self.places = {0: np.array(first, float), 1: np.array(second, float)}
        self.errors = {0: 0.0, 1: 0.0}
        self.ages = {}
        self.lam, self.a_max, self.e_b, self.e_n, self.alpha, self.d = lam, a_max, e_b, e_n, alpha, d
        self.seen, self.next_name, self.overflow = 0, 2, 0
        self.dropped = set()  # by the latest stimulus
        self.events = {"cut": 0, "dropped": 0, "born": 0}

    def topological(self, name):
        return {other for pair in self.ages if name in pair for other in pair if other != name}

    def adapt(self, x, capacity=math.inf):
        """Returns (name of the winner, its distance before it moved, name of the new node or None)."""
        x = np.asarray(x, float)
        away = {name: float(np.sqrt(np.sum((x - place) ** 2))) for name, place in self.places.items()}
        s1, s2 = sorted(away, key=away.get)[:2]
        for pair in self.ages:
            if s1 in pair:
                self.ages[pair] += 1
        self.errors[s1] += away[s1] ** 2
        self.places[s1] = self.places[s1] + self.e_b * (x - self.places[s1])
        for other in self.topological(s1):
            self.places[other] = self.places[other] + self.e_n * (x - self.places[other])
        self.ages[frozenset((s1, s2))] = 0
        for pair in [pair for pair, age in self.ages.items() if age > self.a_max]:
            del self.ages[pair]
            self.events["cut"] += 1
        self.dropped = set()
        if self.seen:  # the first two have no edge before the first stimulus
            self.dropped = {name for name in self.places if not self.topological(name)}
        for name in self.dropped:
            del self.places[name], self.errors[name]
            self.events["dropped"] += 1
        self.seen += 1
        born = None
        if self.seen % self.lam == 0:
            if len(self.places) < capacity:
                born, self.next_name = self.next_name, self.next_name + 1
                q = max(self.errors, key=self.errors.get)
                f = max(self.topological(q), key=self.errors.get)
                self.places[born] = 0.5 * (self.places[q] + self.places[f])
                del self.ages[frozenset((q, f))]
                self.ages |= {frozenset((q, born)): 0, frozenset((born, f)): 0}
                self.errors[q] *= self.alpha
                self.errors[f] *= self.alpha
                self.errors[born] = self.errors[q]
                self.events["born"] += 1
            else:
                self.overflow += 1
        for name in self.errors:
            self.errors[name] *= self.d
        return s1, away[s1], born


class Lattice:
    """A self-organising map: nodes by their place on the lattice."""

    def __init__(self, weights, rates, radii, decay):
        self.weights = {place: np.array(w, float) for place, w in weights.items()}
        self.rates, self.radii, self.decay, self.seen = rates, radii, decay, 0

    def adapt(self, x):
        """Returns (place of the winner on the lattice, its distance before it moved)."""
        away = {place: math.dist(x, w) for place, w in self.weights.items()}
        winner = min(away, key=away.get)
        share = min(self.seen / self.decay, 1.0)
        rate = math.exp((1 - share) * math.log(self.rates[0]) + share * math.log(self.rates[1]))
        radius = math.exp((1 - share) * math.log(self.radii[0]) + share * math.log(self.radii[1]))
        for place, w in self.weights.items():
            h = math.exp(-(math.dist(place, winner) ** 2) / (2 * radius**2))
            self.weights[place] = w + rate * h * (np.asarray(x) - w)
        self.seen += 1
        return winner, away[winner]


class Cells:
    """A grid: the visited cells, by their numbers along each dimension."""

    def __init__(self, side):
        self.side, self.visited = side, set()

    def adapt(self, x):
        """Returns (cell, distance to its centre, whether this is its first visit)."""
        centres = [-1 + (k + 0.5) * 2 / self.side for k in range(self.side)]
        cell = tuple(min(range(self.side), key=lambda k: abs(entry - centres[k])) for entry in x)
        new = cell not in self.visited
        self.visited.add(cell)
        return cell, math.dist(x, [centres[k] for k in cell]), new
