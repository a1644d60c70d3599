from __future__ import annotations

import math

import pytest

from planners.problem import Deviation, IkAnswer, MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from server.moveit.goal_reports import NOT_KNOWN, GoalReports
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import composed, pose_of

ROBOT = model.builtin()
HOME = {joint.name: 0.0 for joint in ROBOT.movable_joints}
TURNED = {**HOME, "shoulder_pan": 0.5}
TIP = "gripper_frame_link"
REPORTS = GoalReports(ROBOT, MoveItParameters(), TIP)
FOUND = IkAnswer((TURNED,), (Deviation(0.002),))


def test_a_goal_that_can_be_had_is_told_with_error_time_and_configuration() -> None:
    told = REPORTS.report(HOME, FOUND, None)
    assert (told["reachable"], told["free"], told["decided"], told["code"]) == (True, True, True, 1)
    assert told["position_error_m"] == 0.002
    assert told["solution"] == {"name": list(TURNED), "position": list(TURNED.values())}
    pan = ROBOT.joints["shoulder_pan"]
    assert told["duration_s"] > 0.5 / (0.3 * pan.max_velocity)


def test_where_the_arm_is_already_takes_no_time() -> None:
    assert REPORTS.report(TURNED, FOUND, None)["duration_s"] == 0.0


@pytest.mark.parametrize("turn_rad", [0.0, 0.7, math.pi])
def test_the_orientation_error_is_the_rotation_from_the_pose_asked_for(turn_rad: float) -> None:
    tip = pose_of(ForwardPlacements(ROBOT).transforms(TURNED)[TIP])
    turn = Pose(orientation=(0.0, math.sin(turn_rad / 2), 0.0, math.cos(turn_rad / 2)))
    told = REPORTS.report(HOME, FOUND, composed(tip, turn))
    assert told["orientation_error_rad"] == pytest.approx(turn_rad, abs=1e-6)


REFUSALS = {
    MoveItErrorCode.NO_IK_SOLUTION: (False, True),
    MoveItErrorCode.GOAL_IN_COLLISION: (True, True),
    MoveItErrorCode.TIMED_OUT: (False, False),
}


@pytest.mark.parametrize(("code", "flags"), REFUSALS.items())
def test_a_refusal_tells_what_is_known_of_it(code: MoveItErrorCode, flags: tuple[bool, bool]) -> None:
    told = REPORTS.report(HOME, PlanningFailure(code, "why", {"distance_m": 0.04}), None)
    assert (told["reachable"], told["decided"]) == flags
    assert not told["free"]
    assert (told["code"], told["message"]) == (int(code), "why")
    assert (told["position_error_m"], told["duration_s"]) == (0.04, NOT_KNOWN)


def test_a_point_out_of_reach_is_told_with_the_configuration_that_comes_nearest() -> None:
    details = {"distance_m": 0.04, "nearest_rad": {"shoulder_pan": 0.3}}
    told = REPORTS.report(HOME, PlanningFailure(MoveItErrorCode.NO_IK_SOLUTION, "why", details), None)
    assert told["solution"] == {"name": ["shoulder_pan"], "position": [0.3]}
