"""One description of several arms: their URDFs and SRDFs with prefixed names, side by side on one fixed link.

Links, joints, materials and groups of the arm ``left`` begin with ``left_``. A group of all arms' default groups,
``both_arms`` or ``all_arms``, has the named states that every arm has under the same name.
"""

import itertools
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from robot.description import model
from robot.description.meshes import find_mesh
from robot.description.model import GripperModel, Joint, JointLimits, RobotModel
from robot.description.urdf import origin_transform, parsed
from robot.errors import DescriptionError

COMMON_LINK = "world"  # the link on which all arms stand, which is the planning frame

BOTH_ARMS, ALL_ARMS = "both_arms", "all_arms"

# Attributes of a URDF that name something of the arm, by the element.
_URDF_NAMES = {
    "link": ("name",),
    "joint": ("name",),
    "material": ("name",),
    "parent": ("link",),
    "child": ("link",),
    "mimic": ("joint",),
}
# The same for an SRDF.
_SRDF_NAMES = {
    "group": ("name",),
    "joint": ("name",),
    "link": ("name",),
    "passive_joint": ("name",),
    "chain": ("base_link", "tip_link"),
    "group_state": ("group",),
    "end_effector": ("name", "group", "parent_link", "parent_group"),
    "disable_collisions": ("link1", "link2"),
    "enable_collisions": ("link1", "link2"),
    "disable_default_collisions": ("link",),
}
# What simulators and drivers of others read; names in it would have to be prefixed too.
_OF_OTHERS = ("gazebo", "transmission", "ros2_control", "sensor")


@dataclass(frozen=True)
class PlacedArm:
    """Arm at its place."""

    robot: RobotModel  # its description, as by prefixed
    base_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # origin of its root link in the common frame [m]
    # Fixed-axis roll, pitch and yaw of its root link there [rad].
    base_rpy_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)


def prefixed(robot: RobotModel, name: str) -> RobotModel:
    """Return an arm whose names of links, joints and groups begin with ``name_``."""
    prefix = f"{name}_"
    packages = robot.package_directories
    if robot.mesh_directory is not None:
        packages = (*packages, robot.mesh_directory.parent)
    renamed = model.parse(
        _text(_renamed_urdf(robot, name, prefix)),
        _text(_renamed_srdf(robot, name, prefix)),
        package_directories=packages,
        limits={prefix + joint.name: _limits(joint) for joint in robot.joints.values() if joint.movable},
        sources=(f"URDF of arm {name}", f"SRDF of arm {name}"),
    )
    gripper = robot.gripper
    return replace(
        renamed,
        **_shapes([robot], prefix),
        gripper=None
        if gripper is None
        else GripperModel(tuple(prefix + joint for joint in gripper.joints), gripper.open, gripper.closed),
        default_group=prefix + robot.default_group,
        tip_link=robot.tip_link and prefix + robot.tip_link,
        park_state=robot.park_state,
    )


def joined(name: str, arms: Mapping[str, PlacedArm]) -> RobotModel:
    """Return the description of several arms by name; the first gives default group, tip and gripper."""
    urdf, srdf = ET.Element("robot", name=name), ET.Element("robot", name=name)
    ET.SubElement(urdf, "link", name=COMMON_LINK)
    for arm, placed in arms.items():
        mount = ET.SubElement(urdf, "joint", name=f"{arm}_mount", type="fixed")
        ET.SubElement(mount, "origin", xyz=_numbers(placed.base_xyz_m), rpy=_numbers(placed.base_rpy_rad))
        ET.SubElement(mount, "parent", link=COMMON_LINK)
        ET.SubElement(mount, "child", link=placed.robot.root_link)
        urdf.extend(parsed(placed.robot.urdf))
        srdf.extend(parsed(placed.robot.srdf))
    if len(arms) > 1:
        srdf.extend(_group_of_all([placed.robot for placed in arms.values()]))
    srdf.extend(_never_near(arms))
    robots = [placed.robot for placed in arms.values()]
    whole = model.parse(
        _text(urdf),
        _text(srdf),
        package_directories=tuple(dict.fromkeys(folder for robot in robots for folder in robot.package_directories)),
        limits={joint.name: _limits(joint) for robot in robots for joint in robot.joints.values() if joint.movable},
        sources=("URDF of all arms", "SRDF of all arms"),
    )
    first = robots[0]
    return replace(
        whole,
        **_shapes(robots),
        gripper=first.gripper,
        default_group=first.default_group,
        tip_link=first.tip_link,
        park_state=first.park_state,
    )


def _shapes(robots: Sequence[RobotModel], prefix: str = "") -> dict[str, Any]:
    """Return hulls, parts and surfaces of some robots by link, whose names get a prefix."""
    kinds = ("hulls", "parts", "surfaces")
    return {
        kind: {prefix + link: shape for robot in robots for link, shape in getattr(robot, kind).items()}
        for kind in kinds
    }


def _renamed_urdf(robot: RobotModel, name: str, prefix: str) -> ET.Element:
    root = parsed(robot.urdf)
    root.set("name", name)
    for tag in _OF_OTHERS:
        for element in root.findall(tag):
            root.remove(element)
    _rename(root, _URDF_NAMES, prefix)
    for mesh in root.iter("mesh"):
        mesh.set("filename", _mesh_name(robot, mesh.get("filename", "")))
    return root


def _mesh_name(robot: RobotModel, filename: str) -> str:
    """Return the name of a mesh that means the same file beside the files of other arms: a package's URL."""
    directory = robot.mesh_directory
    if directory is None or "://" in filename or Path(filename).is_absolute():
        return filename
    try:
        find_mesh(filename, directory, robot.package_directories)
    except DescriptionError:
        # A visual mesh may be missing; the log of the start names it.
        return filename
    return f"package://{directory.name}/{filename.removeprefix('./')}"


def _renamed_srdf(robot: RobotModel, name: str, prefix: str) -> ET.Element:
    root = parsed(robot.srdf)
    root.set("name", name)
    virtual = {element.get("name") for element in root.iterfind("virtual_joint")}
    for element in root.findall("virtual_joint"):
        root.remove(element)
    for parent in [root, *root.iter("group"), *root.iter("group_state")]:
        for joint in [
            each for each in parent if each.tag in ("joint", "passive_joint") and each.get("name") in virtual
        ]:
            parent.remove(joint)
    _rename(root, _SRDF_NAMES, prefix)
    return root


def _rename(root: ET.Element, names: Mapping[str, Sequence[str]], prefix: str) -> None:
    for element in root.iter():
        for attribute in names.get(element.tag, ()):
            if (value := element.get(attribute)) is not None:
                element.set(attribute, prefix + value)


def _group_of_all(robots: Sequence[RobotModel]) -> Iterator[ET.Element]:
    name = BOTH_ARMS if len(robots) == 2 else ALL_ARMS
    group = ET.Element("group", name=name)
    for robot in robots:
        ET.SubElement(group, "group", name=robot.default_group)
    yield group
    states = [robot.named_states.get(robot.default_group, {}) for robot in robots]
    for state in states[0]:
        if all(state in each for each in states):
            element = ET.Element("group_state", name=state, group=name)
            for each in states:
                for joint, position in each[state].items():
                    ET.SubElement(element, "joint", name=joint, value=repr(position))
            yield element


def _never_near(arms: Mapping[str, PlacedArm]) -> Iterator[ET.Element]:
    """Yield the pairs of links that are never checked: of arms too far from each other to touch."""
    reaches_m = {name: reach_m(placed.robot) for name, placed in arms.items()}
    for (name, first), (other, second) in itertools.combinations(arms.items(), 2):
        apart_m = math.dist(first.base_xyz_m, second.base_xyz_m)
        if apart_m > reaches_m[name] + reaches_m[other]:
            for link, another in itertools.product(first.robot.links, second.robot.links):
                yield ET.Element("disable_collisions", link1=link, link2=another, reason="Never")


def reach_m(robot: RobotModel) -> float:
    """Return a distance from the root link beyond which no part of an arm comes: its longest chain, or infinite [m]."""
    extents_m = {link.get("name", ""): _extent_m(link, robot) for link in parsed(robot.urdf).iterfind("link")}
    return max(length_m + extents_m[link] for link, length_m in chain_lengths_m(robot).items())


def chain_lengths_m(robot: RobotModel) -> dict[str, float]:
    """Return for each link the length of the stretched chain from the root link to its frame [m]."""
    lengths_m = {robot.root_link: 0.0}
    elements = {joint.get("name"): joint for joint in parsed(robot.urdf).iterfind("joint")}
    by_child = {joint.child: joint for joint in robot.joints.values()}
    # Root first, each with what it carries.
    for link in robot.links[1:]:
        joint = by_child[link]
        slides_m = max(abs(joint.lower), abs(joint.upper)) if joint.type == "prismatic" else 0.0
        length_m = math.hypot(*origin_transform(elements[joint.name])[:3, 3])
        lengths_m[link] = lengths_m[joint.parent] + length_m + slides_m
    return lengths_m


def _extent_m(link: ET.Element, robot: RobotModel) -> float:
    """Return a distance from a link's frame that no collision shape of it exceeds [m]."""
    hull = robot.hulls.get(link.get("name", ""))
    if hull is not None and len(hull.vertices):
        return max(math.hypot(*vertex) for vertex in hull.vertices.tolist())
    return max((_shape_extent_m(shape) for shape in link.iterfind("collision")), default=0.0)


def _shape_extent_m(shape: ET.Element) -> float:
    from_frame_m = math.hypot(*origin_transform(shape)[:3, 3])
    for kind in shape.iterfind("geometry/*"):
        values = {name: [float(value) for value in text.split()] for name, text in kind.items() if name != "filename"}
        match kind.tag:
            case "box":
                return from_frame_m + math.hypot(*values["size"]) / 2.0
            case "sphere":
                return from_frame_m + values["radius"][0]
            case "cylinder" | "capsule":
                return from_frame_m + values["radius"][0] + values["length"][0] / 2.0
    return math.inf


def _limits(joint: Joint) -> JointLimits:
    return JointLimits(joint.lower, joint.upper, joint.max_velocity, joint.max_acceleration, joint.max_jerk)


def _numbers(values: Sequence[float]) -> str:
    return " ".join(map(repr, values))


def _text(root: ET.Element) -> str:
    return ET.tostring(root, encoding="unicode")
