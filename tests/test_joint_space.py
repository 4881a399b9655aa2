"""Pictures of joint space: walls, goal configurations and the way, each where it belongs."""

import numpy as np
from matplotlib.figure import Figure

from icac_jax.envs import arms, oracle
from icac_jax.policies import map_picture
from icac_jax.policies.joint_space import JointSpace
from icac_jax.policies.saved import Learner
from icac_jax.settings.options import resolve

SIDE = 400


def at(picture, drawn, *degrees):
    """The colour at joint angles, and how far it is from a grey."""
    (x, y), *_ = drawn._at(np.array([degrees]))
    colour = picture[round(y / 2), round(x / 2)].astype(int)
    return colour, int(np.ptp(colour))


def test_joint_space_of_an_episode():
    settings = resolve(task="door")
    drawn = JointSpace(settings.arm, settings.params, SIDE)
    goal = oracle.tips(arms.PLANAR2, np.radians([[120.0, 0.0]]))[0]
    way = np.radians([[0.0, 0.0], [-100.0, 0.0], [-100.0, 100.0]])
    picture = drawn.draw(way, goal)
    assert picture.shape == (SIDE, SIDE, 3)
    wall, grey = at(picture, drawn, 60, 0)
    assert wall.max() < 160
    assert grey < 20
    assert at(picture, drawn, 60, 150)[0].min() > 220  # the door
    zone, _ = at(picture, drawn, 120, 0)
    assert zone[1] > zone[0] + 50
    for place in ((-50, 0), (-100, 50)):
        trail, _ = at(picture, drawn, *place)
        assert trail[0] > trail[1] + 60
    assert at(picture, drawn, -50, 60)[0].min() > 220


def test_maps_show_the_walls():
    for arm, pairs in (("planar2", {(0, 1): 2}), ("nico4", {(0, 1): 2, (0, 2): 2, (2, 3): 0})):
        learner = Learner(resolve(arm=arm, task="two_walls"), 0, None, 0)
        for (across, up), boxes in pairs.items():
            panel = Figure().subplots()
            map_picture._walls(panel, across, up, learner)
            assert len(panel.patches) == boxes
            dark = [patch.get_facecolor()[0] < 0.6 for patch in panel.patches]
            assert all(dark) == (up < 2) or not boxes


def test_an_edge_is_drawn_for_the_two_joints_along_which_it_runs_the_furthest():
    joints = np.array([[0.0, 0.0, 0.0, 0.0], [90.0, 1.0, 2.0, 90.0], [0.0, 50.0, 90.0, 2.0]])
    found = map_picture.Nodes(joints, np.array([[0, 1], [0, 2]]), np.ones(3), np.ones(3))
    # Of the second edge's joints the last but one has so wide a range that its angle is a small share of it.
    ranges = np.array([180.0, 180.0, 10000.0, 180.0])
    np.testing.assert_array_equal(map_picture.furthest(found, ranges), [[0, 3], [1, 3]])
