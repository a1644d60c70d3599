from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from robot.commissioning.directions import LEAST_MOTION_TICKS, AskedMotion, asked_motions, turned_the_other_way
from robot.description import robot_folder
from robot.description.forward_kinematics import ForwardPlacements
from robot.errors import CalibrationError
from tests.helpers.robots import SO101_SERVOS, so101

ELBOW = SO101_SERVOS[2]
STEP_RAD = 0.01


def moved(robot, joint, link, rises):
    """Motion of a link when a joint moves a little from the model's zero, shape (3,) [m]."""
    forward, zero = ForwardPlacements(robot), {each.name: 0.0 for each in robot.movable_joints}
    step = STEP_RAD if rises else -STEP_RAD
    places = [forward.transforms({**zero, joint: at})[link][:3, 3] for at in (0.0, step)]
    return places[1] - places[0]


def test_the_forearm_goes_where_the_request_says():
    motion = asked_motions(so101())["elbow_flex"]
    assert motion.request == "move elbow flex so that the far end of lower arm goes up"
    way = moved(so101(), "elbow_flex", "wrist_link" if "wrist_link" in so101().links else "wrist", motion.rises)
    assert way[2] > 0.9 * np.linalg.norm(way)


def test_a_joint_with_an_upright_axis_turns_the_arm_to_the_left_of_who_stands_behind_it():
    motion = asked_motions(so101())["shoulder_pan"]
    assert "to the left" in motion.request
    assert moved(so101(), "shoulder_pan", so101().tip_link, motion.rises)[1] > 0.0


def test_a_joint_along_its_link_is_turned_and_not_moved():
    assert "clockwise, as seen along the arm" in asked_motions(so101())["wrist_roll"].request


@pytest.mark.parametrize("name", ["so100", "so101", "koch_v1_1"])
def test_the_gripper_is_to_be_opened_whichever_way_its_joint_turns(name):
    robot = robot_folder.resolve(name).model
    motion = asked_motions(robot)[robot.gripper.joints[0]]
    assert motion == AskedMotion("open the gripper", rises=robot.gripper.open > robot.gripper.closed)


def test_a_gripper_whose_joint_falls_when_it_opens_is_to_be_opened_too():
    robot = so101()
    assert robot.gripper is not None
    falling = replace(robot, gripper=replace(robot.gripper, open=-1.0, closed=0.0))
    assert asked_motions(falling)["gripper"] == AskedMotion("open the gripper", rises=False)


@pytest.mark.parametrize("name", ["so100", "so101", "koch_v1_1", "fetch"])
def test_there_is_a_motion_for_every_joint_of_every_built_in_arm(name):
    robot = robot_folder.resolve(name).model
    assert set(asked_motions(robot)) == {joint.name for joint in robot.movable_joints}


@pytest.mark.parametrize(
    ("sign", "rises", "ticks", "other"),
    [
        (1, True, 300, False),
        (1, False, 300, True),
        (-1, True, 300, True),
        (-1, False, 300, False),
        (1, True, -300, True),
    ],
)
def test_the_sign_of_the_folder_is_compared_with_what_the_hand_did(sign, rises, ticks, other):
    servo = replace(ELBOW, sign=sign)
    assert turned_the_other_way(servo, AskedMotion("bend it", rises=rises), ticks) is other


def test_a_twitch_shows_no_direction():
    with pytest.raises(CalibrationError, match=r"elbow_flex: was moved by 99 ticks only.*bend it, further"):
        turned_the_other_way(ELBOW, AskedMotion("bend it", rises=True), 1 - LEAST_MOTION_TICKS)
