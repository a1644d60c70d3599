"""Robot description: links, joints, limits, groups and named states, read from any URDF and SRDF."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robot.description.mesh_files import check_meshes, package_path
from robot.description.srdf import Group as Group
from robot.description.srdf import read_srdf
from robot.description.urdf import Joint as Joint
from robot.description.urdf import JointLimits, read_urdf
from robot.errors import DescriptionError


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
        package_directories: folders for ``package://``, beside those around the URDF.
        links: link names, root first.
        joints: every joint by name, in the order of the URDF.
        groups: planning groups by name.
        named_states: group name -> state name -> joint name -> position [rad].
        disabled_pairs: pairs of links whose collision is not checked.
        hulls: link name -> enclosing hull; empty when the shapes of the URDF are to be used.
        parts: link name -> vertices of convex parts that together cover the link's surface, shape (n, 3) each [m], in
            the link's frame; for the cases in which a hull is too wide.
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
    planning_frame: str = ""
    package_directories: tuple[Path, ...] = ()

    @property
    def root_link(self) -> str:
        """Fixed link, which is the planning frame."""
        return self.links[0]

    @property
    def movable_joints(self) -> tuple[Joint, ...]:
        """Joints with a position, in the order of the URDF."""
        return tuple(joint for joint in self.joints.values() if joint.movable)


def builtin() -> RobotModel:
    """Load the SO-101 follower that is shipped with the package."""
    folder = resources.files("robot.description")
    hulls = json.loads((folder / "so101_hulls.json").read_text())["links"]
    parts = json.loads((folder / "so101_parts.json").read_text())["links"]
    return parse(
        (folder / "so101.urdf").read_text(),
        (folder / "so101.srdf").read_text(),
        hulls={name: _hull(shape) for name, shape in hulls.items()},
        parts={name: tuple(np.array(vertices) for vertices in shapes) for name, shapes in parts.items()},
    )


def load(urdf_path: Path, srdf_path: Path, package_directories: Sequence[Path] = ()) -> RobotModel:
    """Read a robot from files.

    Args:
        urdf_path: URDF.
        srdf_path: SRDF.
        package_directories: folders for ``package://``, beside those of the ROS environment and around the URDF.

    Raises:
        DescriptionError: a file cannot be read or does not describe an arm, or a mesh is not there.
    """
    return parse(
        _text(urdf_path),
        _text(srdf_path),
        mesh_directory=urdf_path.resolve().parent,
        package_directories=(*package_directories, *package_path(os.environ)),
        sources=(f"URDF {urdf_path}", f"SRDF {srdf_path}"),
    )


def parse(
    urdf: str,
    srdf: str,
    *,
    mesh_directory: Path | None = None,
    package_directories: tuple[Path, ...] = (),
    hulls: Mapping[str, Hull] | None = None,
    parts: Mapping[str, tuple[NDArray[np.float64], ...]] | None = None,
    limits: Mapping[str, JointLimits] | None = None,
    sources: tuple[str, str] = ("URDF", "SRDF"),
) -> RobotModel:
    """Read a robot from the texts of its URDF and SRDF.

    Args:
        urdf: text of the URDF.
        srdf: text of the SRDF.
        mesh_directory: see :class:`RobotModel`.
        package_directories: see :class:`RobotModel`.
        hulls: see :class:`RobotModel`.
        parts: see :class:`RobotModel`.
        limits: limits by joint that replace those of the URDF; None for the limits of the SO-101's servos, since the
            velocity limits of its URDFs in circulation are placeholders of 10 rad/s.
        sources: names of the URDF and of the SRDF, for errors.

    Raises:
        DescriptionError: a text does not parse, or misses what planning needs; with a mesh directory and without
            hulls, a mesh is not there.
    """
    tree = read_urdf(urdf, sources[0], _servo_limits() if limits is None else limits)
    semantics = read_srdf(srdf, sources[1], tree)
    if mesh_directory is not None and not hulls:
        check_meshes(urdf, sources[0], mesh_directory, package_directories)
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
        hulls=hulls or {},
        parts=parts or {},
        planning_frame=semantics.planning_frame,
    )


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise DescriptionError(str(path), f"cannot be read: {error}") from error


def _hull(shape: Mapping[str, list[list[float]]]) -> Hull:
    return Hull(np.asarray(shape["vertices"], dtype=np.float64), np.asarray(shape["triangles"], dtype=np.int32))


def _servo_limits() -> Mapping[str, JointLimits]:
    text = (resources.files("robot.description") / "so101_limits.json").read_text()
    table: Mapping[str, Mapping[str, float]] = json.loads(text)["joints"]
    return {name: JointLimits(each["max_velocity"], each["max_acceleration"]) for name, each in table.items()}
