"""Context in which the fields of a request are read, and moveit_msgs/Constraints read as goal and path constraints."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from planners.goals import (
    AnyGoal,
    AnyOf,
    ConstraintGoal,
    Constraints,
    JointConstraint,
    JointGoal,
    OrientationConstraint,
    PoseGoal,
    PositionConstraint,
    PositionGoal,
    SingleGoal,
)
from planners.problem import MoveItErrorCode
from planners.scene import Point, Pose
from robot.description.model import Group, Joint, RobotModel
from server.errors import invalid, refused
from server.moveit.messages import Message, check_finite, read_point, read_pose
from server.moveit.parameters import MoveItParameters
from server.moveit.scene.frames import Frames, in_root

# A pose has six dimensions: a group with fewer joints cannot reach any orientation.
FREE_POSE_JOINTS = 6

# Positions this near to each other are one: MoveGroupInterface's default joint tolerance.
LEAST_JOINT_TOLERANCE_RAD = 1e-4

# MoveGroupInterface's default; a search cannot end exactly on a point.
LEAST_ORIENTATION_TOLERANCE_RAD = 1e-3

# The widest tolerance that clients fill in by default: compas_fab's. MoveGroupInterface's is 0.001, and goals without
# the field have 0.
DEFAULT_TOLERANCE_RAD = 0.01

# From pi on an axis is free, as a rotation vector is never longer.
FREE_RAD = math.pi

# MoveGroupInterface's default position tolerance, which a servo arm misses anyway. Smaller regions, down to size
# 0, are widened to it.
LEAST_TOLERANCE_M = 1e-4

# shape_msgs/SolidPrimitive's types.
UNSET, BOX, SPHERE, CYLINDER = 0, 1, 2, 3

DIMENSIONS = {BOX: ("x", "y", "z"), SPHERE: ("radius",), CYLINDER: ("height", "radius")}

# A box with edges that differ by more than this factor is a shape of its own, not a tolerance around a point.
ELONGATED_FACTOR = 2.0

# The planners' own bound; each alternative takes milliseconds to solve.
MAX_ALTERNATIVES = 64


@dataclass(frozen=True)
class RequestContext:
    """Context of one request; warnings gets a sentence for each part of the request that is not followed."""

    robot: RobotModel
    group: Group
    frames: Frames
    start_rad: Mapping[str, float]
    parameters: MoveItParameters
    warnings: list[str] = field(default_factory=list)

    def link(self, name: str) -> str:
        """Return the name of a link; the tip's for an empty name."""
        if not name:
            return checked_tip(tip_link(self.robot, self.group, self.parameters), self.group)
        return known_link(self.robot, name)

    def placed(self, frame_id: str, message: Message, where: str) -> Pose:
        """Transform a geometry_msgs/Pose from a frame, empty for the root link, into the root link."""
        frame = self.frames.resolve(frame_id, self.start_rad)
        return in_root(frame, read_pose(message, where))


def known_link(robot: RobotModel, name: str) -> str:
    if name not in robot.links:
        text = f"the robot has no link {name!r}; it has: {', '.join(robot.links)}"
        raise refused(MoveItErrorCode.INVALID_LINK_NAME, text, link=name)
    return name


def chooses_orientation(group: Group) -> bool:
    """Return true if a group has the joints to reach any orientation."""
    return len(group.joints) >= FREE_POSE_JOINTS


def checked_tip(link: str, group: Group) -> str:
    if not link:
        raise refused(
            MoveItErrorCode.INVALID_LINK_NAME,
            f"group {group.name} has no tip, for its joints are not one chain: name a link, or another group",
            group=group.name,
        )
    return link


def tip_link(robot: RobotModel, group: Group, parameters: MoveItParameters) -> str:
    """Return the link that goals of a group move when they name none; empty where the group is not one chain."""
    if group.name != (parameters.group_name or robot.default_group):
        return group.tip_link
    if parameters.end_effector_link:
        return parameters.end_effector_link
    return robot.tip_link if group.name == robot.default_group else group.tip_link


def planning_group(robot: RobotModel, name: str, parameters: MoveItParameters) -> Group:
    """Return a planning group; for an empty name the configured one, or else the robot's default."""
    wanted = name or parameters.group_name or robot.default_group
    if wanted not in robot.groups:
        known = ", ".join(sorted(robot.groups))
        raise refused(
            MoveItErrorCode.INVALID_GROUP_NAME,
            f"there is no planning group {wanted!r}; there are: {known}",
            group=wanted,
        )
    return robot.groups[wanted]


def read_joint_constraints(
    messages: Sequence[Message], context: RequestContext, where: str
) -> tuple[JointConstraint, ...]:
    """Read constraints on joints, one for each joint: several on the same joint become their common range."""
    found: dict[str, JointConstraint] = {}
    for index, message in enumerate(messages):
        constraint = _constraint(message, context, f"{where}.joint_constraints[{index}]")
        known = found.get(constraint.joint)
        found[constraint.joint] = constraint if known is None else _common(known, constraint, where)
    return tuple(found.values())


def _constraint(message: Message, context: RequestContext, where: str) -> JointConstraint:
    joint = context.robot.joints.get(message["joint_name"])
    if joint is None or not joint.movable:
        known = ", ".join(each.name for each in context.robot.movable_joints)
        raise invalid(
            f"{where}: there is no joint {message['joint_name']!r}; there are: {known}", joint=message["joint_name"]
        )
    tolerances = {name: message[name] for name in ("tolerance_above", "tolerance_below")}
    check_finite({"position": message["position"], **tolerances, "weight": message["weight"]}, where)
    for name, value in tolerances.items():
        if value < 0.0:
            raise invalid(f"{where}.{name} must be 0 {joint.unit} or more, not {value:g}", joint=joint.name)
    above, below = tolerances.values()
    position = _within_limits(joint, message, context, where)
    lower, upper = min(position, message["position"] - below), max(position, message["position"] + above)
    return JointConstraint(joint.name, position, upper - position, position - lower, max(0.0, message["weight"]))


def _within_limits(joint: Joint, message: Message, context: RequestContext, where: str) -> float:
    """Return the position, clamped to a limit that it exceeds by no more than a tolerance."""
    requested = float(message["position"])
    inside = min(max(requested, joint.lower), joint.upper)
    own = message["tolerance_below"] if requested > inside else message["tolerance_above"]
    if abs(requested - inside) > max(context.parameters.joint_tolerance, own):
        raise invalid(
            f"{where}: the position of joint {joint.name!r}, {requested:.4g} {joint.unit}, is beyond its limits"
            f" {joint.lower:.4g} to {joint.upper:.4g} {joint.unit}{joint.degrees_hint(requested)}",
            joint=joint.name,
            position_rad=requested,
            lower_rad=joint.lower,
            upper_rad=joint.upper,
        )
    if inside != requested:
        context.warnings.append(
            f"the goal of joint {joint.name} is moved from {requested:.4g} to its limit {inside:.4g} {joint.unit}"
        )
    return inside


def _common(first: JointConstraint, second: JointConstraint, where: str) -> JointConstraint:
    lower = max(first.position_rad - first.below_rad, second.position_rad - second.below_rad)
    upper = min(first.position_rad + first.above_rad, second.position_rad + second.above_rad)
    if lower > upper + LEAST_JOINT_TOLERANCE_RAD:
        raise invalid(
            f"{where}: the constraints on joint {first.joint!r} leave it no position:"
            f" one ends at {upper:.4g}, another begins at {lower:.4g}",
            joint=first.joint,
        )
    position = min(max(first.position_rad, lower), upper)
    weight = max(first.weight, second.weight)
    return JointConstraint(first.joint, position, max(0.0, upper - position), max(0.0, position - lower), weight)


def read_orientation_constraint(message: Message, context: RequestContext, where: str) -> OrientationConstraint:
    """Read the orientation of a link, with the tolerances about its axes.

    They are about the link's axes whatever the ``parameterization``: the two kinds differ only for tolerances
    that are wide about several axes.
    """
    link = context.link(message["link_name"])
    pose = {"position": dict.fromkeys("xyz", 0.0), "orientation": message["orientation"]}
    desired = context.placed(message["header"]["frame_id"], pose, where)
    x, y, z = (_tolerance(message, axis, where) for axis in "xyz")
    return OrientationConstraint(link, desired.orientation, (x, y, z), _weight(message, where))


def is_binding(constraint: OrientationConstraint, context: RequestContext) -> bool:
    """Return True where an orientation outside its tolerance is an error; else the nearest is used and reported.

    A group with six joints can reach any orientation, so there it is an error. A group with fewer rarely can: it is
    bound by tolerances that a client has chosen, which are wider than the widest that clients fill in by default.
    """
    return chooses_orientation(context.group) or max(constraint.tolerance_rad) > DEFAULT_TOLERANCE_RAD


def _tolerance(message: Message, axis: str, where: str) -> float:
    field = f"absolute_{axis}_axis_tolerance"
    value = float(message[field])
    if math.isnan(value) or value < 0.0:
        raise invalid(f"{where}.{field} must be a number of 0 rad or more, not {value:g}")
    return min(max(value, LEAST_ORIENTATION_TOLERANCE_RAD), 2.0 * FREE_RAD)


def _read_regions(message: Message, context: RequestContext, where: str) -> tuple[PositionConstraint, ...]:
    """Read the regions of one moveit_msgs/PositionConstraint, which are alternatives.

    A pose in ``primitive_poses`` without a primitive, or with an unset one, is a point to reach within the configured
    position tolerance.
    """
    link = context.link(message["link_name"])
    volume = message["constraint_region"]
    if volume["meshes"]:
        raise invalid(f"{where}.constraint_region.meshes: regions can be boxes, spheres and cylinders, not meshes")
    primitives, poses = list(volume["primitives"]), volume["primitive_poses"]
    if not poses:
        missing = "no pose for its primitive" if primitives else "no region: give a primitive and its pose"
        raise invalid(f"{where}.constraint_region has {missing}", link=link)
    if len(primitives) > len(poses):
        raise invalid(f"{where}.constraint_region has {len(primitives)} primitives and {len(poses)} primitive_poses")
    primitives += [None] * (len(poses) - len(primitives))
    offset, weight = read_point(message["target_point_offset"], f"{where}.target_point_offset"), _weight(message, where)
    frame, found = message["header"]["frame_id"], []
    for index, (primitive, pose) in enumerate(zip(primitives, poses, strict=True)):
        at = context.placed(frame, pose, f"{where}.constraint_region.primitive_poses[{index}]")
        size_m = _size(primitive, context, f"{where}.constraint_region.primitives[{index}]")
        found.append(PositionConstraint(link, at, *size_m, offset, weight))
    return tuple(found)


def _size(primitive: Message | None, context: RequestContext, where: str) -> tuple[Point | None, float | None]:
    """Return half the edges of a box and None, or None and the radius of a sphere [m]."""
    if primitive is None or (primitive["type"] == UNSET and not primitive["dimensions"]):
        return None, context.parameters.position_tolerance
    kind, given = primitive["type"], primitive["dimensions"]
    if kind not in DIMENSIONS:
        raise invalid(
            f"{where}.type: regions can be boxes ({BOX}), spheres ({SPHERE}) and cylinders ({CYLINDER}), not {kind}"
        )
    names = DIMENSIONS[kind]
    if len(given) != len(names):
        raise invalid(f"{where}.dimensions must have {len(names)} values ({', '.join(names)}), not {len(given)}")
    for name, value in zip(names, given, strict=True):
        if not (math.isfinite(value) and value >= 0.0):
            raise invalid(f"{where}.dimensions: {name} must be a finite number of 0 m or more, not {value:g}")
    if kind == SPHERE:
        return None, max(float(given[0]), LEAST_TOLERANCE_M)
    if kind == CYLINDER:
        # The largest upright box with a square base in it, so that a point in the box is in the cylinder.
        height, across = given[0], math.sqrt(2.0) * given[1]
        given = (across, across, height)
    x, y, z = (max(0.5 * float(edge), LEAST_TOLERANCE_M) for edge in given)
    return (x, y, z), None


def _weight(message: Message, where: str) -> float:
    """Read a weight; as in MoveIt, those below 0 count as 0."""
    check_finite({"weight": message["weight"]}, where)
    return max(0.0, float(message["weight"]))


def read_goal(messages: Sequence[Message], context: RequestContext) -> AnyGoal:
    """Read the goal of a motion from moveit_msgs/Constraints, which are alternatives."""
    if not messages:
        raise invalid("goal_constraints is empty: there is nothing to plan for")
    found: list[SingleGoal] = []
    for index, message in enumerate(messages):
        found += _goals(message, context, f"goal_constraints[{index}]", MAX_ALTERNATIVES - len(found))
    return found[0] if len(found) == 1 else AnyOf(tuple(found))


def read_path_constraints(message: Message, context: RequestContext, where: str = "path_constraints") -> Constraints:
    """Read constraints that hold from start to end; the result may be :attr:`Constraints.empty`."""
    joints, positions, orientations = _read_parts(message, context, where)
    for index, regions in enumerate(positions):
        if len(regions) > 1:
            raise invalid(f"{where}.position_constraints[{index}] has {len(regions)} regions; on the way it can be one")
    return Constraints(joints, tuple(regions[0] for regions in positions), orientations)


def _goals(message: Message, context: RequestContext, where: str, most: int) -> Iterator[SingleGoal]:
    """Yield the alternatives of one moveit_msgs/Constraints: one goal for each combination of regions."""
    joints, positions, orientations = _read_parts(message, context, where)
    if not (joints or positions or orientations):
        raise invalid(f"{where} is empty: give joint, position or orientation constraints")
    # Joints of other groups do not move: constraints on them must hold at the start.
    for each in joints:
        if each.joint in context.group.joints:
            continue
        away = context.start_rad[each.joint] - each.position_rad
        least = context.parameters.joint_tolerance
        if not -max(each.below_rad, least) <= away <= max(each.above_rad, least):
            known = ", ".join(context.group.joints)
            raise invalid(
                f"{where}: group {context.group.name!r} does not move joint {each.joint!r}; it moves: {known}",
                joint=each.joint,
            )
        context.warnings.append(f"joint {each.joint} is not in group {context.group.name} and stays where it is")
    moved = tuple(each for each in joints if each.joint in context.group.joints)
    if math.prod(map(len, positions)) > most:
        raise invalid(f"{where} and those before it have more than {MAX_ALTERNATIVES} alternatives of regions")
    for regions in itertools.product(*positions):
        yield _goal(moved, regions, orientations, context)


def _goal(
    joints: tuple[JointConstraint, ...],
    positions: tuple[PositionConstraint, ...],
    orientations: tuple[OrientationConstraint, ...],
    context: RequestContext,
) -> SingleGoal:
    if not (positions or orientations):
        return JointGoal({each.joint: each.position_rad for each in joints}, context.parameters.joint_tolerance)
    if positions:
        orientations = tuple(each for each in orientations if min(each.tolerance_rad) < FREE_RAD)
    if not joints and len(positions) == 1:
        goal = _link_goal(positions[0], orientations, context)
        if goal is not None:
            return goal
    # Widened so that a search can end in them.
    least = LEAST_JOINT_TOLERANCE_RAD
    solvable = (
        replace(each, above_rad=max(each.above_rad, least), below_rad=max(each.below_rad, least)) for each in joints
    )
    return ConstraintGoal(Constraints(tuple(solvable), positions, orientations))


def _link_goal(
    position: PositionConstraint, orientations: tuple[OrientationConstraint, ...], context: RequestContext
) -> PositionGoal | PoseGoal | None:
    """Make the goal of one link, whose failure names the nearest point; None where the constraints need another."""
    # Radius of the largest ball around the region's middle that is inside it.
    within_m = position.radius_m or LEAST_TOLERANCE_M
    if position.half_size_m is not None:
        within_m = min(position.half_size_m)
        if max(position.half_size_m) > ELONGATED_FACTOR * within_m:
            return None
    if not orientations:
        return PositionGoal(position.link, position.region.position_m, within_m, position.offset_m)
    orientation = orientations[0]
    if len(orientations) > 1 or orientation.link != position.link or any(position.offset_m):
        return None
    pose, binding = Pose(position.region.position_m, orientation.orientation), is_binding(orientation, context)
    return PoseGoal(position.link, pose, within_m, orientation.tolerance_rad, strict=binding)


def _read_parts(
    message: Message, context: RequestContext, where: str
) -> tuple[tuple[JointConstraint, ...], list[tuple[PositionConstraint, ...]], tuple[OrientationConstraint, ...]]:
    """Read the parts of a moveit_msgs/Constraints; the regions of each position constraint are alternatives."""
    if message["visibility_constraints"]:
        raise invalid(f"{where}.visibility_constraints: what a sensor sees is not planned for; leave them out")
    regions = [
        _read_regions(constraint, context, f"{where}.position_constraints[{index}]")
        for index, constraint in enumerate(message["position_constraints"])
    ]
    orientations = tuple(
        read_orientation_constraint(constraint, context, f"{where}.orientation_constraints[{index}]")
        for index, constraint in enumerate(message["orientation_constraints"])
    )
    return read_joint_constraints(message["joint_constraints"], context, where), regions, orientations
