from __future__ import annotations

import dataclasses
import math
import xml.etree.ElementTree as ET

import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.kinematics import ForwardKinematics
from planners.geometry.shapes import kinematic_urdf
from robot.description import model
from tests.planners.small_arms import CRANE_SRDF, CRANE_URDF


@pytest.fixture
def crane():
    return model.parse(CRANE_URDF, CRANE_SRDF)


def test_kinematic_urdf_has_every_joint_and_no_shape(robot):
    root = ET.fromstring(kinematic_urdf(robot))
    assert {joint.get("name") for joint in root.iterfind("joint")} == set(robot.joints)
    assert not list(root.iter("visual"))
    assert not list(root.iter("collision"))


def test_continuous_joints_get_one_turn_either_way(crane):
    model_of_crane = pin.buildModelFromXML(kinematic_urdf(crane))
    assert model_of_crane.nq == model_of_crane.nv == 3
    turn = model_of_crane.joints[model_of_crane.getJointId("turn")].idx_q
    assert model_of_crane.lowerPositionLimit[turn] == pytest.approx(-math.pi)
    assert model_of_crane.upperPositionLimit[turn] == pytest.approx(math.pi)


def test_joints_may_come_in_any_order(robot, collision):
    names = collision.joint_names
    forward, backward = ForwardKinematics(robot, names), ForwardKinematics(robot, names[::-1])
    q = np.linspace(-0.5, 0.5, 6)
    forward.place(q)
    backward.place(q[::-1])
    for link in robot.links:
        np.testing.assert_array_equal(forward.placement(link).homogeneous, backward.placement(link).homogeneous)


def test_limits_are_those_of_the_model(robot):
    elbow = dataclasses.replace(robot.joints["elbow_flex"], lower=-0.5, upper=0.25)
    narrow = dataclasses.replace(robot, joints={**robot.joints, "elbow_flex": elbow})
    kinematics = pin.buildModelFromXML(kinematic_urdf(narrow))
    column = kinematics.joints[kinematics.getJointId("elbow_flex")].idx_q
    assert (kinematics.lowerPositionLimit[column], kinematics.upperPositionLimit[column]) == (-0.5, 0.25)
