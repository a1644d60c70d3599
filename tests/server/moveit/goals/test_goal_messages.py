import math
from collections.abc import Mapping
from typing import Any

import pytest

from planners.goals import JointGoal, PoseGoal
from planners.problem import MoveItErrorCode, PlanningProblem
from planners.scene import Pose
from protocol.messages import Stamp, complete
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from server.errors import RefusedError
from server.execution.motions import PlannedMotion
from server.moveit.goals.goal_messages import GoalTranslator, suggestion
from tests.helpers.fake_arm import HOME, FakeArm
from tests.helpers.moveit import REGISTRY, ROBOT, TRANSLATOR, rejection, translator
from tests.helpers.robots import LIFTED_SRDF, LIFTED_URDF


def joint_state(**fields: Any) -> dict[str, Any]:
    return complete(REGISTRY, "sensor_msgs/JointState", fields, Stamp(0, 0))


def pose_stamped(frame: str, **position: float) -> dict[str, Any]:
    message = {"header": {"frame_id": frame}, "pose": {"position": position}}
    return complete(REGISTRY, "geometry_msgs/PoseStamped", message, Stamp(0, 0))


def goal(motion: PlannedMotion, start_rad: Mapping[str, float] | None = None) -> Any:
    """Return the problem that is planned when the goal's turn comes."""
    problem = motion.steps[0].problem(start_rad or HOME)
    assert isinstance(problem, PlanningProblem)
    return problem.goal


@pytest.mark.parametrize("name", ["ready", "Ready", " READY\n", "re ady"])
def test_a_named_target_is_found_whatever_its_case_and_blanks(name: str) -> None:
    asked = goal(TRANSLATOR.named({"data": name}))
    assert isinstance(asked, JointGoal)
    assert asked.positions_rad["shoulder_lift"] == -0.5


@pytest.mark.parametrize("name", ["", "redy", "home2"])
def test_an_unknown_named_target_is_rejected_with_those_that_exist(name: str) -> None:
    failure = rejection(TRANSLATOR.named, {"data": name})
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert repr(name) in failure.message
    assert failure.details["known"] == ["Mine", "extended", "home", "ready", "rest"]


BAD_JOINTS = {
    "lengths differ": (["elbow_flex"], [], "1 entries and position 0"),
    "nobody known": (["knee"], [0.1], "no joint of group arm"),
    "empty": ([], [], "no joint of group arm"),
    "named twice": (["elbow_flex", "elbow_flex"], [0.1, 0.2], "elbow_flex is named more than once"),
    "not a number": (["elbow_flex"], [math.nan], "elbow_flex: position must be a finite number, not nan"),
    "infinite": (["elbow_flex"], [math.inf], "elbow_flex: position must be a finite number, not inf"),
}


@pytest.mark.parametrize(("name", "position", "words"), BAD_JOINTS.values(), ids=BAD_JOINTS.keys())
def test_an_invalid_joint_goal_is_rejected_with_the_reason(name: list[str], position: list[float], words: str) -> None:
    failure = rejection(TRANSLATOR.joints, joint_state(name=name, position=position))
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert words in failure.message


def test_a_frame_that_moves_is_resolved_when_the_goals_turn_comes() -> None:
    asked = TRANSLATOR.pose(pose_stamped("gripper_frame_link"))
    turned_rad = {**HOME, "shoulder_pan": 1.0}
    placed = ForwardPlacements(ROBOT).transforms(turned_rad)["gripper_frame_link"]
    assert goal(asked, turned_rad).position_m == pytest.approx(placed[:3, 3])


def test_a_pose_in_an_unknown_frame_is_rejected_at_once_with_those_that_exist() -> None:
    failure = rejection(TRANSLATOR.pose, pose_stamped("moon", x=0.3))
    assert failure.code is MoveItErrorCode.FRAME_TRANSFORM_FAILURE
    assert "moon" in failure.message
    assert "base_link" in failure.message


def test_while_the_arms_position_is_unknown_frames_are_resolved_at_the_goals_turn() -> None:
    asked = translator(FakeArm(None)).pose(pose_stamped("moon", x=0.3))
    with pytest.raises(RefusedError, match="moon"):
        asked.steps[0].problem(HOME)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_coordinate_that_is_not_finite_is_named(axis: str) -> None:
    failure = rejection(TRANSLATOR.pose, pose_stamped("", **{axis: math.nan}))
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert f"position.{axis}" in failure.message


def test_a_joint_goal_beyond_limits_is_brought_within_them_in_every_joint() -> None:
    asked = {"name": ["shoulder_pan", "elbow_flex", "knee"], "position": [9.0, 0.2, 1.0]}
    found = suggestion(asked, {"joint": "shoulder_pan", "lower_rad": -1.0, "upper_rad": 1.0}, ROBOT)
    assert found is not None
    assert found.topic == "/moveit_goal_joints"
    assert found.msg == {"name": ["shoulder_pan", "elbow_flex"], "position": [ROBOT.joints["shoulder_pan"].upper, 0.2]}


@pytest.mark.parametrize("key", ["nearest_m", "free_m"])
def test_a_point_is_suggested_in_the_planning_frame(key: str) -> None:
    found = suggestion({}, {key: [0.1, 0.2, 0.3]}, ROBOT)
    assert found is not None
    assert found.topic == "/moveit_goal_pose"
    assert found.msg["header"]["frame_id"] == ROBOT.root_link
    assert found.msg["pose"]["position"] == {"x": 0.1, "y": 0.2, "z": 0.3}
    assert "(0.100, 0.200, 0.300) m" in found.words


LIFTED = model.parse(LIFTED_URDF, LIFTED_SRDF)
# The arm of the other robots is not read: their frames are resolved at a goal's turn.
UNREAD = FakeArm(None)
LIFTED_HOME = {joint.name: 0.0 for joint in LIFTED.movable_joints}
TURNED = {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}


def whole_pose(orientation: dict[str, float], frame: str = "base", **position: float) -> dict[str, Any]:
    message = {"header": {"frame_id": frame}, "pose": {"position": position, "orientation": orientation}}
    return complete(REGISTRY, "geometry_msgs/PoseStamped", message, Stamp(0, 0))


@pytest.fixture
def lifted() -> GoalTranslator:
    return translator(UNREAD, LIFTED)


def test_seven_joints_are_brought_to_the_whole_pose(lifted: GoalTranslator) -> None:
    asked = goal(lifted.pose(whole_pose(TURNED, x=0.4, z=0.9)), LIFTED_HOME)
    assert asked == PoseGoal("tool", Pose((0.4, 0.0, 0.9), (0.0, 0.0, 1.0, 0.0)), 0.01, (0.01,) * 3, strict=True)


NO_ORIENTATIONS = {"zeros": dict.fromkeys("xyzw", 0.0), "too long": {**TURNED, "w": 1.0}}


@pytest.mark.parametrize("orientation", NO_ORIENTATIONS.values(), ids=NO_ORIENTATIONS.keys())
def test_seven_joints_need_an_orientation(lifted: GoalTranslator, orientation: dict[str, float]) -> None:
    failure = rejection(lifted.pose, whole_pose(orientation, x=0.4))
    assert failure.code is MoveItErrorCode.INVALID_GOAL_CONSTRAINTS
    assert "pose.orientation must be a unit quaternion" in failure.message
    assert "group arm has 7 joints" in failure.message


GROUPS_OF_JOINTS = {
    "all of the group": (["a1", "a7"], "arm"),
    "some of a larger one": (["lift", "a1"], "arm_with_torso"),
    "another group": (["left_finger_joint"], "gripper"),
    "no group has them all": (["a1", "left_finger_joint"], "arm"),
}


@pytest.mark.parametrize(("names", "group"), GROUPS_OF_JOINTS.values(), ids=GROUPS_OF_JOINTS.keys())
def test_the_joints_of_a_goal_name_its_group(lifted: GoalTranslator, names: list[str], group: str) -> None:
    motion = lifted.joints(joint_state(name=names, position=[0.01] * len(names)))
    assert motion.steps[0].problem(LIFTED_HOME).group == group


def test_a_suggested_point_keeps_the_orientation_of_the_goal() -> None:
    told = suggestion(whole_pose(TURNED, x=2.0), {"nearest_m": [0.5, 0.0, 0.4]}, LIFTED)
    assert told is not None
    assert told.msg["pose"]["orientation"] == TURNED
    assert suggestion(whole_pose(TURNED, "tool", x=2.0), {"nearest_m": [0.5, 0.0, 0.4]}, LIFTED) is None


@pytest.mark.parametrize(("free_m", "repeated"), [([0.1002, 0.2, 0.3], False), ([0.1, 0.2, 0.25], True)])
def test_a_point_that_the_sentence_names_already_is_not_repeated(free_m: list[float], repeated: bool) -> None:
    told = suggestion({}, {"free_m": free_m, "nearest_m": [0.1, 0.2, 0.3], "distance_m": 0.5}, ROBOT)
    assert told is not None
    assert told.msg["pose"]["position"]["z"] == free_m[2]
    assert (told.words != "that point") is repeated
