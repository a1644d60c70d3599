from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from planners.servo.question import JointVelocities, TipTarget, TipTwist
from protocol.messages import Stamp, complete
from protocol.registry import Registry
from server.moveit.servo.parameters import ServoParameters
from server.moveit.servo.servo_loop import (
    FramedTwist,
    in_root_link,
    read_joint_jog,
    read_pose_target,
    read_twist,
    rest_of,
)

REGISTRY = Registry.load()
UNITLESS = ServoParameters(linear_scale=0.2, rotational_scale=0.8, joint_scale=0.5)
SPEEDS = ServoParameters(command_in_type="speed_units")
JOINTS = ("shoulder_pan", "elbow_flex")

# Turned a quarter about z: its x is the root link's y.
QUARTER = Pose((0.1, 0.0, 0.0), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))


def resolve(frame_id: str, _positions: object) -> Pose | PlanningFailure:
    frames = {"": Pose(), "tool": QUARTER}
    return frames.get(frame_id) or PlanningFailure(MoveItErrorCode.FRAME_TRANSFORM_FAILURE, f"no frame {frame_id!r}")


def message(type_name: str, values: dict[str, Any]) -> Any:
    return complete(REGISTRY, type_name, values, Stamp(0, 0))


def twist(linear: dict[str, float], frame_id: str = "", angular: dict[str, float] | None = None) -> Any:
    values = {"header": {"frame_id": frame_id}, "twist": {"linear": linear, "angular": angular or {}}}
    return message("geometry_msgs/TwistStamped", values)


def jog(names: list[str], velocities: list[float], **more: Any) -> Any:
    return message("control_msgs/JointJog", {"joint_names": names, "velocities": velocities, **more})


def test_shares_of_a_stick_become_speeds() -> None:
    read = read_twist(twist({"x": 0.5}, angular={"z": -1.0}), UNITLESS)
    assert isinstance(read, FramedTwist)
    assert read.linear_m_s == pytest.approx((0.1, 0.0, 0.0))
    assert read.angular_rad_s == pytest.approx((0.0, 0.0, -0.8))
    assert read_joint_jog(jog(["elbow_flex"], [0.5]), JOINTS, UNITLESS) == JointVelocities({"elbow_flex": 0.25})


def test_speeds_in_si_units_are_taken_as_they_are() -> None:
    read = read_twist(twist({"x": 1.5}), SPEEDS)
    assert isinstance(read, FramedTwist)
    assert read.linear_m_s == (1.5, 0.0, 0.0)


def test_a_twist_turns_with_its_frame() -> None:
    command = in_root_link(FramedTwist((0.1, 0.0, 0.0), (0.0, 0.2, 0.0), "tool"), resolve, {})
    assert isinstance(command, TipTwist)
    assert command.linear_m_s == pytest.approx((0.0, 0.1, 0.0))
    assert command.angular_rad_s == pytest.approx((-0.2, 0.0, 0.0))


def test_a_target_in_a_frame_is_one_in_the_root_link() -> None:
    values = {"header": {"frame_id": "tool"}, "pose": {"position": {"x": 0.2}}}
    read = read_pose_target(message("geometry_msgs/PoseStamped", values), resolve, {})
    assert isinstance(read, TipTarget)
    assert read.pose.position_m == pytest.approx((0.1, 0.2, 0.0))
    assert np.linalg.norm(read.pose.orientation) == pytest.approx(1.0)


def test_an_unknown_frame_is_refused_by_name() -> None:
    values = {"header": {"frame_id": "nowhere"}}
    for refused in (
        in_root_link(FramedTwist((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), "nowhere"), resolve, {}),
        read_pose_target(message("geometry_msgs/PoseStamped", values), resolve, {}),
    ):
        assert isinstance(refused, PlanningFailure)
        assert "'nowhere'" in refused.message


@pytest.mark.parametrize(
    ("read", "said"),
    [
        (read_twist(twist({"y": 1.5}), UNITLESS), "twist.linear.y must be -1 to 1"),
        (read_twist(twist({}, angular={"x": math.nan}), UNITLESS), "twist.angular.x must be a finite number, not nan"),
        (read_twist(twist({"z": math.inf}), SPEEDS), "twist.linear.z"),
        (read_joint_jog(jog(["elbow_flex"], []), JOINTS, UNITLESS), "0 values for 1 joint_names"),
        (read_joint_jog(jog([], []), JOINTS, UNITLESS), "0 values for 0 joint_names"),
        (
            read_joint_jog(jog(["elbow_flex"], [], displacements=[0.1]), JOINTS, UNITLESS),
            "displacements are not followed",
        ),
        (read_joint_jog(jog(["gripper"], [0.1]), JOINTS, UNITLESS), "'gripper'"),
        (read_joint_jog(jog(["elbow_flex"] * 2, [0.1, 0.2]), JOINTS, UNITLESS), "twice"),
        (read_joint_jog(jog(["elbow_flex"], [math.nan]), JOINTS, UNITLESS), "velocities of elbow_flex"),
    ],
)
def test_what_means_nothing_is_refused_with_field_and_value(read: object, said: str) -> None:
    assert isinstance(read, PlanningFailure)
    assert said in read.message


def test_what_is_wanted_no_more_is_rest() -> None:
    for command in (TipTwist((0.1, 0.0, 0.0)), JointVelocities({"elbow_flex": 0.1}), TipTarget(Pose())):
        assert rest_of(command).zero
    # A twist's rest keeps what it did not move.
    assert isinstance(rest_of(TipTwist((0.1, 0.0, 0.0))), TipTwist)
