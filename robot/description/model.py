"""Robot description: links, joints, limits, groups and named states, read from any URDF and SRDF."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from robot.description.mesh_files import check_meshes, package_path
from robot.description.srdf import Group as Group
from robot.description.srdf import Semantics, read_srdf
from robot.description.urdf import Joint as Joint
from robot.description.urdf import JointLimits as JointLimits
from robot.description.urdf import Tree, read_urdf
from robot.errors import DescriptionError

NO_LIMITS: Mapping[str, JointLimits] = MappingProxyType({})


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
        tip_link: link that pose goals of this group move; empty where the group's joints are not one chain.
        held_joints: joint -> position at which it stays, for joints that are not driven [rad or m].
        package_directories: folders of packages that ``package://`` names, beside those around the URDF.
        planning_frame: name of the root link's frame outside: the parent of the SRDF's virtual joint, or the root link.
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
    planning_frame: str = ""

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


def load(
    urdf_path: Path,
    srdf_path: Path,
    limits: Mapping[str, JointLimits] = NO_LIMITS,
    *,
    package_directories: Sequence[Path] = (),
    with_meshes: bool = True,
) -> RobotModel:
    """Read a robot from files.

    Args:
        urdf_path: the URDF, whose folder its relative mesh paths begin at.
        srdf_path: the SRDF.
        limits: limits by joint that replace the URDF's.
        package_directories: folders for ``package://``, beside those of the ROS environment and around the URDF.
        with_meshes: the meshes have to be there; not where hulls stand in for them.

    Raises:
        DescriptionError: a file cannot be read or does not describe an arm, or a mesh is not there.
    """
    directory, packages = urdf_path.resolve().parent, (*package_directories, *package_path(os.environ))
    sources = f"URDF {urdf_path}", f"SRDF {srdf_path}"
    robot = parse(
        _text(urdf_path),
        _text(srdf_path),
        mesh_directory=directory,
        package_directories=packages,
        limits=limits,
        sources=sources,
    )
    if with_meshes:
        check_meshes(robot.urdf, sources[0], directory, packages)
    return robot


def parse(
    urdf: str,
    srdf: str,
    *,
    mesh_directory: Path | None = None,
    package_directories: tuple[Path, ...] = (),
    hulls: Mapping[str, Hull] | None = None,
    parts: Mapping[str, tuple[NDArray[np.float64], ...]] | None = None,
    limits: Mapping[str, JointLimits] = NO_LIMITS,
    sources: tuple[str, str] = ("URDF", "SRDF"),
) -> RobotModel:
    """Read a robot from the texts of its URDF and SRDF.

    Args:
        urdf: text of the URDF.
        srdf: text of the SRDF.
        mesh_directory: base of relative mesh paths.
        package_directories: as of :class:`RobotModel`.
        hulls: likewise.
        parts: likewise.
        limits: limits by joint that replace the URDF's.
        sources: names of the URDF and of the SRDF, for errors.

    Raises:
        DescriptionError: a text does not parse, or misses what planning needs.
    """
    tree = read_urdf(urdf, sources[0], limits)
    semantics = read_srdf(srdf, sources[1], tree)
    default_group = _default_group(semantics)
    return RobotModel(
        name=tree.name,
        urdf=urdf,
        srdf=srdf,
        links=tree.links,
        joints=tree.joints,
        groups=semantics.groups,
        named_states=semantics.named_states,
        disabled_pairs=semantics.disabled_pairs,
        mesh_directory=mesh_directory,
        hulls=hulls or {},
        parts=parts or {},
        gripper=_gripper(tree, semantics, default_group),
        default_group=default_group,
        tip_link=semantics.groups[default_group].tip_link,
        # Nothing drives them: they rest where they are least turned.
        held_joints={name: _nearest_to_zero(tree.joints[name]) for name in semantics.passive_joints},
        package_directories=package_directories,
        planning_frame=semantics.planning_frame,
    )


def _default_group(semantics: Semantics) -> str:
    """Return the group "arm", else the first that is one chain and no end effector, else the first."""
    if "arm" in semantics.groups:
        return "arm"
    effectors = {effector.group for effector in semantics.end_effectors}
    chains = [name for name, group in semantics.groups.items() if group.tip_link]
    return next(name for name in [*(n for n in chains if n not in effectors), *chains, *semantics.groups])


def _gripper(tree: Tree, semantics: Semantics, arm: str) -> Gripper | None:
    """Return the gripper that the SRDF describes: an end effector, or a group "gripper" or "hand", of a joint or two.

    Of several, that at the arm's tip; open and closed by their named states, else by the limits.
    """
    tip, groups = semantics.groups[arm].tip_link, semantics.groups
    hands = [effector for effector in semantics.end_effectors if effector.group != arm]
    at_tip = [effector.group for effector in hands if effector.parent_link == tip]
    others = [effector.group for effector in hands if effector.parent_link != tip]
    effectors = at_tip or (others if len(others) == 1 else [])
    for name in effectors or ("gripper", "hand"):
        joints = groups[name].joints if name in groups else ()
        if not 1 <= len(joints) <= 2 or set(joints) & set(groups[arm].joints):
            continue
        ends = [_ends(tree.joints[joint], semantics.named_states.get(name, {})) for joint in joints]
        if len(set(ends)) == 1:
            return Gripper(joints, *ends[0])
    return None


def _ends(joint: Joint, states: Mapping[str, Mapping[str, float]]) -> tuple[float, float]:
    """Return where a joint of a gripper is when it is open and when it is closed [rad or m]."""
    closed = {name: states.get(name, {}).get(joint.name) for name in ("closed", "close")}
    opened = states.get("open", {}).get(joint.name)
    shut = next((position for position in closed.values() if position is not None), None)
    return joint.upper if opened is None else opened, joint.lower if shut is None else shut


def _nearest_to_zero(joint: Joint) -> float:
    return min(max(0.0, joint.lower), joint.upper)


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(path), f"cannot be read: {error}") from error
