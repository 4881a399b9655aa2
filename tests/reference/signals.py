"""Rivals of the paper's reward once more, in plain NumPy on lists of errors and networks of objects."""

import math

import numpy as np

from tests.reference.learner import Net


def mean(numbers):
    return sum(numbers) / len(numbers)


def averages(errors, mu, lag):
    """<e_t> and <e_{t-T}> of a node's errors so far; the latter is None while there are too few."""
    before = errors[: max(len(errors) - lag, 0)]
    return mean(errors[-mu:]), mean(before[-mu:]) if before else None


def normalised_progress(errors, mu, lag):
    now, before = averages(errors, mu, lag)
    return 0.0 if before is None else abs(now - before) / max(now, before)


def signed_progress(errors, mu, lag):
    now, before = averages(errors, mu, lag)
    return 0.0 if before is None else before - now


def visits(number):
    return 1.0 / math.sqrt(number)


class Rnd:
    """Two networks; the error of one about the other, over the root mean square of all errors."""

    def __init__(self, target, predictor, rate):
        self.target, self.predictor, self.rate = Net(target, False), Net(predictor, False), rate
        self.errors = []

    def pay(self, state):
        wanted = self.target(state)
        self.errors.append(np.mean((self.predictor(state) - wanted) ** 2))
        self.predictor.train(state, wanted, self.rate)
        return self.errors[-1] / math.sqrt(mean([error**2 for error in self.errors]))
