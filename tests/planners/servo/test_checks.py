import math

import pytest

from planners.scene import Pose
from planners.servo.checks import check_servo_question
from planners.servo.question import JointVelocities, ServoQuestion, TipTarget, TipTwist
from tests.helpers.steering import PERIOD_S, TIP


def refusal(robot, command, velocity_rad_s=None):
    at_home = {joint.name: 0.0 for joint in robot.movable_joints}
    return check_servo_question(robot, ServoQuestion("arm", TIP, at_home, velocity_rad_s or {}, PERIOD_S, command))


@pytest.mark.parametrize(
    "command", [TipTwist((0.1, 0.0, 0.0)), JointVelocities({"elbow_flex": 0.1}), TipTarget(Pose((0.2, 0.0, 0.2)))]
)
def test_sound_commands_are_accepted(robot, command):
    assert refusal(robot, command) is None


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (TipTwist((math.nan, 0.0, 0.0)), "nan"),
        (TipTwist(angular_rad_s=(0.0, math.inf, 0.0)), "inf"),
        (JointVelocities({"gripper": 0.1}), "'gripper'"),
        (JointVelocities({"elbow_flex": math.nan}), "nan"),
        (TipTarget(Pose((math.nan, 0.0, 0.0))), "nan"),
        (TipTarget(Pose(orientation=(0.0, 0.0, 0.0, 0.5))), "unit quaternion"),
    ],
)
def test_commands_that_mean_nothing_are_refused_with_what_is_wrong(robot, command, said):
    assert said in refusal(robot, command).message


def test_velocities_until_now_must_be_numbers(robot):
    assert "nan" in refusal(robot, TipTwist(), {"elbow_flex": math.nan}).message
