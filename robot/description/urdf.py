"""Links and joints of a URDF, with their limits."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, replace

from robot.description.elements import attribute, number, root_of
from robot.errors import DescriptionError

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
        """Unit of its positions."""
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


NO_LIMITS = JointLimits()


@dataclass(frozen=True)
class Tree:
    """Links and joints."""

    name: str
    links: tuple[str, ...]  # link names: root first, each with all that it carries before the next
    joints: Mapping[str, Joint]  # joints by name, in the order of the URDF


def read_urdf(text: str, source: str, limits: Mapping[str, JointLimits]) -> Tree:
    """Read a URDF; some joints have limits that replace its own."""
    robot = root_of(text, source)
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
    return Tree(robot.get("name", "robot"), _links_from_root(robot, joints, source), joints)


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
    own = limits.get(name, NO_LIMITS)
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
