"""URDF: elements, links and joints with their limits, and frames; held joints are fixed where they stay."""

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from robot.errors import DescriptionError
from robot.trajectory import Vector

# Of elements that xacro replaces; descriptions in circulation use all three.
XACRO_NAMESPACES = ("http://www.ros.org/wiki/xacro", "http://wiki.ros.org/xacro", "http://ros.org/wiki/xacro")

# Attributes that are numbers, and how many, of the elements in links and joints that the planning libraries read.
NUMBERS: Mapping[str, Mapping[str, int]] = {
    "origin": {"xyz": 3, "rpy": 3},
    "axis": {"xyz": 3},
    "box": {"size": 3},
    "mesh": {"scale": 3},
    "sphere": {"radius": 1},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "mass": {"value": 1},
    "inertia": dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1),
}

MAX_LINKS = 500  # more than any arm has; bounds the work that a file can cause
MAX_NUMBER = 1e100  # beyond, results overflow
MAX_SHOWN = 80  # characters of a wrong value in an error


def root_of(text: str, source: str) -> ET.Element:
    """Parse a URDF or SRDF, whose source is named in errors; xacro and MJCF are rejected with the next step."""
    try:
        root = ET.fromstring(text)  # noqa: S314 - the user's own file, given on the command line
    except ET.ParseError as error:
        raise DescriptionError(source, f"is not XML: {error}") from error
    if root.tag == "mujoco":
        raise DescriptionError(
            source,
            "is MJCF, MuJoCo's format: convert it to a URDF first (pip install mjcf-urdf-simple-converter), or use the "
            "URDF of the arm's maker, and give that",
        )
    if root.tag != "robot":
        raise DescriptionError(source, f"must start with <robot>, not <{root.tag}>")
    if macro := next(_macros(root), ""):
        raise DescriptionError(
            source,
            f"is xacro, with {macro}: expand it first with "
            "`xacro FILE.xacro > FILE` (pip install xacro), and give the result",
        )
    return root


def parsed(text: str) -> ET.Element:
    """Parse a URDF or SRDF that was read as a description before."""
    return ET.fromstring(text)  # noqa: S314 - the user's own file


def attribute(element: ET.Element, name: str, source: str) -> str:
    value = element.get(name)
    if value is None:
        raise DescriptionError(source, f"<{element.tag}> {element.attrib} has no attribute {name!r}")
    return value


def number(element: ET.Element, name: str, where: str) -> float:
    """Return an attribute that must be a finite number; ``where`` names file and element in errors."""
    if element.get(name) is None:
        raise DescriptionError(where, f"has no attribute {name!r}")
    return _numbers(element, name, 1, where)[0]


def _numbers(element: ET.Element, name: str, count: int, where: str) -> list[float]:
    text = element.get(name, "")
    try:
        # Python's digits may have underscores between them, a URDF's may not.
        values = [math.nan if "_" in word else float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(abs(value) <= MAX_NUMBER for value in values):
        wanted = "a finite number" if count == 1 else f"{count} finite numbers"
        raise DescriptionError(where, f"{name} must be {wanted}, not {text[:MAX_SHOWN]!r}")
    return values


def _macros(root: ET.Element) -> Iterator[str]:
    for element in root.iter():
        if element.tag.startswith(tuple(f"{{{namespace}}}" for namespace in XACRO_NAMESPACES)):
            yield f"the element <xacro:{element.tag.rpartition('}')[2]}>"
        yield from (f'{name}="{value}"' for name, value in element.attrib.items() if "${" in value or "$(" in value)


MOVABLE_TYPES = ("revolute", "continuous", "prismatic")

# A floating or planar base stays where the description puts it: nothing here drives one.
RESTING_TYPES = ("fixed", "floating", "planar")

# Time to the velocity limit for a joint without an acceleration limit: gentle for any servo arm.
DEFAULT_TIME_TO_FULL_SPEED_S = 0.4


@dataclass(frozen=True)
class Mimic:
    """Joint that follows ``joint``: at ``multiplier`` times its position, plus ``offset``."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Joint:
    """Joint of a URDF. Positions in rad (m when prismatic); rates per second, squared and cubed."""

    name: str
    type: str
    parent: str
    child: str
    lower: float
    upper: float
    max_velocity: float
    max_acceleration: float
    max_jerk: float | None = None
    # Joint that it follows, one with a position of its own; None for a joint that follows none.
    mimic: Mimic | None = None

    @property
    def moves(self) -> bool:
        """True for a joint that moves, be it with a position of its own or with another joint."""
        return self.type in MOVABLE_TYPES

    @property
    def movable(self) -> bool:
        """True for a joint with a position of its own."""
        return self.moves and self.mimic is None

    @property
    def unit(self) -> str:
        return "m" if self.type == "prismatic" else "rad"

    def degrees_hint(self, position: float) -> str:
        """Return the end of the sentence about a position beyond the limits; empty unless it may be in degrees."""
        meant_rad = math.radians(position)
        if self.unit != "rad" or abs(position) <= math.tau or not self.lower <= meant_rad <= self.upper:
            return ""
        return f"; positions are in radians: {position:.4g} degrees are {meant_rad:.4g} rad"


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint that replace the URDF's, in the units of :class:`Joint`; None for a limit that stays."""

    lower: float | None = None
    upper: float | None = None
    max_velocity: float | None = None
    max_acceleration: float | None = None
    max_jerk: float | None = None


@dataclass(frozen=True)
class Tree:
    """Links and joints."""

    name: str
    links: tuple[str, ...]  # link names: root first, each with all that it carries before the next
    joints: Mapping[str, Joint]  # joints by name, in the order of the URDF


def read_urdf(text: str, source: str, limits: Mapping[str, JointLimits]) -> Tree:
    """Read a URDF; some joints have limits that replace its own."""
    robot = root_of(text, source)
    if (count := len(robot.findall("link"))) > MAX_LINKS:
        raise DescriptionError(source, f"has {count} links, {MAX_LINKS} are allowed")
    _check_numbers(robot, source)
    joints: dict[str, Joint] = {}
    for element in robot.iterfind("joint"):
        joint = _joint(element, source, limits)
        if joint.name in joints:
            raise DescriptionError(source, f"has two joints of the name {joint.name!r}: rename one")
        joints[joint.name] = joint
    if not any(joint.movable for joint in joints.values()):
        *others, last = MOVABLE_TYPES
        raise DescriptionError(source, f"has no movable joint: no <joint> has the type {', '.join(others)} or {last}")
    joints = {name: _with_leader(joint, joints, source) for name, joint in joints.items()}
    return Tree(attribute(robot, "name", source), _links_from_root(robot, joints, source), joints)


def _check_numbers(robot: ET.Element, source: str) -> None:
    for part in robot:
        # The planning libraries read no <visual>.
        read = (each for each in part if part.tag in ("link", "joint") and each.tag != "visual")
        for element in itertools.chain.from_iterable(each.iter() for each in read):
            for name, count in NUMBERS.get(element.tag, {}).items():
                if element.get(name) is not None:
                    where = f"{source} {part.tag} {part.get('name')!r} <{element.tag}>"
                    values = _numbers(element, name, count, where)
                    # Published arms have such an axis at joints that are fixed.
                    if element.tag == "axis" and part.get("type") in MOVABLE_TYPES and not any(values):
                        raise DescriptionError(where, "xyz must not be 0 0 0, which is no direction")


def _joint(element: ET.Element, source: str, limits: Mapping[str, JointLimits]) -> Joint:
    name, kind = attribute(element, "name", source), attribute(element, "type", source)
    if kind not in MOVABLE_TYPES + RESTING_TYPES:
        known = ", ".join(MOVABLE_TYPES + RESTING_TYPES)
        raise DescriptionError(f"{source} joint {name!r}", f"has the unknown type {kind!r}: URDF knows {known}")
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise DescriptionError(source, f"joint {name!r} needs <parent> and <child>")
    mimic = _mimic(element, f"{source} joint {name!r} <mimic>")
    lower, upper, velocity, acceleration = 0.0, 0.0, 0.0, 0.0
    own = limits.get(name, JointLimits())
    if kind in MOVABLE_TYPES and mimic is None:
        where = f"{source} joint {name!r}"
        lower, upper = _range(element, where, kind, own)
        velocity = _velocity(element, where, name) if own.max_velocity is None else own.max_velocity
        acceleration = own.max_acceleration or velocity / DEFAULT_TIME_TO_FULL_SPEED_S
    return Joint(
        name=name,
        type=kind,
        parent=attribute(parent, "link", source),
        child=attribute(child, "link", source),
        lower=lower,
        upper=upper,
        max_velocity=velocity,
        max_acceleration=acceleration,
        max_jerk=own.max_jerk,
        mimic=mimic if kind in MOVABLE_TYPES else None,
    )


def _range(element: ET.Element, where: str, kind: str, own: JointLimits) -> tuple[float, float]:
    """Read the position limits of a movable joint; a continuous joint may turn half a turn either way."""
    if kind == "continuous":
        return -math.pi if own.lower is None else own.lower, math.pi if own.upper is None else own.upper
    limit = element.find("limit")
    if limit is None:
        raise DescriptionError(where, 'has no <limit>: add <limit lower="" upper="" velocity="" effort=""/>')
    # URDF: both are 0 where they are left out.
    lower, upper = (number(limit, end, f"{where} <limit>") if limit.get(end) else 0.0 for end in ("lower", "upper"))
    lower, upper = lower if own.lower is None else own.lower, upper if own.upper is None else own.upper
    if lower >= upper:
        raise DescriptionError(f"{where} <limit>", f"lower {lower:g} must be below upper {upper:g}")
    return lower, upper


def _velocity(element: ET.Element, where: str, name: str) -> float:
    limit = element.find("limit")
    remedy = f"correct it, or set max_velocity in [joints.{name}] of robot.toml"
    if limit is None or limit.get("velocity") is None:
        raise DescriptionError(where, f"has no velocity limit (<limit velocity>): {remedy}")
    velocity = number(limit, "velocity", f"{where} <limit>")
    if velocity <= 0.0:
        raise DescriptionError(f"{where} <limit>", f"velocity must be above 0, not {velocity:g}: {remedy}")
    return velocity


def _mimic(element: ET.Element, where: str) -> Mimic | None:
    mimic = element.find("mimic")
    if mimic is None:
        return None
    multiplier = number(mimic, "multiplier", where) if mimic.get("multiplier") else 1.0
    offset = number(mimic, "offset", where) if mimic.get("offset") else 0.0
    return Mimic(attribute(mimic, "joint", where), multiplier, offset)


def _with_leader(joint: Joint, joints: Mapping[str, Joint], source: str) -> Joint:
    """Return a joint that mimics the last joint of its chain of mimicking joints, which has a position of its own."""
    passed = [joint.name]
    while joint.mimic is not None:
        leader = joints.get(joint.mimic.joint)
        where = f"{source} joint {joint.name!r} <mimic>"
        if leader is None:
            raise DescriptionError(where, f"names the joint {joint.mimic.joint!r}, which does not exist")
        if leader.type not in MOVABLE_TYPES:
            raise DescriptionError(where, f"names the joint {leader.name!r}, which does not move ({leader.type})")
        if leader.name in passed:
            raise DescriptionError(where, f"leads back to the joint itself: {' -> '.join([*passed, leader.name])}")
        if leader.mimic is None:
            return joint
        passed.append(leader.name)
        share, own = leader.mimic, joint.mimic
        through = Mimic(share.joint, own.multiplier * share.multiplier, own.multiplier * share.offset + own.offset)
        joint = replace(joint, mimic=through)
    return joint


def _links_from_root(robot: ET.Element, joints: Mapping[str, Joint], source: str) -> tuple[str, ...]:
    """Return the link names, root first, parents before children, each branch as a whole."""
    names = [attribute(link, "name", source) for link in robot.iterfind("link")]
    if twice := next((name for name in names if names.count(name) > 1), ""):
        raise DescriptionError(source, f"has two links of the name {twice!r}: rename one")
    carried: dict[str, list[str]] = {name: [] for name in names}
    parent_of: dict[str, str] = {}
    for joint in joints.values():
        for link in (joint.child, joint.parent):
            if link not in carried:
                raise DescriptionError(source, f"joint {joint.name!r} names the link {link!r}, which does not exist")
        if joint.child in parent_of:
            raise DescriptionError(
                source, f"the link {joint.child!r} is the child of two joints, {joint.name!r} is one"
            )
        parent_of[joint.child] = joint.parent
        carried[joint.parent].append(joint.child)
    roots = [name for name in names if name not in parent_of]
    if len(roots) != 1:
        raise DescriptionError(source, f"must have exactly one root link, not {roots}")
    ordered: list[str] = []
    ahead = [roots[0]]
    while ahead:
        link = ahead.pop()
        ordered.append(link)
        ahead.extend(reversed(carried[link]))
    apart = [name for name in names if name not in set(ordered)]
    if apart:
        raise DescriptionError(source, f"the links {apart} are joined to one another in a ring and not to {roots[0]!r}")
    return tuple(ordered)


# Elements of a joint that a fixed one has no use for.
OF_MOVING_JOINTS = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")


def rotation_about(axis: Vector, angle_rad: float) -> Vector:
    """Compute a rotation matrix about a unit vector by Rodrigues' formula, shape (3, 3)."""
    x, y, z = axis.tolist()
    sin, cos = math.sin(angle_rad), math.cos(angle_rad)
    rest = 1.0 - cos
    return np.array(
        [
            [cos + x * x * rest, x * y * rest - z * sin, x * z * rest + y * sin],
            [x * y * rest + z * sin, cos + y * y * rest, y * z * rest - x * sin],
            [x * z * rest - y * sin, y * z * rest + x * sin, cos + z * z * rest],
        ]
    )


def unit_axis(element: ET.Element) -> Vector:
    """Return the axis of a URDF <joint>: a unit vector, shape (3,), along x where the joint has none."""
    axis = element.find("axis")
    values = np.array([float(v) for v in axis.get("xyz", "1 0 0").split()]) if axis is not None else np.eye(3)[0]
    length = float(np.linalg.norm(values))
    return values / length if length > 0.0 else np.eye(3)[0]


def origin_transform(element: ET.Element) -> Vector:
    """Return the URDF <origin> of an element, shape (4, 4) [m]: a translation, then fixed-axis roll, pitch and yaw."""
    transform = np.eye(4)
    origin = element.find("origin")
    if origin is not None:
        roll, pitch, yaw = (float(v) for v in origin.get("rpy", "0 0 0").split())
        x_axis, y_axis, z_axis = np.eye(3)
        transform[:3, :3] = rotation_about(z_axis, yaw) @ rotation_about(y_axis, pitch) @ rotation_about(x_axis, roll)
        transform[:3, 3] = [float(v) for v in origin.get("xyz", "0 0 0").split()]
    return transform


def roll_pitch_yaw(rotation: Vector) -> tuple[float, float, float]:
    """Return URDF's fixed-axis angles of a rotation matrix, shape (3, 3) [rad]; roll 0 at a quarter turn's pitch."""
    level = math.hypot(rotation[0, 0], rotation[1, 0])
    pitch = math.atan2(-rotation[2, 0], level)
    if level < 1e-9:
        return 0.0, pitch, math.atan2(-rotation[0, 1], rotation[1, 1])
    return math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0])


def joint_motion(axis: Vector, position: float, *, slides: bool) -> Vector:
    """Return the motion of a joint about or along its axis at a position [rad or m], shape (4, 4) [m]."""
    transform = np.eye(4)
    if slides:
        transform[:3, 3] = position * axis
    else:
        transform[:3, :3] = rotation_about(axis, position)
    return transform


def shift_origin(element: ET.Element, position: float) -> None:
    """Move the origin of a URDF <joint> by a position [rad, or m of a prismatic joint], which becomes its zero."""
    motion = joint_motion(unit_axis(element), position, slides=element.get("type") == "prismatic")
    transform = origin_transform(element) @ motion
    origin = element.find("origin")
    if origin is None:
        origin = ET.SubElement(element, "origin")
    origin.set("xyz", " ".join(map(repr, transform[:3, 3].tolist())))
    origin.set("rpy", " ".join(map(repr, roll_pitch_yaw(transform[:3, :3]))))


def with_fixed_joints(urdf: str, positions: Mapping[str, float]) -> str:
    """Return a URDF in which some joints are fixed at their positions [rad, or m of a prismatic joint]."""
    root = parsed(urdf)
    for element in root.findall("joint"):
        name = element.get("name", "")
        if name in positions:
            shift_origin(element, positions[name])
            for child in [*element]:
                if child.tag in OF_MOVING_JOINTS:
                    element.remove(child)
            element.set("type", "fixed")
    return ET.tostring(root, encoding="unicode")
