import math
from collections.abc import Mapping
from typing import Any

import pytest

from planners.goals import PoseGoal
from planners.problem import MoveItErrorCode
from planners.scene import Pose
from robot.description import model
from server.execution.motions import PlannedMotion
from server.moveit.goals.goal_topics import GoalTranslator, suggestion
from tests.helpers.fake_arm import HOME, FakeArm
from tests.helpers.moveit import FORWARD, ROBOT, TIP, TRANSLATOR, assert_refused, message, rejection, translator
from tests.helpers.robots import LIFTED_SRDF, LIFTED_URDF

INVALID = MoveItErrorCode.INVALID_GOAL_CONSTRAINTS


def pose_stamped(frame: str, orientation: dict[str, float] | None = None, **position: float) -> dict[str, Any]:
    pose = {"position": position, "orientation": orientation or {}}
    return message("geometry_msgs/PoseStamped", header={"frame_id": frame}, pose=pose)


def goal(motion: PlannedMotion, start_rad: Mapping[str, float] = HOME) -> Any:
    """Return the goal of the problem that is planned when its turn comes."""
    problem: Any = motion.steps[0](start_rad)
    return problem.goal


@pytest.mark.parametrize("name", ["", "redy", "home2"])
def test_an_unknown_named_target_is_rejected_with_those_that_exist(name: str) -> None:
    failure = assert_refused(rejection(TRANSLATOR.named, {"data": name}), INVALID, repr(name))
    assert failure.details["known"] == ["Mine", "extended", "home", "ready", "rest"]


def test_an_invalid_joint_goal_is_rejected_with_the_reason() -> None:
    for name, position, words in (
        (["elbow_flex"], [], "1 entries and position 0"),
        (["knee"], [0.1], "no joint of group arm is named, only 'knee'; the group has shoulder_pan"),
        ([], [], "no joint of group arm"),
        (["elbow_flex", "elbow_flex"], [0.1, 0.2], "elbow_flex is named more than once"),
        (["elbow_flex"], [math.nan], "elbow_flex: position must be a finite number, not nan"),
        (["elbow_flex"], [math.inf], "elbow_flex: position must be a finite number, not inf"),
    ):
        state = message("sensor_msgs/JointState", name=name, position=position)
        assert_refused(rejection(TRANSLATOR.joints, state), INVALID, words)


def test_a_frame_is_resolved_when_the_goals_turn_comes() -> None:
    asked = TRANSLATOR.pose(pose_stamped("gripper_frame_link"))
    turned_rad = {**HOME, "shoulder_pan": 1.0}
    assert goal(asked, turned_rad).position_m == pytest.approx(FORWARD.transforms(turned_rad)[TIP][:3, 3])
    # One that nobody knows is rejected at once where the arm's position is known.
    failure = rejection(TRANSLATOR.pose, pose_stamped("moon", x=0.3))
    assert_refused(failure, MoveItErrorCode.FRAME_TRANSFORM_FAILURE, "moon", "base_link")
    later = translator(FakeArm(None)).pose(pose_stamped("moon", x=0.3))
    assert "moon" in rejection(goal, later).message


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_coordinate_that_is_not_finite_is_named(axis: str) -> None:
    assert_refused(rejection(TRANSLATOR.pose, pose_stamped("", **{axis: math.nan})), INVALID, f"position.{axis}")


def test_a_point_that_a_plan_has_verified_is_suggested_in_the_planning_frame_with_the_orientation_of_the_goal() -> None:
    found: Any = suggestion({}, {"free_m": [0.1, 0.2, 0.3]}, ROBOT)
    assert found.topic == "/moveit_goal_pose"
    assert found.msg["header"]["frame_id"] == ROBOT.root_link
    assert found.msg["pose"]["position"] == {"x": 0.1, "y": 0.2, "z": 0.3}
    assert "(0.100, 0.200, 0.300) m" in found.words
    for free_m, repeated in (([0.1002, 0.2, 0.3], False), ([0.1, 0.2, 0.25], True)):
        told: Any = suggestion({}, {"free_m": free_m, "nearest_m": [0.1, 0.2, 0.3], "distance_m": 0.5}, ROBOT)
        assert told.msg["pose"]["position"]["z"] == free_m[2]
        assert (told.words != "that point") is repeated
    told = suggestion(pose_stamped("base", TURNED, x=2.0), {"free_m": [0.5, 0.0, 0.4]}, LIFTED)
    assert told.msg["pose"]["orientation"] == TURNED
    assert suggestion(pose_stamped("tool", TURNED, x=2.0), {"free_m": [0.5, 0.0, 0.4]}, LIFTED) is None
    for unverified in ({"nearest_m": [0.1, 0.2, 0.3]}, {"joint": "elbow_flex", "lower_rad": -1.0, "upper_rad": 1.0}):
        assert suggestion({"name": ["elbow_flex"], "position": [9.0]}, unverified, ROBOT) is None


LIFTED = model.parse(LIFTED_URDF, LIFTED_SRDF)
LIFTED_HOME = {joint.name: 0.0 for joint in LIFTED.movable_joints}
TURNED = {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}


@pytest.fixture
def lifted() -> GoalTranslator:
    """The reader of an arm that is not read: frames are resolved at a goal's turn."""
    return translator(FakeArm(None), LIFTED)


def test_seven_joints_are_brought_to_the_whole_pose_and_need_an_orientation(lifted: GoalTranslator) -> None:
    asked = goal(lifted.pose(pose_stamped("base", TURNED, x=0.4, z=0.9)), LIFTED_HOME)
    assert asked == PoseGoal("tool", Pose((0.4, 0.0, 0.9), (0.0, 0.0, 1.0, 0.0)), 0.01, (0.01,) * 3, strict=True)
    for orientation in (dict.fromkeys("xyzw", 0.0), {**TURNED, "w": 1.0}):
        failure = rejection(lifted.pose, pose_stamped("base", orientation, x=0.4))
        assert_refused(failure, INVALID, "pose.orientation must be a unit quaternion", "group arm has 7 joints")


def test_a_goal_is_of_the_group_that_its_joints_name_or_of_the_selected_one(lifted: GoalTranslator) -> None:
    for names, group in (
        (["a1", "a7"], "arm"),
        (["lift", "a1"], "arm_with_torso"),
        (["left_finger_joint"], "gripper"),
        # No group has them all.
        (["a1", "left_finger_joint"], "arm"),
    ):
        motion = lifted.joints(message("sensor_msgs/JointState", name=names, position=[0.01] * len(names)))
        assert motion.steps[0](LIFTED_HOME).group == group, names
    for group, named in (("arm", "bent"), ("arm_with_torso", "raised")):
        lifted.select_group(group)
        for motion in (lifted.named({"data": named}), lifted.pose(pose_stamped("base", TURNED, x=0.4, z=0.9))):
            assert motion.steps[0](LIFTED_HOME).group == group
    lifted.select_group("arm")
    assert_refused(rejection(lifted.named, {"data": "raised"}), INVALID, "there is no named target 'raised'")
