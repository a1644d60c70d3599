import math

import numpy as np
import pinocchio as pin
import pytest

from planners.geometry.broadphase import NearPair
from planners.scene import Pose
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
    relaxed_anchor,
    servo_answer,
    target_motion,
    twist_motion,
)
from tests.planners.refusals import refusal
from tests.planners.servo.steering import PERIOD_S, TIP


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
