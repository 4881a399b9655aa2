"""The oracle: hand-made cases, brute force over grids, the general search against the exact planar one."""

import dataclasses
import itertools

import numpy as np
import pytest

from icac_jax.envs import arms, oracle, reach
from tests.reference.physics import CArm

PLANAR = reach.default_params(arms.PLANAR2)
NICO = reach.default_params(arms.NICO4)


def tip_of(degrees):
    a, b = np.radians(degrees)
    return np.array([np.cos(a) + np.cos(a + b), np.sin(a) + np.sin(a + b), 0.0])


def planar(start, goal, **changes):
    params = PLANAR.replace(**changes)
    return int(oracle.steps(arms.PLANAR2, params, np.radians([start]), np.array([goal], float))[0])


def test_by_hand():
    assert planar((90.0, 90.0), tip_of((90.0, 90.0))) == 1  # an episode has a step at least
    # A tiny zone leaves one way: 35 degrees at the shoulder, so four steps of ten.
    assert planar((90.0, 90.0), tip_of((125.0, 80.0)), goal_radius=1e-4) == 4
    assert planar((90.0, 90.0), tip_of((130.0, 80.0)), goal_radius=1e-3) == 4
    assert planar((90.0, 90.0), tip_of((130.0, 80.0)), goal_radius=1e-3, action_bound=5.0) == 8
    # Straight out along x from straight up, radius 0.3: the tip at distance 2 must turn to within 2 asin(0.3 / 4) = 8.6
    # degrees, 81.4 of the 90; bending cannot help at the rim.
    assert planar((90.0, 0.0), (2.0, 0.0, 0.0), joint_low=(-180.0, 0.0)) == 9


@pytest.mark.parametrize(("low", "high"), [(0.0, 180.0), (-90.0, 90.0), (-180.0, 180.0)])
def test_planar_against_a_grid(low, high):
    """A grid over the joint square finds no fewer steps, and the same but for pairs at the edge of a step."""
    params = PLANAR.replace(joint_low=(low, low), joint_high=(high, high))
    start, goal = oracle.pairs(arms.PLANAR2, params, 40, seed=3)
    least = oracle.steps(arms.PLANAR2, params, start, goal)
    side = np.radians(np.linspace(low, high, 1201))
    a, b = np.meshgrid(side, side)
    x, y = np.cos(a) + np.cos(a + b), np.sin(a) + np.sin(a + b)
    same = 0
    for pair in range(40):
        inside = np.hypot(x - goal[pair, 0], y - goal[pair, 1]) <= params.goal_radius
        moves = np.maximum(np.abs(a - start[pair, 0]), np.abs(b - start[pair, 1]))[inside].min()
        by_grid = max(1, int(np.ceil(moves / np.radians(10) - 1e-9)))
        assert least[pair] <= by_grid <= least[pair] + 1
        same += least[pair] == by_grid
    assert same >= 36


def test_a_path_of_that_many_steps_exists_and_none_of_fewer_is_found():
    """NICO: random search in the box of one step fewer finds nothing; descent found something in the box itself."""
    params = NICO.replace(reset_range=0.5)
    start, goal = oracle.pairs(arms.NICO4, params, 6, seed=4)
    least = oracle.steps(arms.NICO4, params, start, goal)
    low, high = np.radians(params.joint_low), np.radians(params.joint_high)
    grid = np.array(list(itertools.product(np.linspace(-1, 1, 15), repeat=4)))
    for pair in np.flatnonzero(least > 1):
        box = (least[pair] - 1) * np.radians(10.0)
        tried = np.clip(start[pair] + box * grid, low, high)
        away = np.linalg.norm(oracle.tips(arms.NICO4, tried) - goal[pair], axis=1)
        assert away.min() > params.goal_radius


def test_the_search_agrees_with_the_exact_planar_oracle():
    start, goal = oracle.pairs(arms.PLANAR2, PLANAR, 200, seed=5)
    exact = oracle.steps(arms.PLANAR2, PLANAR, start, goal)
    searched = oracle.steps(dataclasses.replace(arms.PLANAR2, name="any"), PLANAR, start, goal)
    assert np.all(searched >= exact)
    assert np.mean(searched == exact) > 0.98


@pytest.mark.parametrize(
    ("low", "high", "least", "most"), [(-180.0, 180.0, 9.0, 10.1), (0.0, 180.0, 6.4, 7.1), (-90.0, 90.0, 4.8, 5.5)]
)
def test_planar_means_are_the_known_ones(low, high, least, most):
    mean, error = oracle.mean_steps(arms.PLANAR2, PLANAR.replace(joint_low=(low, low), joint_high=(high, high)), 1000)
    print(f"planar2 [{low:g}, {high:g}] degrees: oracle {mean:.2f} +- {error:.2f} steps")
    assert least <= mean <= most


def test_pairs_are_drawn_from_the_reset_range():
    params = NICO.replace(reset_range=0.35)
    start, goal = oracle.pairs(arms.NICO4, params, 500)
    low, high = np.radians(params.joint_low), np.radians(params.joint_high)
    share = np.abs(start - (low + high) / 2) / (high - low)
    assert share.max() <= 0.175 + 1e-9
    assert share.max() > 0.17
    c = CArm(arms.NICO4, 1)
    np.testing.assert_allclose(oracle.tips(arms.NICO4, start[:5]), [c.tip(q) for q in start[:5]], atol=1e-6)
    assert goal.shape == (500, 3)
