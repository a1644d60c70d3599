import numpy as np
import pinocchio as pin
import pytest

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Box, Pose
from planners.servo.question import (
    JointVelocities,
    ServoLimits,
    ServoQuestion,
    ServoStatus,
    TipTarget,
    TipTwist,
)
from tests.planners.scenes import thing
from tests.planners.servo.steering import PERIOD_S, READY, TIP, SteeredArm


@pytest.fixture
def arm(planner, robot):
    return SteeredArm(planner, robot)


@pytest.fixture
def table(planner, put):
    put(planner, thing(Box((2.0, 2.0, 0.1)), 0.0, 0.0, -0.05, name="table"))


def speeds(arm):
    return np.diff(np.array(arm.tips_m), axis=0) / PERIOD_S


def test_a_twist_moves_the_tip_in_its_direction_at_its_speed(arm):
    arm.steer(TipTwist((0.0, 0.1, 0.05)), 0.8)
    assert speeds(arm)[-1] == pytest.approx([0.0, 0.1, 0.05], abs=0.003)


def test_nothing_drifts_that_nobody_moves(arm):
    start = arm.tip_m
    arm.steer(lambda at_s: TipTwist((0.0, 0.1 * np.cos(3 * at_s), 0.1 * np.sin(3 * at_s))), 2.5)
    assert np.abs(np.array(arm.tips_m)[:, 0] - start[0]).max() < 0.0015
    # When commands cease the arm comes to rest.
    arm.steer(TipTwist(), 1.0)
    assert arm.tip_m[0] == pytest.approx(start[0], abs=0.0005)
    assert np.linalg.norm(speeds(arm)[-1]) < 0.002


def test_the_position_comes_before_the_turn_and_what_is_given_up_is_told(arm):
    answer = arm.steer(TipTwist((0.0, 0.0, 0.05), (0.0, 0.0, 0.5)), 0.8)
    assert speeds(arm)[-1] == pytest.approx([0.0, 0.0, 0.05], abs=0.003)
    assert "given up" in answer.message


def test_a_turn_that_five_joints_can_do_is_done_about_the_tip(arm):
    start, axes = arm.tip_m, arm.tip_axes
    answer = arm.steer(TipTwist(angular_rad_s=(0.0, 0.5, 0.0)), 0.8)
    turned = pin.log3(arm.tip_axes @ axes.T)
    assert turned[1] > 0.25
    assert np.abs(turned[[0, 2]]).max() < 0.02
    assert np.linalg.norm(arm.tip_m - start) < 0.003
    assert "given up" not in answer.message


def test_towards_the_end_of_its_reach_the_arm_halts_and_then_comes_back(arm):
    halted = arm.steer(TipTwist((0.2, 0.0, 0.0)), 1.6)
    assert halted.status in (ServoStatus.HALT_FOR_SINGULARITY, ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY)
    assert abs(speeds(arm)[-1][0]) < 0.04
    farthest = arm.tip_m[0]
    arm.steer(TipTwist((-0.2, 0.0, 0.0)), 1.0)
    assert arm.tip_m[0] < farthest - 0.03


def test_towards_a_table_the_arm_slows_down_keeps_its_distance_moves_along_it_and_gets_away(arm, table):
    arm.steer(TipTwist((0.0, 0.0, -0.2)), 2.4)
    halted = arm.answers[-1]
    assert halted.status is ServoStatus.HALT_FOR_COLLISION
    assert "table" in halted.message
    lowest = arm.tip_m[2]
    arm.steer(TipTwist((0.0, 0.1, -0.1)), 0.6)
    assert speeds(arm)[-1][1] > 0.05
    arm.steer(TipTwist((0.0, 0.0, 0.1)), 0.5)
    assert arm.answers[-1].status is ServoStatus.NO_WARNING
    assert arm.tip_m[2] > lowest + 0.02


def test_a_joint_at_its_limit_is_told_and_the_others_go_on(planner, robot):
    arm = SteeredArm(planner, robot, READY | {"wrist_roll": 2.8})
    answer = arm.steer(JointVelocities({"wrist_roll": 1.0, "shoulder_pan": 0.3}), 0.8)
    assert answer.status is ServoStatus.JOINT_BOUND
    assert "wrist_roll" in answer.message
    assert answer.velocity_rad_s["shoulder_pan"] == pytest.approx(0.3, rel=1e-4)
    assert arm.positions_rad["wrist_roll"] <= robot.joints["wrist_roll"].upper + 1e-6


def test_joints_that_are_not_named_rest(arm):
    answer = arm.steer(JointVelocities({"elbow_flex": 0.4}), 0.5)
    assert answer.velocity_rad_s["elbow_flex"] == pytest.approx(0.4, rel=1e-4)
    assert np.abs(np.delete(arm.joints_rad[-1] - arm.joints_rad[0], 2)).max() == 0.0


def test_too_fast_a_twist_keeps_its_direction_at_what_the_joints_can_do(arm, robot):
    answer = arm.steer(TipTwist((0.0, 0.0, 2.0)), 0.5)
    assert answer.share < 0.5
    for name, velocity in answer.velocity_rad_s.items():
        assert abs(velocity) <= robot.joints[name].max_velocity + 1e-9


def test_a_target_is_reached_and_held(arm):
    target = Pose(tuple(arm.tip_m + np.array([0.0, 0.05, -0.05])))
    arm.steer(TipTarget(target), 2.0)
    assert arm.tip_m == pytest.approx(target.position_m, abs=0.001)
    assert np.linalg.norm(speeds(arm)[-1]) < 0.002


def question(command, **changes):
    settings = {
        "group": "arm",
        "link": TIP,
        "positions_rad": dict.fromkeys(
            ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"), 0.0
        ),
        "velocity_rad_s": {},
        "period_s": PERIOD_S,
        "command": command,
    }
    return ServoQuestion(**settings | changes)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"group": "legs"}, MoveItErrorCode.INVALID_GROUP_NAME),
        ({"group": "gripper"}, MoveItErrorCode.INVALID_GROUP_NAME),
        ({"link": "toe"}, MoveItErrorCode.INVALID_LINK_NAME),
        ({"positions_rad": {}}, MoveItErrorCode.START_STATE_INVALID),
        ({"period_s": 0.0}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS),
    ],
)
def test_bad_questions_are_refused(planner, changes, code):
    answer = planner.answer(question(TipTwist((0.1, 0.0, 0.0)), **changes))
    assert isinstance(answer, PlanningFailure)
    assert answer.code is code


def test_a_distance_that_is_not_to_be_kept_holds_nothing_back(planner, robot, table):
    arm = SteeredArm(planner, robot, limits=ServoLimits(self_distance_m=None, scene_distance_m=None))
    arm.steer(TipTwist((0.0, 0.0, -0.2)), 1.4)
    assert not {ServoStatus.HALT_FOR_COLLISION, ServoStatus.DECELERATE_FOR_COLLISION} & {
        answer.status for answer in arm.answers
    }
