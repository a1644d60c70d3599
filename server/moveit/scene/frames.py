"""Frames by name: links, collision objects, and their subframes."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

from planners.problem import MoveItErrorCode
from planners.scene import Pose
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.trajectory import Vector
from server.errors import RefusedError, refused
from server.moveit.messages import composed, inverse, pose_of
from server.moveit.scene.collision_objects import IDENTITY

if TYPE_CHECKING:
    from server.moveit.scene.planning_scene import SceneContents
    from server.moveit.scene.scene_state import SceneState

# MoveIt's name of the fixed frame, which is the robot's root link here.
WORLD = "world"

# Looking up OBJECT/SUBFRAME takes time by the square of the length; real names are far shorter.
MAX_NAME_LENGTH = 255

# Frames whose poses are kept for a scene and positions of the joints.
MAX_RESOLVED = 100

# Most frames that the error for an unknown one lists.
MAX_LISTED = 20


class LinkTransforms:
    """Transforms of the links at one set of joint positions, computed at the first use."""

    def __init__(
        self, robot: RobotModel, forward: ForwardPlacements, positions_rad: Mapping[str, float] | None
    ) -> None:
        self.robot = robot
        self._forward = forward
        self._positions_rad = positions_rad

    @cached_property
    def _transforms(self) -> Mapping[str, Vector]:
        return {} if self._positions_rad is None else self._forward.transforms(self._positions_rad)

    def pose(self, link: str) -> Pose:
        """Return the pose of a link in the root link."""
        if link == self.robot.root_link:
            return IDENTITY
        if link not in self._transforms:
            raise _unknown(link, f"the pose of link {link!r} is unknown: the arm is not connected")
        return pose_of(self._transforms[link])


class Frames:
    """Look-up of frames in the present scene."""

    def __init__(self, scene_state: SceneState) -> None:
        self._state = scene_state
        # Poses of frames by name, for a scene and joint positions: the many poses of a request are mostly in one frame.
        # Replaced as a whole, because threads read requests too.
        self._resolved: tuple[SceneContents, Mapping[str, float] | None, dict[str, Pose]] | None = None

    def resolve(self, frame_id: str, positions_rad: Mapping[str, float] | None) -> Pose:
        """Return the pose of a frame in the root link; names and errors as for :func:`find_frame`."""
        contents, known = self._state.contents, None if positions_rad is None else dict(positions_rad)
        resolved = self._resolved
        if resolved is None or resolved[0] is not contents or resolved[1] != known or len(resolved[2]) >= MAX_RESOLVED:
            resolved = self._resolved = contents, known, {}
        poses = resolved[2]
        if frame_id not in poses:
            poses[frame_id] = find_frame(frame_id, contents, self._state.links(positions_rad))
        return poses[frame_id]


def find_frame(frame_id: str, around: SceneContents, links: LinkTransforms) -> Pose:
    """Return the pose of a frame in the root link.

    The empty name, ``world`` and the root link are the root link itself; a leading slash does not matter. A subframe
    is named ``OBJECT/SUBFRAME``. Links are found before objects.
    """
    name = frame_id.removeprefix("/")
    if not name:
        return IDENTITY
    if len(name) > MAX_NAME_LENGTH:
        text = f"the frame's name has {len(name)} letters, more than {MAX_NAME_LENGTH}"
        raise _unknown(name[:MAX_NAME_LENGTH], text)
    if name in links.robot.links:
        return links.pose(name)
    # Names of objects and of subframes may contain slashes.
    splits = ((name[:i], name[i + 1 :]) for i, letter in enumerate(name) if letter == "/")
    for object_name, subframe in ((name, ""), *splits):
        found = _object_frame(object_name, subframe, around, links)
        if found is not None:
            return found
    if name == WORLD:
        return IDENTITY
    known = [*links.robot.links, *around.objects, *around.attached]
    listed = ", ".join(known[:MAX_LISTED]) + (", ..." if len(known) > MAX_LISTED else "")
    raise _unknown(name, f"there is no frame {name!r}; known are {listed}")


def in_root(frame: Pose, pose: Pose) -> Pose:
    """Transform a pose from a frame into the root link; unchanged, without rounding, if the frame is the root link."""
    return pose if frame == IDENTITY else composed(frame, pose)


def seen_from(frame: Pose, pose: Pose) -> Pose:
    """Transform a pose from the root link into a frame."""
    return pose if frame == IDENTITY else composed(inverse(frame), pose)


def _object_frame(name: str, subframe: str, around: SceneContents, links: LinkTransforms) -> Pose | None:
    """Return the pose of an object or its subframe in the root link; None if there is no such object or subframe."""
    attached = around.attached.get(name)
    found = around.objects.get(name) if attached is None else attached.collision_object
    if found is None or (subframe and subframe not in found.subframes):
        return None
    pose = in_root(found.pose, found.subframes[subframe]) if subframe else found.pose
    return pose if attached is None else in_root(links.pose(attached.link), pose)


def _unknown(frame: str, message: str) -> RefusedError:
    return refused(MoveItErrorCode.FRAME_TRANSFORM_FAILURE, message, frame=frame)
