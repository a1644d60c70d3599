import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from planners.errors import ProblemFileError
from planners.files import problem_file
from planners.files.problem_file import SceneFields, scene_fields
from planners.goals import (
    AnyOf,
    AxisGoal,
    ConstraintGoal,
    Constraints,
    JointConstraint,
    JointGoal,
    OrientationConstraint,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
)
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
SHAPES = {
    "box": Box((0.1, 0.2, 0.3)),
    "sphere": Sphere(0.1),
    "cylinder": Cylinder(radius_m=0.1, height_m=0.3),
    "cone": Cone(radius_m=0.1, height_m=0.3),
    "plane": Plane((0.0, 0.0, 1.0), 0.2),
}


def again(scene: Scene) -> Scene:
    """The scene after its way through JSON."""
    return SceneFields.model_validate(json.loads(json.dumps(scene_fields(scene)))).scene(scene.version)


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_a_shape_is_the_same_when_it_is_read_again(shape) -> None:
    scene = Scene(3, (SceneObject("thing", ((shape, Pose()),), TURNED),))
    assert again(scene) == scene


def test_a_mesh_is_the_same_when_it_is_read_again() -> None:
    mesh = Mesh(np.eye(3) / 3.0, np.array([[0, 1, 2]], dtype=np.int32))
    ((shape, _),) = again(Scene(3, (SceneObject("thing", ((mesh, Pose()),)),))).objects[0].shapes
    np.testing.assert_array_equal(shape.vertices_m, mesh.vertices_m)
    np.testing.assert_array_equal(shape.triangles, mesh.triangles)
    assert shape.triangles.dtype == np.int32


def test_all_the_rest_of_a_scene_is_the_same_when_it_is_read_again() -> None:
    several = SceneObject("several", ((SHAPES["box"], TURNED), (SHAPES["sphere"], Pose())), TURNED)
    held = AttachedObject(SceneObject("held", ((SHAPES["cone"], TURNED),)), "wrist_link", frozenset({"gripper_link"}))
    allowed = {frozenset(("held", "several")): True, frozenset(("base_link", "wrist_link")): False}
    scene = Scene(3, (several,), (held,), allowed, {"wrist_link": 0.01}, {"wrist_link": 1.1})
    assert again(scene) == scene


def test_a_lone_shape_has_the_dimensions_of_shape_msgs_and_the_pose_is_the_things() -> None:
    pose = {"position": [0.1, 0.2, 0.3], "orientation": [0.0, 0.0, 1.0, 0.0]}
    entry = {"id": "a", "type": "cylinder", "dimensions": [0.3, 0.1], "pose": pose}
    (thing,) = SceneFields.model_validate({"objects": [entry]}).scene(1).objects
    assert thing == SceneObject("a", ((Cylinder(radius_m=0.1, height_m=0.3), Pose()),), TURNED)
    with pytest.raises(ValidationError, match="the dimensions of a cylinder are 2 numbers, not 1"):
        SceneFields.model_validate({"objects": [{**entry, "dimensions": [0.3]}]})


ROBOT = so101()
ARM = ROBOT.groups["arm"].joints
TIP = "gripper_frame_link"
FAILED = PlanningFailure(MoveItErrorCode.PLANNING_FAILED, "no way")
REST = {joint.name: 0.0 for joint in ROBOT.movable_joints}

CONSTRAINTS = Constraints(
    (JointConstraint("elbow_flex", 0.1, 0.2, 0.3, 0.5),),
    (PositionConstraint(TIP, Pose((0.1, 0.2, 0.3)), half_size_m=(1.0, 1.0, 0.1)),),
    (OrientationConstraint(TIP, (0.0, 0.0, 0.0, 1.0), (0.1, 0.1, 4.0)),),
)
GOALS = {
    "joints": JointGoal(dict.fromkeys(ARM, 0.25), 0.1),
    "position": PositionGoal("wrist_link", (0.3, 0.1, 0.2), 0.01, (0.0, 0.0, 0.1)),
    "axis": AxisGoal(TIP, (0.3, 0.1, 0.2), 0.01, (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), 0.1),
    "pose": PoseGoal(TIP, Pose((0.3, 0.1, 0.2), (1.0, 0.0, 0.0, 0.0)), 0.01, (0.1, 0.2, 0.3), strict=True),
    "constraints": ConstraintGoal(CONSTRAINTS),
    "any of": AnyOf((JointGoal({"elbow_flex": 0.25}), PositionGoal(TIP, (0.3, 0.1, 0.2), 0.01))),
}


def written(path: Path, problem: PlanningProblem, scene: Scene = EMPTY_SCENE, robot: model.RobotModel = ROBOT):
    path.write_text(problem_file.text(path.stem, problem, scene, robot, FAILED))
    return problem_file.read(path, ROBOT)


def minimal(**changes):
    fields = {
        "format": problem_file.FORMAT,
        "name": "made",
        "joint_names": list(ARM),
        "joint_problems": [{"id": "a", "start": [0.0] * 5, "goal": [0.1] * 5}],
    }
    return {**fields, **changes}


def refusal(path: Path, fields) -> ProblemFileError:
    path.write_text(fields if isinstance(fields, str) else json.dumps(fields))
    with pytest.raises(ProblemFileError) as caught:
        problem_file.read(path, ROBOT)
    assert str(path) in str(caught.value)
    return caught.value


@pytest.mark.parametrize("goal", GOALS.values(), ids=GOALS)
def test_a_problem_that_failed_is_the_same_when_it_is_read_again(tmp_path, goal) -> None:
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
    file = written(tmp_path / "goal-7.json", problem)
    (one,) = file.problems
    assert one.problem == problem
    assert one.id == "goal-7"


def test_numbers_that_are_not_finite_survive(tmp_path) -> None:
    pose = PoseGoal(TIP, Pose((math.nan, 0.0, 0.0)), 0.01, (0.1, 0.1, 0.1))
    # Joints without a start have none afterwards, and a group that does not exist is kept.
    file = written(tmp_path / "a.json", PlanningProblem("leg", {"elbow_flex": math.inf, "wrist_flex": 0.1}, pose))
    problem = file.problems[0].problem
    assert problem.group == "leg"
    assert math.isnan(problem.goal.pose.position_m[0])
    assert not math.isfinite(problem.start_rad["elbow_flex"])
    assert problem.start_rad["wrist_flex"] == 0.1
    assert math.isnan(problem.start_rad["gripper"])
    assert "NaN" not in (tmp_path / "a.json").read_text()


def test_files_with_different_scenes_have_different_versions(tmp_path) -> None:
    problem = PlanningProblem("arm", REST, GOALS["position"])
    box = SceneObject("box", ((Box((0.1, 0.1, 0.1)), Pose()),))
    versions = {written(tmp_path / "a.json", problem, scene).scene.version for scene in (EMPTY_SCENE, Scene(1, (box,)))}
    assert len(versions) == 2


def test_the_gripper_and_the_limits_of_a_file_hold(tmp_path) -> None:
    limits = {"velocity": [1.0] * 5, "acceleration": [2.0] * 5, "lower": [-0.5] * 5, "upper": [0.5] * 5}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(minimal(gripper=0.4, limits=limits, joint_names=list(reversed(ARM)))))
    file = problem_file.read(path, ROBOT)
    assert file.joint_names == tuple(reversed(ARM))
    assert file.problems[0].problem.start_rad["gripper"] == 0.4
    for name in ARM:
        joint = file.robot.joints[name]
        assert (joint.lower, joint.upper, joint.max_velocity, joint.max_acceleration) == (-0.5, 0.5, 1.0, 2.0)


def test_null_is_a_number_that_is_not_finite(tmp_path) -> None:
    path = tmp_path / "a.json"
    entry = {"id": "x", "start": [0.0] * 5, "goal": [0.0, None, 0.0, 0.0, 0.0], "accept_codes": [-16]}
    path.write_text(json.dumps(minimal(infeasible=[entry])))
    feasible, refused = problem_file.read(path, ROBOT).problems
    assert math.isnan(refused.problem.goal.positions_rad["shoulder_lift"])
    assert (feasible.feasible, refused.feasible) == (True, False)
    assert refused.accept_codes == (-16,)


LIMITS = {"velocity": [1.0] * 5, "acceleration": [2.0] * 5, "lower": [-0.5] * 5, "upper": [0.5] * 5}
PROBLEM = {"id": "a", "start": [0.0] * 5}
WRONG = {
    "no JSON": ("{", "", "is not JSON"),
    "too deep": ("[" * 100_000, "", "is not JSON"),
    "other format": (minimal(format="urdf"), "format", "so101-plan-bench/1"),
    "no joints": (minimal(joint_names=["knee"]), "joint_names.0", "'knee'"),
    "other joints": (minimal(joint_names=["elbow_flex"]), "joint_names", "no planning group"),
    "other frame": (minimal(frame="camera"), "frame", "'base_link'"),
    "short start": (minimal(joint_problems=[{**PROBLEM, "start": [0.0]}]), "joint_problems.0.start", "5 numbers"),
    "text for a number": (minimal(gripper="wide"), "gripper", "wide"),
    "no goal": (minimal(goal_problems=[PROBLEM]), "goal_problems.0.goal", "pose"),
    "unknown goal": (minimal(goal_problems=[{**PROBLEM, "goal": {"dance": {}}}]), "goal_problems.0.goal", "dance"),
    "unknown goal field": (
        minimal(goal_problems=[{**PROBLEM, "goal": {"joints": {"positions": {}}}}]),
        "goal_problems.0.goal.joints.positions",
        "positions_rad",
    ),
    "incomplete goal": (
        minimal(goal_problems=[{**PROBLEM, "goal": {"any_of": [{"position": {"link": TIP, "tolerance_m": 1}}]}}]),
        "goal_problems.0.goal.any_of.0.position.position_m",
        "required",
    ),
    "unknown option": (
        minimal(position_problems=[{**PROBLEM, "position": [0, 0, 0], "options": {"velocity": 1}}]),
        "position_problems.0.options.velocity",
        "velocity_scaling",
    ),
    "same id twice": (minimal(infeasible=[{**PROBLEM, "goal": [0.0] * 5}]), "id", "'a'"),
    "limits reversed": (minimal(limits={**LIMITS, "lower": [0.6] * 5}), "limits.lower.0", "0.6"),
    "velocity of zero": (minimal(limits={**LIMITS, "velocity": [0] * 5}), "limits.velocity.0", "greater than 0"),
    "limit not finite": (minimal(limits={**LIMITS, "upper": [None] * 5}), "limits.upper.0", "finite"),
    "unknown shape": (minimal(objects=[{"id": "a", "type": "teapot"}]), "objects.0.shapes.0.type", "teapot"),
}


@pytest.mark.parametrize(("fields", "field", "words"), WRONG.values(), ids=WRONG)
def test_a_wrong_file_is_refused_with_its_field(tmp_path, fields, field, words) -> None:
    error = refusal(tmp_path / "a.json", fields)
    assert error.field == field
    assert words in error.reason


def test_limits_of_the_robot_that_failed_are_those_of_the_robot_that_is_read(tmp_path) -> None:
    elbow = ROBOT.joints["elbow_flex"]
    elbow = replace(elbow, lower=-1.0, upper=0.5, max_velocity=0.2, max_acceleration=0.3)
    slow = replace(ROBOT, joints={**ROBOT.joints, "elbow_flex": elbow})
    file = written(tmp_path / "a.json", PlanningProblem("arm", REST, GOALS["position"]), robot=slow)
    assert file.robot == slow
