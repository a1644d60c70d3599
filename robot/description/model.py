"""Robot description: links, joints, limits, groups and named states, read from any URDF and SRDF."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from robot.errors import DescriptionError

MOVABLE_TYPES = ("revolute", "continuous", "prismatic")

NO_LIMITS: Mapping[str, JointLimits] = MappingProxyType({})

# Time to the velocity limit for a joint without an acceleration limit: gentle for any servo arm.
DEFAULT_TIME_TO_FULL_SPEED_S = 0.4


@dataclass(frozen=True)
class Joint:
    """Joint of a URDF. Positions in rad (m when prismatic); rates per second and per second squared."""

    name: str
    type: str
    parent: str
    child: str
    lower: float
    upper: float
    max_velocity: float
    max_acceleration: float
    max_jerk: float | None = None

    @property
    def movable(self) -> bool:
        """True for a joint with a position of its own."""
        return self.type in MOVABLE_TYPES


@dataclass(frozen=True)
class Group:
    """Planning group of the SRDF: joints that move together, from ``base_link`` to ``tip_link``."""

    name: str
    joints: tuple[str, ...]
    base_link: str
    tip_link: str


@dataclass(frozen=True)
class Gripper:
    """Gripper of an arm.

    Attributes:
        joints: its joints, one or two that mirror each other.
        open: position of each joint when it is open [rad or m].
        closed: position of each joint when it is closed [rad or m].
    """

    joints: tuple[str, ...]
    open: float
    closed: float


@dataclass(frozen=True)
class JointLimits:
    """Limits of a joint from beside its URDF; None where the URDF's count.

    Attributes:
        lower: lower limit [rad or m].
        upper: upper limit [rad or m].
        max_velocity: [rad/s or m/s].
        max_acceleration: [rad/s^2 or m/s^2].
        max_jerk: [rad/s^3 or m/s^3].
    """

    lower: float | None = None
    upper: float | None = None
    max_velocity: float | None = None
    max_acceleration: float | None = None
    max_jerk: float | None = None


@dataclass(frozen=True)
class Hull:
    """Convex hull that encloses a link.

    Attributes:
        vertices: shape (n, 3) [m], in the link's frame.
        triangles: shape (m, 3), indices into ``vertices``.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]


@dataclass(frozen=True)
class RobotModel:
    """Description of an arm, shared by planners, arm process and server.

    Attributes:
        urdf: text of the URDF.
        srdf: text of the SRDF.
        mesh_directory: base of the URDF's relative mesh paths; None for a URDF without meshes.
        links: link names, root first.
        joints: every joint by name, in the order of the URDF.
        groups: planning groups by name.
        named_states: group name -> state name -> joint name -> position [rad].
        disabled_pairs: pairs of links whose collision is not checked.
        hulls: link name -> enclosing hull; empty when the shapes of the URDF are to be used.
        parts: link name -> vertices of convex parts that together cover the link's surface, shape (n, 3) each [m], in
            the link's frame; for the cases in which a hull is too wide.
        gripper: the gripper; None for an arm without one.
        default_group: group of goals that name none.
        tip_link: link that pose goals of this group move.
        held_joints: joint -> position at which it stays, for joints that are not driven [rad or m].
        package_directories: folders of packages that ``package://`` names.
    """

    name: str
    urdf: str
    srdf: str
    links: tuple[str, ...]
    joints: Mapping[str, Joint]
    groups: Mapping[str, Group]
    named_states: Mapping[str, Mapping[str, Mapping[str, float]]]
    disabled_pairs: frozenset[frozenset[str]]
    mesh_directory: Path | None = None
    hulls: Mapping[str, Hull] = field(default_factory=dict)
    parts: Mapping[str, tuple[NDArray[np.float64], ...]] = field(default_factory=dict)
    gripper: Gripper | None = None
    default_group: str = ""
    tip_link: str = ""
    held_joints: Mapping[str, float] = field(default_factory=dict)
    package_directories: tuple[Path, ...] = ()

    @property
    def root_link(self) -> str:
        """Fixed link, which is the planning frame."""
        return self.links[0]

    @property
    def movable_joints(self) -> tuple[Joint, ...]:
        """Joints with a position, in the order of the URDF."""
        return tuple(joint for joint in self.joints.values() if joint.movable)

    @property
    def driven_joints(self) -> tuple[Joint, ...]:
        """Movable joints that are driven, in the order of the URDF."""
        return tuple(joint for joint in self.movable_joints if joint.name not in self.held_joints)


def load(urdf_path: Path, srdf_path: Path, limits: Mapping[str, JointLimits] = NO_LIMITS) -> RobotModel:
    """Read a robot from files.

    Args:
        urdf_path: the URDF, whose folder its relative mesh paths begin at.
        srdf_path: the SRDF.
        limits: limits by joint that replace the URDF's.

    Raises:
        DescriptionError: a file cannot be read or does not describe an arm.
    """
    return parse(_text(urdf_path), _text(srdf_path), mesh_directory=urdf_path.resolve().parent, limits=limits)


def parse(
    urdf: str,
    srdf: str,
    *,
    mesh_directory: Path | None = None,
    hulls: Mapping[str, Hull] | None = None,
    parts: Mapping[str, tuple[NDArray[np.float64], ...]] | None = None,
    limits: Mapping[str, JointLimits] = NO_LIMITS,
) -> RobotModel:
    """Read a robot from the texts of its URDF and SRDF.

    Args:
        urdf: text of the URDF.
        srdf: text of the SRDF.
        mesh_directory: base of relative mesh paths.
        hulls: as of :class:`RobotModel`.
        parts: likewise.
        limits: limits by joint that replace the URDF's.

    Raises:
        DescriptionError: a text does not parse, or misses what planning needs.
    """
    robot = _root(urdf, "URDF")
    semantics = _root(srdf, "SRDF")
    joints = {joint.name: joint for joint in (_joint(element, limits) for element in robot.iterfind("joint"))}
    if not any(joint.movable for joint in joints.values()):
        *others, last = MOVABLE_TYPES
        raise DescriptionError("URDF", f"has no movable joint: no <joint> has the type {', '.join(others)} or {last}")
    links = _links_from_root(robot, joints)
    groups = _groups(semantics, joints)
    default_group = "arm" if "arm" in groups else next(iter(groups))
    return RobotModel(
        name=robot.get("name", "robot"),
        urdf=urdf,
        srdf=srdf,
        links=links,
        joints=joints,
        groups=groups,
        named_states=_named_states(semantics, joints),
        disabled_pairs=frozenset(
            frozenset((_attribute(pair, "link1", "SRDF"), _attribute(pair, "link2", "SRDF")))
            for pair in semantics.iterfind("disable_collisions")
        ),
        mesh_directory=mesh_directory,
        hulls=hulls or {},
        parts=parts or {},
        default_group=default_group,
        tip_link=groups[default_group].tip_link,
    )


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(path), f"cannot be read: {error}") from error


def _root(text: str, kind: str) -> ET.Element:
    try:
        root = ET.fromstring(text)  # noqa: S314 - the user's own file, given on the command line
    except ET.ParseError as error:
        raise DescriptionError(kind, f"is not XML: {error}") from error
    if root.tag != "robot":
        raise DescriptionError(kind, f"must start with <robot>, not <{root.tag}>")
    return root


def _attribute(element: ET.Element, name: str, kind: str) -> str:
    value = element.get(name)
    if value is None:
        raise DescriptionError(kind, f"<{element.tag}> {element.attrib} has no attribute {name!r}")
    return value


def _number(element: ET.Element, name: str, where: str) -> float:
    text = element.get(name)
    if text is None:
        raise DescriptionError(where, f"has no attribute {name!r}")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DescriptionError(where, f"{name} must be a finite number, not {text!r}")
    return value


def _joint(element: ET.Element, all_limits: Mapping[str, JointLimits]) -> Joint:
    name = _attribute(element, "name", "URDF")
    kind = _attribute(element, "type", "URDF")
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise DescriptionError("URDF", f"joint {name!r} needs <parent> and <child>")
    lower, upper, velocity, acceleration = 0.0, 0.0, 0.0, 0.0
    limits = all_limits.get(name, JointLimits())
    if kind in MOVABLE_TYPES:
        lower, upper, velocity = _limits(element, name, kind, limits)
        acceleration = limits.max_acceleration or velocity / DEFAULT_TIME_TO_FULL_SPEED_S
    return Joint(
        name=name,
        type=kind,
        parent=_attribute(parent, "link", "URDF"),
        child=_attribute(child, "link", "URDF"),
        lower=lower,
        upper=upper,
        max_velocity=velocity,
        max_acceleration=acceleration,
        max_jerk=limits.max_jerk,
    )


def _limits(element: ET.Element, name: str, kind: str, limits: JointLimits) -> tuple[float, float, float]:
    """Read lower, upper and velocity limit of a movable joint; a continuous joint may turn half a turn either way."""
    where = f"URDF joint {name!r} <limit>"
    limit = element.find("limit")
    if limit is None:
        raise DescriptionError("URDF", f"joint {name!r} has no <limit>")
    velocity = limits.max_velocity or _number(limit, "velocity", where)
    if velocity <= 0.0:
        raise DescriptionError(where, f"velocity must be above 0, not {velocity:g}")
    if kind == "continuous":
        return -math.pi, math.pi, velocity
    lower = _number(limit, "lower", where) if limits.lower is None else limits.lower
    upper = _number(limit, "upper", where) if limits.upper is None else limits.upper
    if lower >= upper:
        raise DescriptionError(where, f"lower {lower:g} must be below upper {upper:g}")
    return lower, upper, velocity


def _links_from_root(robot: ET.Element, joints: Mapping[str, Joint]) -> tuple[str, ...]:
    """Return the link names, root first, parents before children."""
    names = [_attribute(link, "name", "URDF") for link in robot.iterfind("link")]
    parent_of = {joint.child: joint.parent for joint in joints.values()}
    for child, parent in parent_of.items():
        for link in (child, parent):
            if link not in names:
                raise DescriptionError("URDF", f"a joint names the link {link!r}, which does not exist")
    roots = [name for name in names if name not in parent_of]
    if len(roots) != 1:
        raise DescriptionError("URDF", f"must have exactly one root link, not {roots}")
    ordered = list(roots)
    for link in ordered:
        ordered.extend(child for child, parent in parent_of.items() if parent == link)
    return tuple(ordered)


def _chain(joints: Mapping[str, Joint], base_link: str, tip_link: str, group: str) -> tuple[Joint, ...]:
    """Return the joints from ``base_link`` to ``tip_link``, base first."""
    by_child = {joint.child: joint for joint in joints.values()}
    chain: list[Joint] = []
    link = tip_link
    while link != base_link:
        if link not in by_child:
            raise DescriptionError("SRDF", f"group {group!r}: no chain leads from {base_link!r} to {tip_link!r}")
        chain.append(by_child[link])
        link = by_child[link].parent
    return tuple(reversed(chain))


def _groups(semantics: ET.Element, joints: Mapping[str, Joint]) -> dict[str, Group]:
    groups = {}
    for element in semantics.iterfind("group"):
        name = _attribute(element, "name", "SRDF")
        chain = element.find("chain")
        members: tuple[Joint, ...]
        if chain is not None:
            base, tip = _attribute(chain, "base_link", "SRDF"), _attribute(chain, "tip_link", "SRDF")
            members = _chain(joints, base, tip, name)
        else:
            names = [_attribute(joint, "name", "SRDF") for joint in element.iterfind("joint")]
            unknown = [joint for joint in names if joint not in joints]
            if unknown or not names:
                raise DescriptionError(
                    "SRDF", f"group {name!r} needs a <chain> or <joint>s of the URDF; unknown: {unknown}"
                )
            members = tuple(joints[joint] for joint in names)
            base, tip = members[0].parent, members[-1].child
        movable = tuple(joint.name for joint in members if joint.movable)
        groups[name] = Group(name, movable, base, tip)
    if not groups:
        raise DescriptionError("SRDF", "has no <group>")
    return groups


def _named_states(semantics: ET.Element, joints: Mapping[str, Joint]) -> dict[str, dict[str, dict[str, float]]]:
    states: dict[str, dict[str, dict[str, float]]] = {}
    for element in semantics.iterfind("group_state"):
        name, group = _attribute(element, "name", "SRDF"), _attribute(element, "group", "SRDF")
        positions = {}
        for joint in element.iterfind("joint"):
            joint_name = _attribute(joint, "name", "SRDF")
            if joint_name not in joints:
                raise DescriptionError("SRDF", f"group_state {name!r} names the unknown joint {joint_name!r}")
            positions[joint_name] = _number(joint, "value", f"SRDF group_state {name!r} joint {joint_name!r}")
        states.setdefault(group, {})[name] = positions
    return states
