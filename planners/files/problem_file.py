"""Planning problems in files, in the format ``so101-plan-bench/1``: one scene, limits, and motions to plan in it.

``docs/planning.md`` describes the fields. ``null`` stands for a number that is not finite. Sizes and names are taken
unchecked; the collision model decides whether a scene can be used. This module imports no planning library.
"""

from __future__ import annotations

import dataclasses
import json
import math
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, TypeAdapter, ValidationError, model_validator

from planners import scene
from planners.errors import ProblemFileError
from planners.goals import AnyGoal, AnyOf, AxisGoal, ConstraintGoal, JointGoal, PoseGoal, PositionGoal
from planners.problem import MoveItErrorCode, PlanningFailure, PlanningProblem
from planners.scene import Point, Quaternion, Scene
from robot.description.model import RobotModel

Kind = Literal["box", "sphere", "cylinder", "cone", "plane", "mesh"]

# How many numbers the dimensions of a shape are; cylinders and cones as shape_msgs/SolidPrimitive, height first.
DIMENSIONS: Mapping[str, int] = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "plane": 4, "mesh": 0}

_SHAPE_OF: Mapping[str, Callable[..., scene.Shape]] = {
    "box": lambda x, y, z: scene.Box((x, y, z)),
    "sphere": scene.Sphere,
    "cylinder": lambda height, radius: scene.Cylinder(radius, height),
    "cone": lambda height, radius: scene.Cone(radius, height),
    "plane": lambda x, y, z, offset: scene.Plane((x, y, z), offset),
}

FORMAT: Literal["so101-plan-bench/1"] = "so101-plan-bench/1"

_GOALS: Mapping[str, type[Any]] = {
    "joints": JointGoal,
    "position": PositionGoal,
    "axis": AxisGoal,
    "pose": PoseGoal,
    "constraints": ConstraintGoal,
}

_NOT_OPTIONS = {"group", "start_rad", "goal"}
_ANY_OF = "any_of"

SHOWN_CHARACTERS = 60  # as much of a refused value as fits in a line

_Rate = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_Angle = Annotated[float, Field(allow_inf_nan=False)]


class PoseFields(BaseModel):
    """A pose: ``position`` [m], ``orientation`` as a quaternion x, y, z, w."""

    position: Point = (0.0, 0.0, 0.0)
    orientation: Quaternion = (0.0, 0.0, 0.0, 1.0)

    def pose(self) -> scene.Pose:
        """Return the pose."""
        return scene.Pose(self.position, self.orientation)


class ShapeFields(BaseModel):
    """A shape: ``type`` with ``dimensions`` [m], or a mesh with ``vertices`` [m] and ``triangles``."""

    type: Kind
    dimensions: list[float] = []
    vertices: list[Point] = []
    triangles: list[tuple[int, int, int]] = []
    pose: PoseFields = PoseFields()

    @model_validator(mode="after")
    def _has_its_dimensions(self) -> ShapeFields:
        expected = DIMENSIONS[self.type]
        if self.type != "mesh" and len(self.dimensions) != expected:
            raise ValueError(f"the dimensions of a {self.type} are {expected} numbers, not {len(self.dimensions)}")
        return self

    def shape(self) -> scene.Shape:
        """Return the shape, without its pose."""
        if self.type == "mesh":
            vertices_m = np.array(self.vertices, dtype=np.float64).reshape(-1, 3)
            return scene.Mesh(vertices_m, np.array(self.triangles, dtype=np.int32).reshape(-1, 3))
        return _SHAPE_OF[self.type](*self.dimensions)


class ObjectFields(BaseModel):
    """An object: of one shape, given beside its ``id``, or of several in ``shapes``."""

    id: str
    pose: PoseFields = PoseFields()
    shapes: list[ShapeFields]

    @model_validator(mode="before")
    @classmethod
    def _one_shape_is_given_beside_the_name(cls, fields: Any) -> Any:
        if not isinstance(fields, dict) or "shapes" in fields:
            return fields
        return {**fields, "shapes": [{name: value for name, value in fields.items() if name != "pose"}]}

    def object(self) -> scene.SceneObject:
        """Return the object."""
        shapes = tuple((fields.shape(), fields.pose.pose()) for fields in self.shapes)
        return scene.SceneObject(self.id, shapes, self.pose.pose())


class AttachedFields(ObjectFields):
    """An object attached to ``link``, its pose in the link's frame."""

    link: str
    touch_links: list[str] = []


class SceneFields(BaseModel):
    """Objects around the robot, attached objects, and allowed contacts."""

    objects: list[ObjectFields] = []
    attached: list[AttachedFields] = []
    allowed_contacts: list[tuple[str, str, bool]] = []
    link_padding: dict[str, float] = {}
    link_scale: dict[str, float] = {}

    def scene(self, version: int) -> scene.Scene:
        """Return the scene; no other scene has its version."""
        objects = tuple(fields.object() for fields in self.objects)
        held = ((each.object(), each.link, frozenset(each.touch_links)) for each in self.attached)
        allowed = {frozenset((first, second)): may_touch for first, second, may_touch in self.allowed_contacts}
        return scene.Scene(
            version,
            objects,
            tuple(scene.AttachedObject(*each) for each in held),
            allowed,
            self.link_padding,
            self.link_scale,
        )


def scene_fields(described: scene.Scene) -> dict[str, Any]:
    """A scene as fields of a problem file."""
    held = described.attached
    return {
        "objects": [_object_fields(scene_object) for scene_object in described.objects],
        "attached": [
            {**_object_fields(each.object), "link": each.link, "touch_links": sorted(each.touch_links)} for each in held
        ],
        "allowed_contacts": [[min(pair), max(pair), allowed] for pair, allowed in described.allowed.items() if pair],
        "link_padding": dict(described.link_padding_m),
        "link_scale": dict(described.link_scale),
    }


def _object_fields(scene_object: scene.SceneObject) -> dict[str, Any]:
    shapes = [{**_shape_fields(shape), "pose": _pose_fields(pose)} for shape, pose in scene_object.shapes]
    return {"id": scene_object.name, "pose": _pose_fields(scene_object.pose), "shapes": shapes}


def _pose_fields(pose: scene.Pose) -> dict[str, Any]:
    return {"position": list(pose.position_m), "orientation": list(pose.orientation)}


def _shape_fields(shape: scene.Shape) -> dict[str, Any]:
    match shape:
        case scene.Box(size_m):
            return {"type": "box", "dimensions": list(size_m)}
        case scene.Sphere(radius_m):
            return {"type": "sphere", "dimensions": [radius_m]}
        case scene.Cylinder(radius_m, height_m):
            return {"type": "cylinder", "dimensions": [height_m, radius_m]}
        case scene.Cone(radius_m, height_m):
            return {"type": "cone", "dimensions": [height_m, radius_m]}
        case scene.Plane(normal, offset_m):
            return {"type": "plane", "dimensions": [*normal, offset_m]}
        case scene.Mesh(vertices_m, triangles):
            return {"type": "mesh", "vertices": vertices_m.tolist(), "triangles": triangles.tolist()}


_ADAPTERS: Mapping[type[Any], TypeAdapter[Any]] = {
    PlanningProblem: TypeAdapter(PlanningProblem),
    **{kind: TypeAdapter(kind) for kind in _GOALS.values()},
}


@dataclass(frozen=True)
class FileProblem:
    """One motion of a file."""

    id: str  # its name in the file
    problem: PlanningProblem
    accept_codes: tuple[int, ...]  # values of moveit_msgs/MoveItErrorCodes that are right answers
    answered_code: int | None = None  # error code by which the server that saved it has answered; None for others

    @property
    def feasible(self) -> bool:
        """True when the file expects a motion."""
        return MoveItErrorCode.SUCCESS in self.accept_codes


@dataclass(frozen=True)
class ProblemFile:
    """Content of a problem file."""

    name: str
    robot: RobotModel  # the robot that was given, with the file's limits
    joint_names: tuple[str, ...]  # the joints of its problems, in the file's order
    scene: Scene  # its version is a checksum of the file
    problems: tuple[FileProblem, ...]  # in the file's order


class _Limits(BaseModel):
    """Per joint of ``joint_names``: positions [rad], rates [rad/s, rad/s^2]."""

    velocity: list[_Rate]
    acceleration: list[_Rate]
    lower: list[_Angle]
    upper: list[_Angle]


class _Entry(BaseModel):
    """One problem: a goal in one of three ways, and options."""

    id: str
    start: list[float]
    accept_codes: list[int] = [int(MoveItErrorCode.SUCCESS)]
    error_code: int | None = None
    goal: list[float] | dict[str, Any] | None = None
    position: Point | None = None
    tolerance: float = 0.005
    options: dict[str, Any] = {}


class _File(SceneFields):
    format: Literal["so101-plan-bench/1"]
    name: str
    frame: str | None = None
    group: str | None = None
    joint_names: list[str]
    gripper: float | None = None
    other_joints: dict[str, float] = Field(default_factory=dict)
    limits: _Limits | None = None
    joint_problems: tuple[_Entry, ...] = ()
    position_problems: tuple[_Entry, ...] = ()
    goal_problems: tuple[_Entry, ...] = ()
    infeasible: tuple[_Entry, ...] = ()


def read(path: Path, robot: RobotModel) -> ProblemFile:
    """Read a file of problems; ProblemFileError: it is unreadable, of another format, or about another robot."""
    try:
        text = path.read_bytes()
        fields = _File.model_validate(_replaced(json.loads(text), lambda leaf: math.nan if leaf is None else leaf))
    except OSError as error:
        raise ProblemFileError(str(path), "", f"cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise _refused(path, "", error) from error
    except (ValueError, RecursionError) as error:
        raise ProblemFileError(str(path), "", f"is not JSON: {error}") from error
    return _Reader(path, fields, robot).file(zlib.crc32(text))


class _Reader:
    def __init__(self, path: Path, fields: _File, robot: RobotModel) -> None:
        self._path = path
        self._fields = fields
        self._group = self._group_of(robot)
        self._robot = self._with_limits(robot)

    def file(self, version: int) -> ProblemFile:
        problems = tuple(self._problems())
        ids = [problem.id for problem in problems]
        twice = next((name for name in ids if ids.count(name) > 1), None)
        if twice is not None:
            raise self._wrong("id", f"two problems are called {twice!r}")
        fields = self._fields
        return ProblemFile(fields.name, self._robot, tuple(fields.joint_names), fields.scene(version), problems)

    def _group_of(self, robot: RobotModel) -> str:
        """Return the group that is named, even if there is no such group, else the group of just these joints."""
        names, fields = self._fields.joint_names, self._fields
        if fields.frame not in (None, robot.root_link):
            raise self._wrong("frame", f"must be the robot's root link {robot.root_link!r}, not {fields.frame!r}")
        for i, name in enumerate(names):
            if name not in robot.joints:
                raise self._wrong(f"joint_names.{i}", f"the robot has no joint {name!r}")
        if fields.group is not None:
            return fields.group
        for group in robot.groups.values():
            if sorted(group.joints) == sorted(names):
                return group.name
        raise self._wrong("joint_names", f"no planning group of the robot has just the joints {', '.join(names)}")

    def _with_limits(self, robot: RobotModel) -> RobotModel:
        limits = self._fields.limits
        if limits is None:
            return robot
        joints = dict(robot.joints)
        for i, name in enumerate(self._fields.joint_names):
            values = [self._of_joint(f"limits.{key}", column)[i] for key, column in limits]
            velocity, acceleration, lower, upper = values
            if lower >= upper:
                raise self._wrong(f"limits.lower.{i}", f"{lower:g} must be below the upper limit {upper:g} of {name!r}")
            joints[name] = dataclasses.replace(
                joints[name], lower=lower, upper=upper, max_velocity=velocity, max_acceleration=acceleration
            )
        return dataclasses.replace(robot, joints=joints)

    def _problems(self) -> Iterator[FileProblem]:
        for key in ("joint_problems", "position_problems", "goal_problems", "infeasible"):
            entries: tuple[_Entry, ...] = getattr(self._fields, key)
            for i, entry in enumerate(entries):
                problem = self._problem(f"{key}.{i}", entry)
                yield FileProblem(entry.id, problem, tuple(entry.accept_codes), entry.error_code)

    def _problem(self, where: str, entry: _Entry) -> PlanningProblem:
        start = self._of_joint(f"{where}.start", entry.start)
        start_rad = {joint.name: 0.0 for joint in self._robot.movable_joints} | self._fields.other_joints
        if self._fields.gripper is not None:
            if self._robot.gripper is None:
                raise self._wrong("gripper", "the robot has no gripper: name its other joints in other_joints")
            start_rad |= dict.fromkeys(self._robot.gripper.joints, self._fields.gripper)
        start_rad |= dict(zip(self._fields.joint_names, start, strict=True))
        fields = {"group": self._group, "start_rad": start_rad, "goal": self._goal(where, entry)}
        problem: PlanningProblem = self._validated(f"{where}.options", PlanningProblem, {**entry.options, **fields})
        return problem

    def _goal(self, where: str, entry: _Entry) -> AnyGoal:
        if isinstance(entry.goal, list):
            values = self._of_joint(f"{where}.goal", entry.goal)
            return JointGoal(dict(zip(self._fields.joint_names, values, strict=True)))
        if entry.position is not None:
            group = self._robot.groups.get(self._group)
            if group is None or not group.tip_link:
                lack = "which the robot does not have" if group is None else "whose joints are not one chain"
                raise self._wrong(f"{where}.position", f"is for the tip of group {self._group!r}, {lack}: name a link")
            return PositionGoal(group.tip_link, entry.position, entry.tolerance)
        given = entry.goal or {}
        if list(given) == [_ANY_OF] and isinstance(given[_ANY_OF], list):
            each = (self._single_goal(f"{where}.goal.{_ANY_OF}.{i}", one) for i, one in enumerate(given[_ANY_OF]))
            return AnyOf(tuple(each))
        goal: AnyGoal = self._single_goal(f"{where}.goal", given)
        return goal

    def _single_goal(self, where: str, given: Any) -> Any:
        if not (isinstance(given, dict) and len(given) == 1 and set(given) <= set(_GOALS)):
            raise self._wrong(
                where, f"must be one of {', '.join(_GOALS)} with its fields (or {_ANY_OF}), not {given!r}"
            )
        ((kind, fields),) = given.items()
        return self._validated(f"{where}.{kind}", _GOALS[kind], fields)

    def _validated(self, where: str, kind: type[Any], fields: Any) -> Any:
        known = [field.name for field in dataclasses.fields(kind)]
        unknown = next((name for name in fields if name not in known), None) if isinstance(fields, dict) else None
        if unknown is not None:
            raise self._wrong(f"{where}.{unknown}", f"there is no such field, only {', '.join(known)}")
        try:
            return _ADAPTERS[kind].validate_python(fields)
        except ValidationError as error:
            raise _refused(self._path, where, error) from error

    def _of_joint(self, where: str, values: list[float]) -> list[float]:
        expected = len(self._fields.joint_names)
        if len(values) != expected:
            raise self._wrong(where, f"needs {expected} numbers, one for each of joint_names, not {len(values)}")
        return values

    def _wrong(self, field: str, reason: str) -> ProblemFileError:
        return ProblemFileError(str(self._path), field, reason)


def text(name: str, problem: PlanningProblem, scene: Scene, robot: RobotModel, answer: PlanningFailure) -> str:
    """Return the text of a file ``name`` with one problem and its answer; ``robot`` has the limits that were kept."""
    group = robot.groups.get(problem.group)
    names = group.joints if group is not None else tuple(joint.name for joint in robot.movable_joints)
    joints = [robot.joints[name] for name in names]
    others = [joint.name for joint in robot.movable_joints if joint.name not in names]
    fields = {
        "format": FORMAT,
        "name": name,
        "frame": robot.root_link,
        "robot": robot.name,
        "group": problem.group,
        "joint_names": list(names),
        "other_joints": {name: problem.start_rad.get(name, math.nan) for name in others},
        "limits": {
            "velocity": [joint.max_velocity for joint in joints],
            "acceleration": [joint.max_acceleration for joint in joints],
            "lower": [joint.lower for joint in joints],
            "upper": [joint.upper for joint in joints],
        },
        **scene_fields(scene),
    }
    entry = {
        "id": name,
        "start": [problem.start_rad.get(name, math.nan) for name in names],
        "goal": _kind_and_fields(problem.goal),
        "options": _ADAPTERS[PlanningProblem].dump_python(
            problem, mode="json", exclude_none=True, exclude=_NOT_OPTIONS
        ),
        "error_code": int(answer.code),
        "message": answer.message,
    }
    # JSON has no number for NaN.
    whole = _replaced(
        {**fields, "goal_problems": [entry]},
        lambda leaf: None if isinstance(leaf, float) and not math.isfinite(leaf) else leaf,
    )
    return json.dumps(whole, allow_nan=False, indent=1) + "\n"


def _kind_and_fields(goal: AnyGoal) -> dict[str, Any]:
    if isinstance(goal, AnyOf):
        return {_ANY_OF: [_kind_and_fields(one) for one in goal.goals]}
    name = next(name for name, kind in _GOALS.items() if isinstance(goal, kind))
    return {name: _ADAPTERS[_GOALS[name]].dump_python(goal, mode="json", exclude_none=True)}


def _replaced(value: Any, leaf: Callable[[Any], Any]) -> Any:
    if isinstance(value, dict):
        return {key: _replaced(item, leaf) for key, item in value.items()}
    if isinstance(value, list):
        return [_replaced(item, leaf) for item in value]
    return leaf(value)


def _refused(path: Path, where: str, error: ValidationError) -> ProblemFileError:
    """Return the first flaw, with the field's place in the file."""
    first = error.errors(include_url=False)[0]
    field = ".".join(part for part in (where, *map(str, first["loc"])) if part)
    return ProblemFileError(str(path), field, f"{first['msg']}, not {str(first['input'])[:SHOWN_CHARACTERS]}")
