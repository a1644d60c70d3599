import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from planners import goals
from planners.errors import ProblemFileError
from planners.files import problem_file
from planners.files.problem_file import SceneFields, scene_fields
from planners.goals import JointGoal, PositionGoal
from planners.problem import MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import (
    EMPTY_SCENE,
    AttachedObject,
    Box,
    Cone,
    Cylinder,
    Mesh,
    Plane,
    Pose,
    Scene,
    SceneObject,
    Sphere,
)
from robot.description import model
from tests.helpers.robots import so101

TURNED = Pose((0.1, 0.2, 0.3), (0.0, 0.0, 1.0, 0.0))
BOX, SPHERE, CONE = Box((0.1, 0.2, 0.3)), Sphere(0.1), Cone(radius_m=0.1, height_m=0.3)
CYLINDER = Cylinder(radius_m=0.1, height_m=0.3)


def again(scene: Scene) -> Scene:
    """The scene after its way through JSON."""
    return SceneFields.model_validate(json.loads(json.dumps(scene_fields(scene)))).scene(scene.version)


def test_a_scene_is_the_same_when_it_is_read_again() -> None:
    for shape in (BOX, SPHERE, CYLINDER, CONE, Plane((0.0, 0.0, 1.0), 0.2)):
        scene = Scene(3, (SceneObject("thing", ((shape, Pose()),), TURNED),))
        assert again(scene) == scene
    mesh = Mesh(np.eye(3) / 3.0, np.array([[0, 1, 2]], dtype=np.int32))
    ((shape, _),) = again(Scene(3, (SceneObject("thing", ((mesh, Pose()),)),))).objects[0].shapes
    np.testing.assert_array_equal(shape.vertices_m, mesh.vertices_m)
    np.testing.assert_array_equal(shape.triangles, mesh.triangles)
    assert shape.triangles.dtype == np.int32
    several = SceneObject("several", ((BOX, TURNED), (SPHERE, Pose())), TURNED)
    held = AttachedObject(SceneObject("held", ((CONE, TURNED),)), "wrist_link", frozenset({"gripper_link"}))
    allowed = {frozenset(("held", "several")): True, frozenset(("base_link", "wrist_link")): False}
    scene = Scene(3, (several,), (held,), allowed, {"wrist_link": 0.01}, {"wrist_link": 1.1})
    assert again(scene) == scene


def test_a_lone_shape_has_the_dimensions_of_shape_msgs_and_the_pose_is_the_things() -> None:
    pose = {"position": [0.1, 0.2, 0.3], "orientation": [0.0, 0.0, 1.0, 0.0]}
    entry = {"id": "a", "type": "cylinder", "dimensions": [0.3, 0.1], "pose": pose}
    (thing,) = SceneFields.model_validate({"objects": [entry]}).scene(1).objects
    assert thing == SceneObject("a", ((CYLINDER, Pose()),), TURNED)
    with pytest.raises(ValidationError, match="the dimensions of a cylinder are 2 numbers, not 1"):
        SceneFields.model_validate({"objects": [{**entry, "dimensions": [0.3]}]})


ROBOT = so101()
ARM = ROBOT.groups["arm"].joints
TIP = "gripper_frame_link"
REST = {joint.name: 0.0 for joint in ROBOT.movable_joints}
FILE = "a.json"
LIMITS = {"velocity": [1.0] * 5, "acceleration": [2.0] * 5, "lower": [-0.5] * 5, "upper": [0.5] * 5}

CONSTRAINTS = goals.Constraints(
    (goals.JointConstraint("elbow_flex", 0.1, 0.2, 0.3, 0.5),),
    (goals.PositionConstraint(TIP, Pose((0.1, 0.2, 0.3)), half_size_m=(1.0, 1.0, 0.1)),),
    (goals.OrientationConstraint(TIP, (0.0, 0.0, 0.0, 1.0), (0.1, 0.1, 4.0)),),
)
POINT = PositionGoal("wrist_link", (0.3, 0.1, 0.2), 0.01, (0.0, 0.0, 0.1))
AXIS = goals.AxisGoal(TIP, (0.3, 0.1, 0.2), 0.01, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.1)
POSE = goals.PoseGoal(TIP, Pose((0.3, 0.1, 0.2), (1.0, 0.0, 0.0, 0.0)), 0.01, (0.1, 0.2, 0.3), strict=True)
ANY_OF = goals.AnyOf((JointGoal({"elbow_flex": 0.25}), PositionGoal(TIP, (0.3, 0.1, 0.2), 0.01)))


def written(path: Path, problem: PlanningProblem, scene: Scene = EMPTY_SCENE, robot: model.RobotModel = ROBOT):
    failed = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "no way")
    path.write_text(problem_file.text(path.stem, problem, scene, robot, failed))
    return problem_file.read(path, ROBOT)


def minimal(**changes):
    problem = {"id": "a", "start": [0.0] * 5, "goal": [0.1] * 5}
    fields = {"format": problem_file.FORMAT, "name": "made", "joint_names": list(ARM), "joint_problems": [problem]}
    return {**fields, **changes}


def read(path: Path, fields):
    path.write_text(fields if isinstance(fields, str) else json.dumps(fields))
    return problem_file.read(path, ROBOT)


def test_a_problem_that_failed_is_the_same_when_it_is_read_again(tmp_path) -> None:
    joints, constraints = JointGoal(dict.fromkeys(ARM, 0.25), 0.1), goals.ConstraintGoal(CONSTRAINTS)
    for goal in (joints, POINT, AXIS, POSE, constraints, ANY_OF):
        problem = PlanningProblem(
            "arm",
            REST | {"gripper": 0.7},
            goal,
            0.3,
            0.4,
            allowed_time_s=2.5,
            attempts=7,
            seed=11,
            start_velocity_rad_s={"elbow_flex": 0.1},
            path_constraints=CONSTRAINTS,
            planner_id="RRTConnect",
            optimization_time_s=0.1,
        )
        (one,) = written(tmp_path / "goal-7.json", problem).problems
        assert (one.id, one.problem) == ("goal-7", problem)


def test_numbers_that_are_not_finite_survive_and_files_with_different_scenes_have_different_versions(tmp_path) -> None:
    pose = replace(POSE, pose=Pose((math.nan, 0.0, 0.0)))
    # Joints without a start have none afterwards, and a group that does not exist is kept.
    asked = PlanningProblem("leg", {"elbow_flex": math.inf, "wrist_flex": 0.1}, pose)
    file = written(tmp_path / FILE, asked)
    problem = file.problems[0].problem
    assert problem.group == "leg"
    assert math.isnan(problem.goal.pose.position_m[0])
    assert not math.isfinite(problem.start_rad["elbow_flex"])
    assert problem.start_rad["wrist_flex"] == 0.1
    assert math.isnan(problem.start_rad["gripper"])
    assert "NaN" not in (tmp_path / FILE).read_text()
    other = written(tmp_path / FILE, asked, Scene(1, (SceneObject("box", ((BOX, Pose()),)),)))
    assert other.scene.version != file.scene.version
    # A null is a number that is not finite.
    entry = {"id": "x", "start": [0.0] * 5, "goal": [0.0, None, 0.0, 0.0, 0.0], "accept_codes": [-16]}
    feasible, refused = read(tmp_path / FILE, minimal(infeasible=[entry])).problems
    assert math.isnan(refused.problem.goal.positions_rad["shoulder_lift"])
    assert (feasible.feasible, refused.feasible, refused.accept_codes) == (True, False, (-16,))


def test_the_gripper_and_the_limits_of_a_file_or_of_the_robot_that_failed_hold(tmp_path) -> None:
    file = read(tmp_path / FILE, minimal(gripper=0.4, limits=LIMITS, joint_names=list(reversed(ARM))))
    assert file.joint_names == tuple(reversed(ARM))
    assert file.problems[0].problem.start_rad["gripper"] == 0.4
    for joint in (file.robot.joints[name] for name in ARM):
        assert (joint.lower, joint.upper, joint.max_velocity, joint.max_acceleration) == (-0.5, 0.5, 1.0, 2.0)
    elbow = replace(ROBOT.joints["elbow_flex"], lower=-1.0, upper=0.5, max_velocity=0.2, max_acceleration=0.3)
    slow = replace(ROBOT, joints={**ROBOT.joints, "elbow_flex": elbow})
    assert written(tmp_path / FILE, PlanningProblem("arm", REST, POINT), robot=slow).robot == slow


PROBLEM = {"id": "a", "start": [0.0] * 5}
INCOMPLETE = {"any_of": [{"position": {"link": TIP, "tolerance_m": 1}}]}


def with_goal(goal):
    return minimal(goal_problems=[{**PROBLEM, "goal": goal}])


def test_a_wrong_file_is_refused_with_its_field(tmp_path) -> None:
    misspelled = {**PROBLEM, "position": [0, 0, 0], "options": {"velocity": 1}}
    path = tmp_path / FILE
    for fields, field, words in (
        ("{", "", "is not JSON"),
        ("[" * 100_000, "", "is not JSON"),
        (minimal(format="urdf"), "format", "so101-plan-bench/1"),
        (minimal(joint_names=["knee"]), "joint_names.0", "'knee'"),
        (minimal(joint_names=["elbow_flex"]), "joint_names", "no planning group"),
        (minimal(frame="camera"), "frame", "'base_link'"),
        (minimal(joint_problems=[{**PROBLEM, "start": [0.0]}]), "joint_problems.0.start", "5 numbers"),
        (minimal(gripper="wide"), "gripper", "wide"),
        (minimal(goal_problems=[PROBLEM]), "goal_problems.0.goal", "pose"),
        (with_goal({"dance": {}}), "goal_problems.0.goal", "dance"),
        (with_goal({"joints": {"positions": {}}}), "goal_problems.0.goal.joints.positions", "positions_rad"),
        (with_goal(INCOMPLETE), "goal_problems.0.goal.any_of.0.position.position_m", "required"),
        (minimal(position_problems=[misspelled]), "position_problems.0.options.velocity", "velocity_scaling"),
        (minimal(infeasible=[{**PROBLEM, "goal": [0.0] * 5}]), "id", "'a'"),
        (minimal(limits={**LIMITS, "lower": [0.6] * 5}), "limits.lower.0", "0.6"),
        (minimal(limits={**LIMITS, "velocity": [0] * 5}), "limits.velocity.0", "greater than 0"),
        (minimal(limits={**LIMITS, "upper": [None] * 5}), "limits.upper.0", "finite"),
        (minimal(objects=[{"id": "a", "type": "teapot"}]), "objects.0.shapes.0.type", "teapot"),
    ):
        with pytest.raises(ProblemFileError) as refusal:
            read(path, fields)
        assert str(path) in str(refusal.value)
        assert refusal.value.field == field
        assert words in refusal.value.reason
