from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.description import model
from robot.description.gravity import LinkWeights
from tests.helpers.robots import so101

with warnings.catch_warnings(action="ignore"):  # of its own imports
    import pinocchio

ANGLE = st.floats(-1.6, 1.6)

HOIST_URDF = """
<robot name="hoist">
  <link name="base"/>
  <link name="load"><inertial><origin xyz="0.1 0 0"/><mass value="2"/></inertial></link>
  <joint name="lift" type="prismatic"><parent link="base"/><child link="load"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="1" velocity="1" effort="1"/></joint>
</robot>
"""
HOIST_SRDF = '<robot name="hoist"><group name="arm"><joint name="lift"/></group></robot>'


@given(st.lists(ANGLE, min_size=6, max_size=6))
def test_a_torque_is_the_gradient_of_the_links_energy(angles):
    robot = so101()
    pin = pinocchio.buildModelFromXML(robot.urdf)
    position = np.zeros(pin.nq)
    by_name = dict(zip((joint.name for joint in robot.movable_joints), angles, strict=True))
    for name, angle in by_name.items():
        position[pin.joints[pin.getJointId(name)].idx_q] = angle
    expected = pinocchio.computeGeneralizedGravity(pin, pin.createData(), position)
    for name, torque in LinkWeights(robot).holding_torques(by_name).items():
        assert torque == pytest.approx(expected[pin.joints[pin.getJointId(name)].idx_v], abs=1e-6)


def test_a_prismatic_joint_carries_all_that_hangs_on_it():
    hoist = model.parse(HOIST_URDF, HOIST_SRDF)
    assert LinkWeights(hoist).holding_torques({"lift": 0.3}) == {"lift": pytest.approx(19.62)}
