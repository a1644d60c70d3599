"""Robot description: links, joints, limits, groups and named states, read from any URDF and SRDF."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robot.description.meshes import check_meshes, package_path
from robot.description.srdf import Group as Group
from robot.description.srdf import Semantics, read_srdf, with_group
from robot.description.urdf import Joint as Joint
from robot.description.urdf import JointLimits as JointLimits
from robot.description.urdf import Tree, read_urdf, with_fixed_joints
from robot.errors import DescriptionError

NO_LIMITS: Mapping[str, JointLimits] = {}
NONE_HELD: Mapping[str, float] = {}

# Names of the states of a gripper's group, in small letters.
OPEN_STATES = ("open", "opened")
CLOSED_STATES = ("closed", "close")

PARK_STATE = "rest"  # state in which an arm is parked that names none
GRIPPER_GROUPS = ("gripper", "hand")  # names of a gripper's group in an SRDF without end effector, as Panda's


@dataclass(frozen=True)
class GripperModel:
    """Gripper of an arm."""

    joints: tuple[str, ...]  # its joints, one or two that mirror each other
    open: float  # position of each joint when it is open [rad or m]
    closed: float  # position of each joint when it is closed [rad or m]


@dataclass(frozen=True)
class Hull:
    """Convex hull that encloses a link."""

    vertices: NDArray[np.float64]  # shape (n, 3) [m], in the link's frame
    triangles: NDArray[np.int32]  # shape (m, 3), indices into `vertices`


@dataclass(frozen=True)
class LinkSurface:
    """Surface of a link, to the last triangle."""

    path: Path  # file of surfaces, see planners.geometry.surfaces
    link: str  # name of the link in the file


@dataclass(frozen=True)
class RobotModel:
    """Description of an arm, shared by planners, arm process and server."""

    name: str
    urdf: str
    srdf: str
    links: tuple[str, ...]  # link names, root first
    joints: Mapping[str, Joint]  # every joint by name, in the order of the URDF
    groups: Mapping[str, Group]
    # Group name -> state name -> joint name -> position [rad].
    named_states: Mapping[str, Mapping[str, Mapping[str, float]]]
    disabled_pairs: frozenset[frozenset[str]]  # pairs of links whose collision is not checked
    mesh_directory: Path | None = None  # base of the URDF's relative mesh paths; None for a URDF without meshes
    # Link name -> enclosing hull; empty to use the shapes of the URDF.
    hulls: Mapping[str, Hull] = field(default_factory=dict)
    # Link name -> vertices of convex parts that together cover the link's surface, shape (n, 3) each [m], in the link's
    # frame; for the cases in which a hull is too wide.
    parts: Mapping[str, tuple[NDArray[np.float64], ...]] = field(default_factory=dict)
    # Link name -> its surface, which decides the inside of the link.
    surfaces: Mapping[str, LinkSurface] = field(default_factory=dict)
    # Name of the root link's frame outside: the parent of the SRDF's virtual joint, or the root link.
    planning_frame: str = ""
    package_directories: tuple[Path, ...] = ()  # folders for `package://`, beside those around the URDF
    gripper: GripperModel | None = None
    default_group: str = ""  # group of goals that name none
    tip_link: str = ""  # link that pose goals of this group move; empty for a group that is no chain
    park_state: str = PARK_STATE  # name of the state in which the arm is parked; it need not exist

    @property
    def root_link(self) -> str:
        """Fixed link, which is the planning frame."""
        return self.links[0]

    @property
    def movable_joints(self) -> tuple[Joint, ...]:
        return tuple(joint for joint in self.joints.values() if joint.movable)


def load(
    urdf_path: Path,
    srdf_path: Path,
    package_directories: Sequence[Path] = (),
    limits: Mapping[str, JointLimits] = NO_LIMITS,
    *,
    held: Mapping[str, float] = NONE_HELD,
    needs_meshes: bool = True,
) -> RobotModel:
    """Read a robot from files; ``package://`` is also sought in ROS's environment, and around the URDF."""
    return parse(
        _text(urdf_path),
        _text(srdf_path),
        mesh_directory=urdf_path.resolve().parent,
        package_directories=(*package_directories, *package_path(os.environ)),
        limits=limits,
        held=held,
        needs_meshes=needs_meshes,
        sources=(f"URDF {urdf_path}", f"SRDF {srdf_path}"),
    )


def parse(
    urdf: str,
    srdf: str,
    *,
    mesh_directory: Path | None = None,
    package_directories: tuple[Path, ...] = (),
    limits: Mapping[str, JointLimits] = NO_LIMITS,
    held: Mapping[str, float] = NONE_HELD,
    needs_meshes: bool = True,
    sources: tuple[str, str] = ("URDF", "SRDF"),
) -> RobotModel:
    """Read a robot from the texts of its URDF and SRDF, whose sources are named in errors.

    Limits replace the URDF's. Held joints become fixed at their positions [rad or m]. Meshes must be there if needed.
    """
    tree = read_urdf(urdf, sources[0], limits)
    srdf = with_group(srdf, sources[1], tree)
    semantics = read_srdf(srdf, sources[1], tree)
    # Joints that nothing drives stay where they are least turned.
    passive = (tree.joints[name] for name in semantics.passive_joints)
    if still := {**{joint.name: min(max(0.0, joint.lower), joint.upper) for joint in passive}, **held}:
        urdf = with_fixed_joints(urdf, {**still, **_following_positions(tree, still)})
        tree = read_urdf(urdf, sources[0], limits)
        semantics = read_srdf(srdf, sources[1], tree)
    if mesh_directory is not None and needs_meshes:
        check_meshes(urdf, sources[0], mesh_directory, package_directories)
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
        package_directories=package_directories,
        planning_frame=semantics.planning_frame,
        gripper=_gripper(semantics, tree.joints, default_group),
        default_group=default_group,
        tip_link=semantics.groups[default_group].tip_link,
    )


def _following_positions(tree: Tree, still: Mapping[str, float]) -> dict[str, float]:
    return {
        joint.name: joint.mimic.multiplier * still[joint.mimic.joint] + joint.mimic.offset
        for joint in tree.joints.values()
        if joint.mimic is not None and joint.mimic.joint in still
    }


def _default_group(semantics: Semantics) -> str:
    """Return the group "arm", else the first that is a chain and no end effector, else the first."""
    ends = {end.group for end in semantics.end_effectors}
    chains = [name for name, group in semantics.groups.items() if group.tip_link and name not in ends]
    return "arm" if "arm" in semantics.groups else next(iter([*chains, *semantics.groups]))


def _gripper(semantics: Semantics, joints: Mapping[str, Joint], arm: str) -> GripperModel | None:
    """Return the gripper of a group: an end effector at its tip, of one or two joints, or a group named as one."""
    groups = semantics.groups
    hands = [end for end in semantics.end_effectors if end.group != arm]
    at_tip = [end.group for end in hands if end.parent_link == groups[arm].tip_link]
    chosen = at_tip or [end.group for end in hands if len(hands) == 1]
    for name in chosen or GRIPPER_GROUPS:
        members = groups[name].joints if name in groups else ()
        if len(members) not in (1, 2) or set(members) & set(groups[arm].joints):
            continue
        states = {state.lower(): values for state, values in semantics.named_states.get(name, {}).items()}
        ends = {_ends(joints[member], states) for member in members}
        # Two fingers move alike: a gripper has one position.
        if len(ends) == 1:
            return GripperModel(members, *ends.pop())
    return None


def _ends(joint: Joint, states: Mapping[str, Mapping[str, float]]) -> tuple[float, float]:
    opened, closed = (
        next((states[name][joint.name] for name in names if joint.name in states.get(name, {})), limit)
        for names, limit in ((OPEN_STATES, joint.upper), (CLOSED_STATES, joint.lower))
    )
    return opened, closed


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(path), f"cannot be read: {error}") from error
