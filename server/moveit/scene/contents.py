"""All that a scene holds, and the same while it is being changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from planners.problem import PlanningFailure
from planners.scene import Pose, Scene
from robot.description.model import RobotModel
from server.moveit.requests.refusals import refused, required
from server.moveit.scene.frames import LinkPlaces, find_frame, in_root
from server.moveit.scene.matrix import ContactMatrix, Message, unchecked_pairs
from server.moveit.scene.things import HeldThing, Thing

# MoveIt's name of a scene that was given none.
NO_NAME = "(noname)"


@dataclass(frozen=True)
class SceneContents:
    """A planning scene; things are told apart by identity, so that two of them are quickly compared.

    Attributes:
        matrix: who may touch whom.
        name: of the scene.
        objects: what stands around, by name, in the planning frame.
        attached: what links hold, by name.
        padding_m: link -> by how much it is thickened [m]; those not in it are not.
        scale: link -> by which factor it is enlarged; those not in it are not.
        colors: link or thing -> std_msgs/ColorRGBA.
        fixed_frames: further frames, by name, in the root link.
    """

    matrix: ContactMatrix
    name: str = NO_NAME
    objects: Mapping[str, Thing] = field(default_factory=dict)
    attached: Mapping[str, HeldThing] = field(default_factory=dict)
    padding_m: Mapping[str, float] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    colors: Mapping[str, Message] = field(default_factory=dict)
    fixed_frames: Mapping[str, Pose] = field(default_factory=dict)

    def looks_like(self, other: SceneContents) -> bool:
        """Whether planners can see no difference between two."""
        return (
            self.objects == other.objects
            and self.attached == other.attached
            and self.matrix == other.matrix
            and self.padding_m == other.padding_m
            and self.scale == other.scale
        )

    def as_scene(self, version: int, robot: RobotModel) -> Scene:
        """The scene as planners have it.

        Args:
            version: a number that no other scene has.
            robot: whose SRDF says what may touch without being told so.
        """
        known = [*robot.links, *self.objects, *self.attached]
        return Scene(
            version,
            tuple(thing.object for thing in self.objects.values()),
            tuple(held.object for held in self.attached.values()),
            self.matrix.exceptions(unchecked_pairs(robot), known),
            self.padding_m,
            self.scale,
        )


class Draft:
    """A scene's contents while they are being changed.

    Args:
        contents: what there is; it stays as it is.
        links: where the links are meanwhile.

    Attributes:
        before: what there was, of which things are kept that are only said again.
        links: as given.

    The other attributes are those of :class:`SceneContents`.
    """

    def __init__(self, contents: SceneContents, links: LinkPlaces) -> None:
        self.before = contents
        self.links = links
        self.matrix = contents.matrix
        self.name = contents.name
        self.objects: dict[str, Thing] = dict(contents.objects)
        self.attached: dict[str, HeldThing] = dict(contents.attached)
        self.padding_m: dict[str, float] = dict(contents.padding_m)
        self.scale: dict[str, float] = dict(contents.scale)
        self.colors: dict[str, Message] = dict(contents.colors)
        self.fixed_frames: dict[str, Pose] = dict(contents.fixed_frames)

    @property
    def root(self) -> str:
        """The planning frame."""
        return self.links.root_link

    def contents(self) -> SceneContents:
        """What has come of it."""
        return SceneContents(
            self.matrix,
            self.name,
            self.objects,
            self.attached,
            self.padding_m,
            self.scale,
            self.colors,
            self.fixed_frames,
        )

    def is_root(self, frame_id: str) -> bool:
        """Whether a frame is the planning frame by its name alone."""
        return frame_id in ("", self.root)

    def frame(self, frame_id: str) -> Pose:
        """Pose of a frame in the planning frame.

        Raises:
            RefusedError: nobody knows where it is.
        """
        return required(find_frame(frame_id, self, self.links))

    def placed(self, thing: Thing) -> Thing:
        """A thing with its pose in the planning frame.

        Raises:
            RefusedError: nobody knows where its own frame is.
        """
        pose = self.place(thing.name, thing.frame, thing.pose)
        return thing if thing.frame == self.root else replace(thing, frame=self.root, pose=pose)

    def place(self, name: str, frame_id: str, pose: Pose) -> Pose:
        """A thing's pose that is given in a frame, in the planning frame.

        Raises:
            RefusedError: nobody knows where the frame is.
        """
        frame = find_frame(frame_id, self, self.links)
        if isinstance(frame, PlanningFailure):
            text = f"the object {name!r}, header.frame_id: {frame.message}"
            raise refused(frame.code, text, **frame.details, object=name)
        return in_root(frame, pose)

    def clear(self, matrix: ContactMatrix) -> None:
        """Begin anew, except for what is held.

        Args:
            matrix: who may touch whom.
        """
        self.matrix, self.objects = matrix, {}
        self.padding_m, self.scale, self.colors, self.fixed_frames = {}, {}, {}, {}

    def forget(self, name: str) -> None:
        """Forget what was said of a thing that is no more."""
        self.colors.pop(name, None)
        self.matrix = self.matrix.without(name)
