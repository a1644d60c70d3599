import math

import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.broadphase import NearPair
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Box, Pose
from planners.servo.question import (
    Anchor,
    JointVelocities,
    ServoLimits,
    ServoQuestion,
    ServoStatus,
    TipTarget,
    TipTwist,
)
from planners.servo.steering import (
    GAIN_PER_S,
    HELD_DRIFT_M,
    MAX_DRIFT_M,
    MAX_DRIFT_RAD,
    Outcome,
    VelocityBounds,
    check_servo_question,
    regularized,
    relaxed_anchor,
    servo_answer,
    target_motion,
    twist_motion,
)
from tests.planners.invariants import refusal
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


def refused(robot, command, velocity_rad_s=None):
    at_home = {joint.name: 0.0 for joint in robot.movable_joints}
    return refusal(
        check_servo_question, robot, ServoQuestion("arm", TIP, at_home, velocity_rad_s or {}, PERIOD_S, command)
    )


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (TipTwist((math.nan, 0.0, 0.0)), "nan"),
        (TipTwist(angular_rad_s=(0.0, math.inf, 0.0)), "inf"),
        (JointVelocities({"gripper": 0.1}), "'gripper'"),
        (JointVelocities({"elbow_flex": math.nan}), "nan"),
        (TipTarget(Pose((math.nan, 0.0, 0.0))), "nan"),
        (TipTarget(Pose(orientation=(0.0, 0.0, 0.0, 0.5))), "length 0.5, not 1"),
    ],
)
def test_commands_that_mean_nothing_are_refused_with_what_is_wrong(robot, command, said):
    assert said in refused(robot, command).message


def test_sound_commands_are_accepted_after_velocities_that_are_numbers(robot):
    for command in (TipTwist(), JointVelocities({"elbow_flex": 0.1}), TipTarget(Pose((0.2, 0.0, 0.2)))):
        assert refused(robot, command) is None
        assert "nan" in refused(robot, command, {"elbow_flex": math.nan}).message


ORIGIN = Anchor(Pose())


def tip(position_m=(0.0, 0.0, 0.0), turn_rad=(0.0, 0.0, 0.0)):
    return pin.SE3(pin.exp3(np.array(turn_rad)), np.array(position_m))


def test_drift_along_the_motion_is_left_and_drift_across_is_corrected():
    desired = twist_motion(TipTwist((0.1, 0.0, 0.0)), tip((0.005, 0.004, 0.0)), ORIGIN)
    assert desired.linear_m_s == pytest.approx([0.1, -0.004 * GAIN_PER_S, 0.0])
    assert desired.anchor.pose.position_m == pytest.approx((0.005, 0.0, 0.0))


def test_an_anchor_that_cannot_be_kept_comes_along():
    desired = twist_motion(TipTwist((0.1, 0.0, 0.0)), tip((0.0, 0.5, 0.0), (1.0, 0.0, 0.0)), ORIGIN)
    assert 0.5 - desired.anchor.pose.position_m[1] == pytest.approx(MAX_DRIFT_M)
    assert desired.drift_rad == pytest.approx(MAX_DRIFT_RAD)


def test_a_target_far_away_is_approached_at_the_greatest_speed_and_one_near_slower():
    limits = ServoLimits(linear_m_s=0.2, angular_rad_s=0.8)
    far = target_motion(TipTarget(Pose((1.0, 0.0, 0.0))), tip(turn_rad=(2.0, 0.0, 0.0)), limits)
    assert far.linear_m_s == pytest.approx([0.2, 0.0, 0.0])
    assert np.linalg.norm(far.angular_rad_s) == pytest.approx(0.8)
    near = target_motion(TipTarget(Pose((0.01, 0.0, 0.0))), tip(), limits)
    assert near.linear_m_s == pytest.approx([0.01 * GAIN_PER_S, 0.0, 0.0])


def test_a_tip_that_is_held_back_is_hardly_pulled_and_not_turned():
    anchor = Anchor(Pose((0.1, 0.0, 0.0)), along=(0.0, 0.0, 1.0))
    found = relaxed_anchor(anchor, tip(turn_rad=(0.3, 0.0, 0.0)))
    assert found.pose.position_m == pytest.approx((HELD_DRIFT_M, 0.0, 0.0))
    assert found.along == anchor.along
    assert twist_motion(TipTwist(), tip(turn_rad=(0.3, 0.0, 0.0)), found).drift_rad == pytest.approx(0.0, abs=1e-9)


NAMES = ("a", "b")
TABLE = NearPair("hand", "table", True, 0.012, np.zeros(2))
AROUND = VelocityBounds(np.zeros((5, 2)), np.zeros(5), [TABLE])
NONE, LIMIT_OF_B, NEAR_TABLE = np.array([], dtype=int), np.array([3]), np.array([4])


def told(active=NONE, achieved=(0.1, 0.0, 0.0), angular=(0.0, 0.0, 0.0), **more):
    question = ServoQuestion("arm", "tip", {}, {}, 0.02, TipTwist((0.1, 0.0, 0.0), angular))
    outcome = Outcome(np.array([0.3, 0.4]), active, np.array([0.1, 0.0, 0.0]), np.array(achieved), **more)
    return servo_answer(question, NAMES, outcome, AROUND)


def test_a_command_followed_in_full_has_no_warning_and_motion_against_it_counts_as_none():
    assert told(achieved=(-0.1, 0.0, 0.0)).share == 0.0
    answer = told()
    assert (answer.status, answer.message, answer.share) == (ServoStatus.NO_WARNING, "", pytest.approx(1.0))
    assert answer.velocity_rad_s == {"a": 0.3, "b": 0.4}


def test_of_several_the_gravest_is_the_status_and_all_are_told():
    both = np.union1d(LIMIT_OF_B, NEAR_TABLE)
    answer = told(both, (0.0, 0.0, 0.0), singularity=ServoStatus.HALT_FOR_SINGULARITY)
    assert answer.status is ServoStatus.HALT_FOR_COLLISION
    assert all(word in answer.message for word in ("limit", "singularity", "table"))


LIMITS = ServoLimits(singularity_slow=10.0, singularity_stop=20.0)
FASTEST = np.array([2.0, 2.0, 2.0])
UPPER_M, LOWER_M = 0.12, 0.13


def leg(q):
    """A leg that turns about z, and bends in its plane: stretched at q[2] = 0. Its tip and the tip's Jacobian."""
    turn, lift, bend = q
    reach = UPPER_M * np.cos(lift) + LOWER_M * np.cos(lift + bend)
    height = UPPER_M * np.sin(lift) + LOWER_M * np.sin(lift + bend)
    out, side = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    by_lift = -height * out + reach * up
    by_bend = LOWER_M * (-np.sin(lift + bend) * out + np.cos(lift + bend) * up)
    return reach * out + height * up, np.column_stack((reach * side, by_lift, by_bend))


def ask(bend, desired):
    q = np.array([0.0, 0.0, bend])
    return regularized(leg(q)[1], np.array(desired), LIMITS, FASTEST, lambda step: leg(q + step))


def test_motion_towards_a_singularity_slows_down_until_it_ends():
    slowed, halted = ask(0.3, (0.1, 0.0, 0.0)), ask(0.1, (0.1, 0.0, 0.0))
    assert slowed.status is ServoStatus.DECELERATE_FOR_APPROACHING_SINGULARITY
    assert 0.0 < np.linalg.norm(slowed.linear_m_s) < 0.1
    assert halted.status is ServoStatus.HALT_FOR_SINGULARITY
    assert np.linalg.norm(halted.linear_m_s) < 0.02


def test_out_of_an_exact_singularity_there_is_a_way_back_and_none_further():
    assert ask(0.0, (-0.1, 0.0, 0.0)).status is ServoStatus.DECELERATE_FOR_LEAVING_SINGULARITY
    assert ask(0.0, (0.1, 0.0, 0.0)).status is ServoStatus.HALT_FOR_SINGULARITY


def test_directions_that_are_not_weak_stay_free_at_a_singularity():
    found = ask(0.05, (0.0, 0.1, 0.1))
    assert found.linear_m_s == pytest.approx([0.0, 0.1, 0.1], abs=0.006)


@pytest.mark.parametrize("bend", [0.0, 1e-6, 0.05])
def test_the_followed_share_of_a_command_needs_no_extreme_joint_speed(bend):
    found = ask(bend, (0.1, 0.02, 0.03))
    velocity = np.linalg.pinv(found.jacobian) @ found.linear_m_s
    assert np.abs(velocity).max() < 20.0
