"""The chain of matrices against MuJoCo's own kinematics."""

from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from icac_jax.envs import arms, assets, chain

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "own_arm" / "arm7.xml"
# Joints beside the body's origin, two on a body, a slanted axis, a reference angle, a branch that carries no tip.
ODD = """
<mujoco>
  <worldbody>
    <body pos="0.1 0.2 0.3" euler="10 20 30">
      <joint name="a" axis="1 2 3" pos="0.05 0 0.02"/><joint name="b" axis="0 1 0" pos="0 0.1 0" ref="25"/>
      <geom size="0.1" mass="1"/>
      <body pos="0 0 0.2"><joint name="other" axis="0 1 0"/><geom size="0.1" mass="1"/></body>
      <body pos="0 0.3 0" euler="0 50 0">
        <geom size="0.1" mass="1"/>
        <body pos="0.2 0 0" euler="40 0 10">
          <joint name="c" axis="0 0 1"/><geom size="0.1" mass="1"/><site name="tip" pos="0.1 0.1 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def models():
    yield mujoco.MjModel.from_xml_string(ODD), "tip"
    yield mujoco.MjModel.from_xml_path(str(EXAMPLE)), "fingertip"
    for arm in arms.ARMS.values():
        yield mujoco.MjModel.from_xml_path(str(assets.path(arm.model))), "tip"


@pytest.mark.parametrize("number", range(4), ids=["odd", "arm7", "planar2", "nico4"])
def test_against_mujoco(number):
    model, name = list(models())[number]
    site = model.site(name).id
    data = mujoco.MjData(model)
    joints = np.random.default_rng(0).uniform(-3, 3, (50, model.nq))
    wanted = []
    for data.qpos[:] in joints:
        mujoco.mj_kinematics(model, data)
        wanted.append(data.site_xpos[site].copy())
    tip = chain.tip_function(model, site)
    got = jax.jit(jax.vmap(tip))(jnp.asarray(joints, jnp.float32))
    assert got.dtype == jnp.float32
    np.testing.assert_allclose(got, wanted, atol=3e-6)
