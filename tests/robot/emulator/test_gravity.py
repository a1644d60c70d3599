from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.gravity import DUTY_PERMILLE_PER_NM, holding_duty_permille
from robot.model import builtin

with warnings.catch_warnings(action="ignore"):  # of its own imports
    import pinocchio

JOINTS = ("shoulder_lift", "elbow_flex", "wrist_flex")
MODEL = pinocchio.buildModelFromXML(builtin().urdf)
DATA = MODEL.createData()
ANGLE = st.floats(-1.6, 1.6)


@given(ANGLE, ANGLE, ANGLE)
def test_the_weight_is_that_of_the_links_in_the_urdf(lift, elbow, wrist):
    position = np.array([0.0, lift, elbow, wrist, 0.0, 0.0])
    torque_nm = pinocchio.computeGeneralizedGravity(MODEL, DATA, position)
    duty = holding_duty_permille(dict(zip(JOINTS, (lift, elbow, wrist), strict=True)))
    for joint in JOINTS:
        expected = torque_nm[MODEL.joints[MODEL.getJointId(joint)].idx_v]
        assert duty[joint] / DUTY_PERMILLE_PER_NM == pytest.approx(expected, abs=0.08)


def test_an_arm_upright_weighs_little_and_a_stretched_one_most():
    upright = holding_duty_permille({"shoulder_lift": -0.22, "elbow_flex": -1.35, "wrist_flex": 0.0})
    stretched = holding_duty_permille({"shoulder_lift": 1.35, "elbow_flex": -1.35, "wrist_flex": 0.0})
    assert abs(upright["shoulder_lift"]) < 0.1 * abs(stretched["shoulder_lift"])
