"""Frames by name: links, things, subframes of things, and frames that were told to stand still."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from robot.forward import ForwardPlacements
from robot.model import RobotModel
from robot.trajectory import Vector
from server.moveit.poses import composed, inverse, pose_of
from server.moveit.scene.collision_objects import IDENTITY, HeldThing, Thing

# MoveIt's name for where the robot stands, which is its root link here.
WORLD = "world"

# No link or thing has a longer name; looking for a subframe takes time by its square.
MAX_NAME_LENGTH = 1000

# A refusal lists the frames that there are, up to this many.
MAX_LISTED = 20


class Surroundings(Protocol):
    """What may be named as a frame beside the links."""

    @property
    def objects(self) -> Mapping[str, Thing]:
        """Things that stand around, by name."""

    @property
    def attached(self) -> Mapping[str, HeldThing]:
        """Things that links hold, by name."""

    @property
    def fixed_frames(self) -> Mapping[str, Pose]:
        """Further frames, by name, in the root link."""


class ShownScene(Protocol):
    """A scene that changes."""

    @property
    def contents(self) -> Surroundings:
        """What it holds now."""


class LinkPlaces:
    """Where the links are for one set of joint positions; worked out when it is first asked for.

    Args:
        robot: the arm.
        forward: its forward kinematics.
        positions_rad: position of every movable joint [rad], None while they are not known.
    """

    def __init__(
        self, robot: RobotModel, forward: ForwardPlacements, positions_rad: Mapping[str, float] | None
    ) -> None:
        self._robot = robot
        self._forward = forward
        self._positions_rad = positions_rad
        self._transforms: Mapping[str, Vector] | None = None

    @property
    def root_link(self) -> str:
        """The link that stands still."""
        return self._robot.root_link

    @property
    def names(self) -> tuple[str, ...]:
        """Every link."""
        return self._robot.links

    def pose(self, link: str) -> Pose | PlanningFailure:
        """Pose of a link of the robot in its root link."""
        if link == self.root_link:
            return IDENTITY
        if self._positions_rad is None:
            return _unknown(link, f"where the link {link!r} is cannot be told: the arm's position is not known")
        if self._transforms is None:
            self._transforms = self._forward.transforms(self._positions_rad)
        return pose_of(self._transforms[link])


class Frames:
    """Finds frames in the present scene.

    Args:
        robot: the arm.
        scene_state: the scene.
    """

    def __init__(self, robot: RobotModel, scene_state: ShownScene) -> None:
        self._robot = robot
        self._forward = ForwardPlacements(robot)
        self._state = scene_state

    def resolve(self, frame_id: str, positions_rad: Mapping[str, float] | None) -> Pose | PlanningFailure:
        """Pose of a frame in the root link; see :func:`find_frame`.

        Args:
            frame_id: its name.
            positions_rad: position of every movable joint [rad], None while they are not known.
        """
        return find_frame(frame_id, self._state.contents, LinkPlaces(self._robot, self._forward, positions_rad))


def find_frame(frame_id: str, around: Surroundings, links: LinkPlaces) -> Pose | PlanningFailure:
    """Pose of a frame in the root link.

    The empty name, ``world`` and the root link are the root link itself; a leading slash does not matter. A subframe
    is named ``THING/SUBFRAME``. Links come first, then things, then frames that were told to stand still.

    Args:
        frame_id: its name.
        around: what may be named beside the links.
        links: where the links are.
    """
    name = frame_id.removeprefix("/")
    if not name:
        return IDENTITY
    if len(name) > MAX_NAME_LENGTH:
        text = f"the frame's name has {len(name)} letters, more than {MAX_NAME_LENGTH}"
        return _unknown(name[:MAX_NAME_LENGTH], text)
    if name in links.names:
        return links.pose(name)
    for thing, subframe in _readings(name):
        found = _in_thing(thing, subframe, around, links)
        if found is not None:
            return found
    if name in around.fixed_frames:
        return around.fixed_frames[name]
    if name == WORLD:
        return IDENTITY
    known = [*links.names, *around.objects, *around.attached, *around.fixed_frames]
    listed = ", ".join(known[:MAX_LISTED]) + (", ..." if len(known) > MAX_LISTED else "")
    return _unknown(name, f"there is no frame {name!r}; known are {listed}")


def in_root(frame: Pose, pose: Pose) -> Pose:
    """A pose that is given in a frame, in the root link; exactly as given where the frame is the root link."""
    return pose if frame == IDENTITY else composed(frame, pose)


def seen_from(frame: Pose, pose: Pose) -> Pose:
    """A pose in the root link, as seen from a frame that is given there."""
    return pose if frame == IDENTITY else composed(inverse(frame), pose)


def _readings(name: str) -> Iterator[tuple[str, str]]:
    """Every way to read a name as a thing and its subframe: both may have slashes in them."""
    yield name, ""
    for i, letter in enumerate(name):
        if letter == "/":
            yield name[:i], name[i + 1 :]


def _in_thing(name: str, subframe: str, around: Surroundings, links: LinkPlaces) -> Pose | PlanningFailure | None:
    """A thing's or its subframe's pose in the root link; None where there is no such thing or subframe."""
    held = around.attached.get(name)
    thing = around.objects.get(name) if held is None else held.thing
    if thing is None or (subframe and subframe not in thing.subframes):
        return None
    pose = in_root(thing.pose, thing.subframes[subframe]) if subframe else thing.pose
    if held is None:
        return pose
    link = links.pose(held.link)
    return link if isinstance(link, PlanningFailure) else in_root(link, pose)


def _unknown(frame: str, message: str) -> PlanningFailure:
    return PlanningFailure(MoveItErrorCode.FRAME_TRANSFORM_FAILURE, message, {"frame": frame})
