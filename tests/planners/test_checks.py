"""Checks of problems and scenes before anything is planned."""

import math
from dataclasses import replace

import numpy as np
import pytest

from planners import checks, goals
from planners.checks import START_CONTACT_DEPTH_M, START_LIMIT_TOLERANCE_RAD
from planners.geometry.collision import CollidingPair
from planners.goals import AnyOf, ConstraintGoal, Constraints, JointGoal
from planners.ik.kinematics import MAX_POINTS
from planners.problem import IkQuestion, MoveItErrorCode, PlanningProblem, StateQuestion
from planners.scene import AttachedObject, Box, Cone, Cylinder, Mesh, Plane, Pose, SceneObject, Sphere
from planners.scene_checks import MAX_SCENE_TRIANGLES, MAX_SHAPES, MAX_TRIANGLES, check_scene, check_whole
from tests.planners.invariants import refusal
from tests.planners.scenes import CORNERS_M, FACES, scene

LINKS = ("base_link", "gripper_link")
CUBE = Box((0.1, 0.1, 0.1))
ORIGIN = Pose()
NAN, INF = math.nan, math.inf


def thing(shape=CUBE, name="thing", pose=ORIGIN, at=ORIGIN):
    return SceneObject(name, ((shape, at),), pose)


BAD_SHAPES = (
    *(Box((0.1, 0.1, 0.0)), Box((0.1, -0.1, 0.1)), Box((0.1, NAN, 0.1)), Box((0.1, 0.1, INF))),
    # A point, a sphere as large as a town, and so on.
    *(Sphere(0.0), Sphere(1000.0), Cylinder(0.1, 0.0), Cone(NAN, 0.1)),
    *(Plane((0.0, 0.0, 0.0), 0.0), Plane((0.0, 0.0, NAN), 0.0), Plane((0.0, 0.0, 1.0), INF)),
    # No triangles, or too many; vertices that are absent; lines for triangles, and other shapes of the arrays.
    *(Mesh(CORNERS_M, FACES[:0]), Mesh(CORNERS_M, np.tile(FACES, (MAX_TRIANGLES // 4 + 1, 1)))),
    *(Mesh(CORNERS_M * NAN, FACES), Mesh(CORNERS_M, FACES + 1), Mesh(CORNERS_M, FACES - 1)),
    *(Mesh(CORNERS_M, np.zeros_like(FACES)), Mesh(CORNERS_M, FACES[:, :2]), Mesh(CORNERS_M[:, :2], FACES)),
)


def test_a_bad_shape_or_pose_is_refused_by_the_name_of_its_object():
    bad_poses = Pose((NAN, 0.0, 0.0)), Pose((0.0, 1e6, 0.0)), Pose(orientation=(0.0,) * 4), Pose(orientation=(NAN,) * 4)
    for shape in BAD_SHAPES:
        refusal = check_scene(scene(thing(), thing(shape, "odd one")), LINKS)
        assert refusal.code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, shape
        assert "odd one" in refusal.message
        assert refusal.details["object"] == "odd one"
    for pose in bad_poses:
        for parts in ({"pose": pose}, {"at": pose}):
            assert check_scene(scene(thing(**parts)), LINKS).code == MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, parts


def test_names_that_are_empty_or_taken_and_links_that_the_robot_does_not_have_are_refused():
    for name in ("", "thing", "gripper_link"):
        attached = AttachedObject(thing(name=name), "gripper_link")
        for crowd in (scene(thing(), thing(name=name)), scene(thing(), attached=(attached,))):
            assert check_scene(crowd, LINKS).code == MoveItErrorCode.INVALID_OBJECT_NAME, name
    touching = AttachedObject(thing(), "gripper_link", frozenset({"hand"}))
    for parts in (
        *({"attached": (AttachedObject(thing(), "hand"),)}, {"attached": (touching,)}),
        *({"link_padding_m": {"hand": 0.01}}, {"link_scale": {"hand": 1.1}}),
    ):
        refusal = check_scene(scene(**parts), LINKS)
        assert refusal.code == MoveItErrorCode.INVALID_LINK_NAME
        assert "'hand'" in refusal.message


def test_a_padding_or_scale_that_is_none_and_an_object_without_shapes_are_refused():
    for value in (-0.001, NAN, INF):
        assert check_scene(scene(link_padding_m={"gripper_link": value}), LINKS) is not None
        assert check_scene(scene(link_scale={"gripper_link": value}), LINKS) is not None
    assert check_scene(scene(link_padding_m={"gripper_link": 0.0}), LINKS) is None
    assert check_scene(scene(link_scale={"gripper_link": 0.0}), LINKS) is not None
    assert "no shape" in check_scene(scene(SceneObject("ghost", ())), LINKS).message


def test_more_shapes_or_triangles_in_all_than_the_limit_are_refused_with_both_figures():
    crowd = SceneObject("crowd", ((CUBE, Pose()),) * MAX_SHAPES)
    assert check_scene(scene(crowd), LINKS) is None
    assert check_scene(scene(crowd, thing()), LINKS).details == {"shapes": MAX_SHAPES + 1, "limit": MAX_SHAPES}
    large = Mesh(CORNERS_M, np.tile(FACES, (MAX_TRIANGLES // len(FACES), 1)))
    fits = MAX_SCENE_TRIANGLES // MAX_TRIANGLES
    meshes = [thing(large, str(number)) for number in range(fits + 1)]
    assert check_whole(scene(*meshes[:fits]), LINKS) is None
    refusal = check_whole(scene(*meshes), LINKS)
    assert refusal.details == {"triangles": (fits + 1) * MAX_TRIANGLES, "limit": MAX_SCENE_TRIANGLES}


TIP = "gripper_frame_link"
POINT = goals.PositionGoal(TIP, (0.3, 0.0, 0.2), 0.01)
AXIS = goals.AxisGoal(TIP, (0.3, 0.0, 0.2), 0.01, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.1)
POSE = goals.PoseGoal(TIP, Pose((0.3, 0.0, 0.2)), 0.01, (0.1, 0.1, 0.1))
JOINT_RANGE = goals.JointConstraint("elbow_flex", 0.5, 0.1, 0.1)
REGION = goals.PositionConstraint(TIP, Pose((0.3, 0.0, 0.2)), radius_m=0.1)
ORIENTATION = goals.OrientationConstraint(TIP, (0.0, 0.0, 0.0, 1.0), (0.1, 0.1, 0.1))
NO_RANGE = Constraints(joints=(replace(JOINT_RANGE, joint="elbow"),))
INVALID, INVALID_START = MoveItErrorCode.INVALID_GOAL_CONSTRAINTS, MoveItErrorCode.START_STATE_INVALID
NO_GROUP, NO_LINK = MoveItErrorCode.INVALID_GROUP_NAME, MoveItErrorCode.INVALID_LINK_NAME


@pytest.fixture
def problem(at_home):
    return PlanningProblem("arm", at_home, JointGoal({"elbow_flex": 0.5}))


def refused(robot, problem, **changes):
    return refusal(checks.check_request, robot, replace(problem, **changes))


def assert_refused(failure, code, said):
    assert failure is not None, said
    assert failure.code is code, failure
    assert all(part in failure.message for part in said), failure.message


def test_senseless_requests_are_refused_with_names_and_values_and_sound_ones_pass(robot, problem):
    least, most = ({"attempts": each, "optimization_time_s": time_s} for each, time_s in ((1, 0.0), (1000, 3600.0)))
    for changes in ({}, {"goal": POINT}, least, most):
        assert refused(robot, problem, **changes) is None
    for changes, code, said in (
        ({"group": "leg"}, NO_GROUP, ["leg", "arm", "gripper"]),
        ({"velocity_scaling": 0.0}, INVALID, ["velocity scaling", "0"]),
        ({"velocity_scaling": 1.5}, INVALID, ["velocity scaling", "1.5"]),
        ({"acceleration_scaling": NAN}, INVALID, ["acceleration scaling", "nan"]),
        ({"acceleration_scaling": -0.5}, INVALID, ["acceleration scaling", "-0.5"]),
        ({"allowed_time_s": -1.0}, INVALID, ["allowed planning time", "-1"]),
        ({"allowed_time_s": math.inf}, INVALID, ["allowed planning time", "inf"]),
        ({"optimization_time_s": -1.0}, INVALID, ["optimization time", "-1"]),
        ({"optimization_time_s": NAN}, INVALID, ["optimization time", "nan"]),
        ({"optimization_time_s": 3600.5}, INVALID, ["optimization time", "0 to 3600", "3600.5"]),
        ({"attempts": 0}, INVALID, ["attempts", "0"]),
        ({"attempts": 1001}, INVALID, ["attempts", "1 to 1000", "1001"]),
        ({"planner_id": "AORRTC"}, INVALID, ["'AORRTC'", "RRTConnect"]),
        ({"start_velocity_rad_s": {"elbow": 0.1}}, INVALID_START, ["'elbow'", "'arm'"]),
        ({"start_velocity_rad_s": {"elbow_flex": NAN}}, INVALID_START, ["elbow_flex", "nan"]),
        ({"start_velocity_rad_s": {"elbow_flex": -99.0}}, INVALID_START, ["-99 rad/s", "limit"]),
        ({"goal": JointGoal({"elbow_flex": NAN})}, INVALID, ["elbow_flex", "nan"]),
        ({"path_constraints": NO_RANGE}, INVALID, ["'elbow'"]),
    ):
        assert_refused(refused(robot, problem, **changes), code, said)


def test_a_start_may_be_a_little_beyond_limits_in_shallow_contact_and_as_fast_as_scaled(robot, at_home, problem):
    lower = robot.joints["wrist_flex"].lower
    within, beyond = (at_home | {"wrist_flex": lower - share * START_LIMIT_TOLERANCE_RAD} for share in (0.9, 1.1))
    assert refusal(checks.check_start, robot, within) is None
    failure = refusal(checks.check_start, robot, beyond)
    assert_refused(failure, INVALID_START, ["'wrist_flex'"])
    assert failure.details["lower_rad"] == lower
    without = {name: position for name, position in at_home.items() if name != "gripper"}
    for start_rad in (without, at_home | {"gripper": NAN}, at_home | {"gripper": math.inf}):
        failure = refusal(checks.check_start, robot, start_rad)
        assert_refused(failure, INVALID_START, ["'gripper'"])
        assert "limits" not in failure.message
    shallow = CollidingPair("base_link", "wrist_link", 0.9 * START_CONTACT_DEPTH_M)
    deep = CollidingPair("shoulder_link", "wrist_link", 1.1 * START_CONTACT_DEPTH_M)
    assert refusal(checks.check_start_contact, []) is None
    assert refusal(checks.check_start_contact, [shallow]) is None
    failure = refusal(checks.check_start_contact, [shallow, deep])
    words = ["shoulder_link and wrist_link by 11.0 mm"]
    assert_refused(failure, MoveItErrorCode.START_STATE_IN_COLLISION, words)
    assert len(failure.details["pairs"]) == 2
    assert len(refusal(checks.check_start_contact, [deep] * 101).details["pairs"]) == 100
    limit = robot.joints["elbow_flex"].max_velocity
    half = {"start_velocity_rad_s": {"elbow_flex": -0.5 * limit}}
    assert refused(robot, problem, velocity_scaling=0.5, **half) is None
    assert refused(robot, problem, velocity_scaling=0.4, **half).details["limit_rad_s"] == pytest.approx(0.4 * limit)


def test_senseless_questions_for_configurations_and_about_states_are_refused_and_bad_states_are_not(robot, at_home):
    question = IkQuestion("arm", at_home, POINT)
    assert refusal(checks.check_ik_question, robot, question) is None
    for changes, code in (
        ({"group": "leg"}, NO_GROUP),
        ({"allowed_time_s": 0.0}, INVALID),
        ({"goal": replace(POINT, link="hand")}, NO_LINK),
        ({"constraints": NO_RANGE}, INVALID),
    ):
        assert_refused(refusal(checks.check_ik_question, robot, replace(question, **changes)), code, [])
    question = StateQuestion("arm", at_home | {"elbow_flex": 9.0})
    assert refusal(checks.check_state_question, robot, question) is None
    for changes in ({"group": "leg"}, {"positions_rad": {}}, {"constraints": NO_RANGE}):
        assert refusal(checks.check_state_question, robot, replace(question, **changes)) is not None


def joint_range(**changes):
    return Constraints(joints=(replace(JOINT_RANGE, **changes),))


def region(**changes):
    return Constraints(positions=(replace(REGION, **changes),))


def orientation(**changes):
    return Constraints(orientations=(replace(ORIENTATION, **changes),))


def test_senseless_goals_and_unknown_links_are_refused_with_names_and_values(robot, arm):
    for goal, said in (
        (JointGoal({"elbow": 0.5}), ["'elbow'", "elbow_flex"]),
        (JointGoal({"gripper": 0.5}), ["'gripper'", "'arm'"]),
        (JointGoal({"": 0.5}), ["''"]),
        (JointGoal({"elbow_flex": NAN}), ["elbow_flex", "nan"]),
        (JointGoal({"elbow_flex": 1.7}), ["elbow_flex", "1.7 rad", "-1.69 to 1.69 rad"]),
        (JointGoal({"elbow_flex": 0.5}, tolerance_rad=-0.1), ["joint tolerance", "-0.1"]),
        (replace(POINT, position_m=(0, NAN, 0)), ["(0, nan, 0)"]),
        (replace(POINT, offset_m=(0, math.inf, 0)), ["offset", "inf"]),
        (replace(POINT, tolerance_m=0.0), ["tolerance", "not 0"]),
        (replace(POINT, tolerance_m=NAN), ["tolerance", "nan"]),
        (replace(AXIS, axis=(0.0, 0.0, 0.0)), ["axis", "length 0"]),
        (replace(AXIS, direction=(0.0, 0.0, 2.0)), ["direction", "length 2"]),
        (replace(AXIS, axis_tolerance_rad=-0.1), ["axis tolerance", "-0.1"]),
        (replace(POSE, pose=Pose((0.3, 0, 0.2), (0.0, 0.0, 0.0, 0.0))), ["orientation", "length 0"]),
        (replace(POSE, pose=Pose((0.3, 0, 0.2), (NAN, 0.0, 0.0, 1.0))), ["orientation", "nan"]),
        (replace(POSE, position_tolerance_m=-1.0), ["position tolerance", "-1"]),
        (replace(POSE, orientation_tolerance_rad=(0.1, -0.1, 0.1)), ["orientation tolerance", "-0.1"]),
        (ConstraintGoal(Constraints()), ["no constraint"]),
        (ConstraintGoal(joint_range(position_rad=NAN)), ["elbow_flex", "nan"]),
        (AnyOf(()), ["1 to 64 alternatives, not 0"]),
        (AnyOf((POINT,) * 65), ["1 to 64 alternatives, not 65"]),
        (AnyOf((POINT, JointGoal({"elbow_flex": NAN}))), ["elbow_flex"]),
    ):
        assert_refused(refusal(checks.check_goal, robot, arm, goal), INVALID, said)
    constrained = ConstraintGoal(region(link="hand")), ConstraintGoal(orientation(link="hand"))
    for goal in (replace(POINT, link="hand"), replace(AXIS, link=""), replace(POSE, link="hand"), *constrained):
        failure = refusal(checks.check_goal, robot, arm, goal)
        assert_refused(failure, NO_LINK, [TIP])
        # A group whose joints are not one chain has no tip.
        assert ("not one chain" in failure.message) == (not failure.details["link"])
    assert refusal(checks.check_goal, robot, arm, AnyOf((POINT,) * 64)) is None
    # A joint may exceed its limit by rounding only.
    joint = robot.joints["elbow_flex"]
    limits = {"lower_rad": joint.lower, "upper_rad": joint.upper}
    for limit, way in ((joint.upper, 1.0), (joint.lower, -1.0)):
        near, far = (JointGoal({"elbow_flex": limit + way * more}, tolerance_rad=0.01) for more in (0.009, 0.011))
        assert refusal(checks.check_goal, robot, arm, near) is None
        failure = refusal(checks.check_goal, robot, arm, far)
        assert failure.details == {"joint": "elbow_flex", "position_rad": limit + way * 0.011, **limits}


def test_senseless_constraints_are_refused_with_names_and_values(robot):
    for constraints, said in (
        (joint_range(joint="elbow"), ["'elbow'", "elbow_flex"]),
        (joint_range(above_rad=-0.1), ["elbow_flex", "-0.1"]),
        (joint_range(below_rad=NAN), ["elbow_flex", "nan"]),
        *((joint_range(position_rad=each), ["elbow_flex", "-1.69 to 1.69"]) for each in (-2.0, 2.0)),
        (joint_range(weight=-1.0), ["weight", "-1"]),
        (Constraints(joints=(JOINT_RANGE, replace(JOINT_RANGE, position_rad=1.0))), ["no position"]),
        (region(radius_m=None), ["either a box or a sphere"]),
        (region(half_size_m=(0.1, 0.1, 0.1)), ["either a box or a sphere"]),
        (region(radius_m=0.0), ["position tolerance", "not 0"]),
        (region(region=Pose((0, 0, 0), (0.0, 0.0, 0.0, 0.0))), ["length 0"]),
        (region(offset_m=(0, 0, NAN)), ["offset", "nan"]),
        (Constraints(positions=(REGION,) * (MAX_POINTS + 1)), [str(MAX_POINTS)]),
        (Constraints(joints=(JOINT_RANGE,) * 65), ["64 constraints, not 65"]),
        (orientation(orientation=(0.0, 0.0, 0.0, 0.5)), ["length 0.5"]),
        (orientation(tolerance_rad=(0.1, 0.1, 0.0)), ["orientation tolerance", "not 0"]),
        (orientation(weight=NAN), ["weight", "nan"]),
    ):
        assert_refused(refusal(checks.check_constraints, robot, constraints), INVALID, said)
    reaching = (joint_range(position_rad=each, above_rad=0.4, below_rad=0.4) for each in (-2.0, 2.0))
    for constraints in (Constraints(joints=(JOINT_RANGE,) * 64), joint_range(weight=0.0), *reaching):
        assert refusal(checks.check_constraints, robot, constraints) is None
