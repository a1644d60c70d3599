"""Steering by targets, and by sticks moved at random above a table."""

import math
import time
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.broadphase import NearPair
from planners.geometry.collision import CollisionModel
from planners.pipeline import Planner
from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Box, Pose
from planners.servo import steering
from planners.servo.question import Anchor, JointVelocities, ServoLimits, ServoQuestion, TipTarget, TipTwist
from planners.servo.question import ServoStatus as Status
from robot.description import model
from robot.description.model import RobotModel
from robot.description.robot_folder import built_in
from tests.helpers.resources import in_proportion
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF
from tests.planners.invariants import refusal
from tests.planners.scenes import thing
from tests.planners.servo.steering import PERIOD_S, READY, TIP, SteeredArm, least_distance_m


@pytest.fixture
def arm(planner, robot):
    return SteeredArm(planner, robot)


def speeds(arm):
    return np.diff(np.array(arm.tips_m), axis=0) / PERIOD_S


def test_a_twist_moves_the_tip_in_its_direction_at_its_speed_before_it_turns_and_what_is_given_up_is_told(arm):
    arm.steer(TipTwist((0.0, 0.1, 0.05)), 0.8)
    assert speeds(arm)[-1] == pytest.approx([0.0, 0.1, 0.05], abs=0.003)
    answer = arm.steer(TipTwist((0.0, 0.0, 0.05), (0.0, 0.0, 0.5)), 0.8)
    assert speeds(arm)[-1] == pytest.approx([0.0, 0.0, 0.05], abs=0.003)
    assert "given up" in answer.message


def test_nothing_drifts_that_nobody_moves_and_a_target_is_reached_and_held(arm):
    start = arm.tip_m
    arm.steer(lambda at_s: TipTwist((0.0, 0.1 * np.cos(3 * at_s), 0.1 * np.sin(3 * at_s))), 2.5)
    assert np.abs(np.array(arm.tips_m)[:, 0] - start[0]).max() < 0.0015
    # When commands cease the arm comes to rest.
    arm.steer(TipTwist(), 1.0)
    assert arm.tip_m[0] == pytest.approx(start[0], abs=0.0005)
    assert np.linalg.norm(speeds(arm)[-1]) < 0.002
    target = Pose(tuple(arm.tip_m + np.array([0.0, 0.05, -0.05])))
    arm.steer(TipTarget(target), 2.0)
    assert arm.tip_m == pytest.approx(target.position_m, abs=0.001)
    assert np.linalg.norm(speeds(arm)[-1]) < 0.002


def test_a_turn_that_five_joints_can_do_is_done_about_the_tip(arm):
    start, axes = arm.tip_m, arm.tip_axes
    answer = arm.steer(TipTwist(angular_rad_s=(0.0, 0.5, 0.0)), 0.8)
    turned = pin.log3(arm.tip_axes @ axes.T)
    assert turned[1] > 0.25
    assert np.abs(turned[[0, 2]]).max() < 0.02
    assert np.linalg.norm(arm.tip_m - start) < 0.003
    assert "given up" not in answer.message


def test_towards_the_end_of_its_reach_the_arm_halts_and_comes_back_and_too_fast_a_twist_is_slowed(arm, robot):
    halted = arm.steer(TipTwist((0.2, 0.0, 0.0)), 1.6)
    assert halted.status in (Status.HALT_FOR_SINGULARITY, Status.DECELERATE_FOR_APPROACHING_SINGULARITY)
    assert abs(speeds(arm)[-1][0]) < 0.04
    farthest = arm.tip_m[0]
    arm.steer(TipTwist((-0.2, 0.0, 0.0)), 1.0)
    assert arm.tip_m[0] < farthest - 0.03
    # By as much as the joints can do.
    answer = arm.steer(TipTwist((0.0, 0.0, 2.0)), 0.5)
    assert answer.share < 0.5
    for name, velocity in answer.velocity_rad_s.items():
        assert abs(velocity) <= robot.joints[name].max_velocity + 1e-9


def test_towards_a_table_the_arm_slows_down_keeps_its_distance_moves_along_it_and_gets_away(planner, robot, put):
    put(planner, thing(Box((2.0, 2.0, 0.1)), 0.0, 0.0, -0.05, name="table"))
    arm = SteeredArm(planner, robot)
    halted = arm.steer(TipTwist((0.0, 0.0, -0.2)), 2.4)
    assert halted.status is Status.HALT_FOR_COLLISION
    assert "table" in halted.message
    lowest = arm.tip_m[2]
    arm.steer(TipTwist((0.0, 0.1, -0.1)), 0.6)
    assert speeds(arm)[-1][1] > 0.05
    assert arm.steer(TipTwist((0.0, 0.0, 0.1)), 0.5).status is Status.NO_WARNING
    assert arm.tip_m[2] > lowest + 0.02
    # A distance that is not to be kept holds nothing back.
    arm = SteeredArm(planner, robot, limits=ServoLimits(self_distance_m=None, scene_distance_m=None))
    arm.steer(TipTwist((0.0, 0.0, -0.2)), 1.4)
    held_back = {Status.HALT_FOR_COLLISION, Status.DECELERATE_FOR_COLLISION}
    assert not held_back & {answer.status for answer in arm.answers}


def test_a_joint_at_its_limit_is_told_the_others_go_on_and_those_that_are_not_named_rest(planner, robot):
    arm = SteeredArm(planner, robot, READY | {"wrist_roll": 2.8})
    answer = arm.steer(JointVelocities({"wrist_roll": 1.0, "shoulder_pan": 0.3}), 0.8)
    assert answer.status is Status.JOINT_BOUND
    assert "wrist_roll" in answer.message
    assert answer.velocity_rad_s["shoulder_pan"] == pytest.approx(0.3, rel=1e-4)
    assert arm.positions_rad["wrist_roll"] <= robot.joints["wrist_roll"].upper + 1e-6
    assert np.abs(arm.joints_rad[-1] - arm.joints_rad[0])[1:4].max() == 0.0


def question(at_home, command, **changes):
    asked = {"group": "arm", "link": TIP, "positions_rad": at_home, "velocity_rad_s": {}, "period_s": PERIOD_S}
    return ServoQuestion(command=command, **asked | changes)


def test_bad_questions_and_commands_that_mean_nothing_are_refused_with_what_is_wrong(planner, robot, at_home):
    for changes, code in (
        ({"group": "legs"}, MoveItErrorCode.INVALID_GROUP_NAME),
        ({"group": "gripper"}, MoveItErrorCode.INVALID_GROUP_NAME),
        ({"link": "toe"}, MoveItErrorCode.INVALID_LINK_NAME),
        ({"positions_rad": {}}, MoveItErrorCode.START_STATE_INVALID),
        ({"period_s": 0.0}, MoveItErrorCode.INVALID_GOAL_CONSTRAINTS),
    ):
        answer = planner.answer(question(at_home, TipTwist((0.1, 0.0, 0.0)), **changes))
        assert isinstance(answer, PlanningFailure), changes
        assert answer.code is code

    def refused(command, **changes):
        return refusal(steering.check_servo_question, robot, question(at_home, command, **changes))

    for command, said in (
        (TipTwist((math.nan, 0.0, 0.0)), "nan"),
        (TipTwist(angular_rad_s=(0.0, math.inf, 0.0)), "inf"),
        (JointVelocities({"gripper": 0.1}), "'gripper'"),
        (JointVelocities({"elbow_flex": math.nan}), "nan"),
        (TipTarget(Pose((math.nan, 0.0, 0.0))), "nan"),
        (TipTarget(Pose(orientation=(0.0, 0.0, 0.0, 0.5))), "length 0.5, not 1"),
    ):
        assert said in refused(command).message
    for command in (TipTwist(), JointVelocities({"elbow_flex": 0.1}), TipTarget(Pose((0.2, 0.0, 0.2)))):
        assert refused(command) is None
        assert "nan" in refused(command, velocity_rad_s={"elbow_flex": math.nan}).message


def tip(position_m=(0.0, 0.0, 0.0), turn_rad=(0.0, 0.0, 0.0)):
    return pin.SE3(pin.exp3(np.array(turn_rad)), np.array(position_m))


def test_drift_across_the_motion_is_corrected_and_a_target_far_away_approached_at_the_greatest_speed():
    forwards, origin = TipTwist((0.1, 0.0, 0.0)), Anchor(Pose())
    desired = steering.twist_motion(forwards, tip((0.005, 0.004, 0.0)), origin)
    assert desired.linear_m_s == pytest.approx([0.1, -0.004 * steering.GAIN_PER_S, 0.0])
    assert desired.anchor.pose.position_m == pytest.approx((0.005, 0.0, 0.0))
    # An anchor that cannot be kept comes along.
    desired = steering.twist_motion(forwards, tip((0.0, 0.5, 0.0), (1.0, 0.0, 0.0)), origin)
    assert 0.5 - desired.anchor.pose.position_m[1] == pytest.approx(steering.MAX_DRIFT_M)
    assert desired.drift_rad == pytest.approx(steering.MAX_DRIFT_RAD)
    limits = ServoLimits(linear_m_s=0.2, angular_rad_s=0.8)
    far = steering.target_motion(TipTarget(Pose((1.0, 0.0, 0.0))), tip(turn_rad=(2.0, 0.0, 0.0)), limits)
    assert far.linear_m_s == pytest.approx([0.2, 0.0, 0.0])
    assert np.linalg.norm(far.angular_rad_s) == pytest.approx(0.8)
    near = steering.target_motion(TipTarget(Pose((0.01, 0.0, 0.0))), tip(), limits)
    assert near.linear_m_s == pytest.approx([0.01 * steering.GAIN_PER_S, 0.0, 0.0])


AROUND = steering.VelocityBounds(np.zeros((5, 2)), np.zeros(5), [NearPair("hand", "table", True, 0.012, np.zeros(2))])
LIMIT_OF_B, NEAR_TABLE = 3, 4


def told(*active, achieved=(0.1, 0.0, 0.0), **more):
    question = ServoQuestion("arm", "tip", {}, {}, 0.02, TipTwist((0.1, 0.0, 0.0)))
    wanted, active = np.array([0.1, 0.0, 0.0]), np.array(active, dtype=int)
    outcome = steering.Outcome(np.array([0.3, 0.4]), active, wanted, np.array(achieved), **more)
    return steering.servo_answer(question, ("a", "b"), outcome, AROUND)


def test_a_command_followed_in_full_has_no_warning_and_else_the_gravest_is_the_status_and_all_are_told():
    answer = told()
    assert (answer.status, answer.message, answer.share) == (Status.NO_WARNING, "", pytest.approx(1.0))
    assert answer.velocity_rad_s == {"a": 0.3, "b": 0.4}
    # Motion against the command counts as none.
    assert told(achieved=(-0.1, 0.0, 0.0)).share == 0.0
    answer = told(LIMIT_OF_B, NEAR_TABLE, achieved=(0.0, 0.0, 0.0), singularity=Status.HALT_FOR_SINGULARITY)
    assert answer.status is Status.HALT_FOR_COLLISION
    assert all(word in answer.message for word in ("limit", "singularity", "table"))


LIMITS = ServoLimits(singularity_slow=10.0, singularity_stop=20.0)
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


def ask(bend, *desired):
    q, fastest = np.array([0.0, 0.0, bend]), np.array([2.0, 2.0, 2.0])
    return steering.regularized(leg(q)[1], np.array(desired), LIMITS, fastest, lambda step: leg(q + step))


def test_motion_towards_a_singularity_slows_down_until_it_ends_and_out_of_one_there_is_a_way_back():
    slowed, halted = ask(0.3, 0.1, 0.0, 0.0), ask(0.1, 0.1, 0.0, 0.0)
    assert slowed.status is Status.DECELERATE_FOR_APPROACHING_SINGULARITY
    assert 0.0 < np.linalg.norm(slowed.linear_m_s) < 0.1
    assert halted.status is Status.HALT_FOR_SINGULARITY
    assert np.linalg.norm(halted.linear_m_s) < 0.02
    assert ask(0.0, -0.1, 0.0, 0.0).status is Status.DECELERATE_FOR_LEAVING_SINGULARITY
    assert ask(0.0, 0.1, 0.0, 0.0).status is Status.HALT_FOR_SINGULARITY
    # Directions that are not weak stay free, and no extreme joint speed is needed.
    assert ask(0.05, 0.0, 0.1, 0.1).linear_m_s == pytest.approx([0.0, 0.1, 0.1], abs=0.006)
    for bend in (0.0, 1e-6, 0.05):
        found = ask(bend, 0.1, 0.02, 0.03)
        assert np.abs(np.linalg.pinv(found.jacobian) @ found.linear_m_s).max() < 20.0, bend


STICK_LIMITS = ServoLimits()
HOLD_S, TRIAL_S = 0.4, 3.2

FETCH_RAD = {"shoulder_lift_joint": 0.3, "elbow_flex_joint": 0.8, "wrist_flex_joint": 0.6, "torso_lift_joint": 0.2}
# An arm with its tip, where it starts [rad], how high the table is [m], and seeds of sticks.
OTHERS = {
    # Its joints speed up twice as fast as the SO-101's. If acceleration took 0.06 s to its limit, these seeds would
    # drive it into the table.
    "koch": (built_in("koch_v1_1").model, "gripper_frame_link", {}, -0.01, (4, 37)),
    "seven": (model.parse(SEVEN_JOINT_URDF, SEVEN_JOINT_SRDF), "tool", {"a2": 0.5, "a4": 1.2, "a6": 0.8}, 0.0, (4,)),
    "fetch": (built_in("fetch").model, "gripper_link", FETCH_RAD, 0.12, (4,)),
}


@pytest.fixture
def table_below(planner: Planner, changing: CollisionModel, put) -> CollisionModel:
    for part in (planner, changing):
        put(part, thing(Box((1.0, 1.0, 0.04)), 0.3, 0.0, -0.03))
    return changing


def stick(turns: np.ndarray, ways: np.ndarray):
    """A stick that is held for a while, then moved to another place, shape (places, 3) each."""

    def command(at_s: float) -> TipTwist:
        number = round(at_s / HOLD_S - 0.5) % len(turns)
        linear, angular = ways[number] * STICK_LIMITS.linear_m_s, turns[number] * STICK_LIMITS.angular_rad_s
        return TipTwist(tuple(linear.tolist()), tuple(angular.tolist()))

    return command


def random_stick(seed: int):
    """A stick that points downwards, more or less, and turns at random."""
    turns, ways = np.random.default_rng(seed).normal(size=(2, round(TRIAL_S / HOLD_S), 3))
    turns, ways = (drawn / np.linalg.norm(drawn, axis=1, keepdims=True) for drawn in (turns, ways))
    ways[:, 2] = -np.abs(ways[:, 2])
    return stick(turns, ways)


REVERSED = stick(np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]), np.array([[0.0, 0.0, -1.0]] * 2))


@pytest.mark.parametrize("seed", [None, *range(in_proportion(4))])
def test_random_sticks_and_a_turn_that_is_reversed_on_the_way_down_keep_the_distance(planner, robot, table_below, seed):
    arm = SteeredArm(planner, robot)
    arm.steer(REVERSED if seed is None else random_stick(seed), TRIAL_S)
    assert least_distance_m(arm, table_below) > STICK_LIMITS.scene_distance_m


@pytest.mark.parametrize("name", OTHERS)
def test_random_sticks_keep_the_distance_on_other_arms(name: str, put) -> None:
    robot, tip, start_rad, table_m, seeds = OTHERS[name]
    planner, collision = Planner(robot, time.process_time), CollisionModel(robot)
    for part in (planner, collision):
        put(part, thing(Box((2.0, 2.0, 0.04)), 0.5, 0.0, table_m - 0.02))
    for seed in seeds:
        arm = SteeredArm(planner, robot, start_rad, tip=tip)
        arm.steer(random_stick(seed), TRIAL_S)
        assert least_distance_m(arm, collision) > STICK_LIMITS.scene_distance_m, seed


START = {"shoulder_pan": 1.5, "shoulder_lift": 0.6, "elbow_flex": -0.6}


def with_brakes(robot: RobotModel, acceleration_rad_s2: float) -> RobotModel:
    """The robot with another acceleration limit of all joints, at least as fast as the SO-101's servos."""
    joints = {
        name: replace(joint, max_velocity=2.5, max_acceleration=acceleration_rad_s2) if joint.max_velocity else joint
        for name, joint in robot.joints.items()
    }
    # With its hulls alone it is loaded in no time.
    return replace(robot, joints=joints, parts={}, surfaces={})


@pytest.mark.parametrize(("acceleration_rad_s2", "period_s"), [(1.0, 0.06), (6.0, 0.02)])
def test_a_fast_joint_stops_before_a_wall(robot: RobotModel, put, acceleration_rad_s2: float, period_s: float) -> None:
    robot = with_brakes(robot, acceleration_rad_s2)
    planner, collision = Planner(robot, time.process_time), CollisionModel(robot)
    for part in (planner, collision):
        put(part, thing(Box((1.0, 0.02, 1.0)), 0.0, 0.26, 0.3))
    arm = SteeredArm(planner, robot, START, period_s=period_s)
    answer = arm.steer(JointVelocities({"shoulder_pan": -2.5}), 4.0)
    assert STICK_LIMITS.scene_distance_m < least_distance_m(arm, collision) < 0.05
    assert "near each other" in answer.message
