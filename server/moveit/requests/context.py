"""What a request is read against: the robot, where it is, its frames, and the parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeAlias

from planners.problem import MoveItErrorCode, PlanningFailure
from planners.scene import Pose
from robot.model import Group, RobotModel
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import read_pose
from server.moveit.requests.error_codes import refused, required
from server.moveit.scene.frames import in_root

Message: TypeAlias = Mapping[str, Any]

# Fewer joints than a pose has dimensions: orientations cannot be chosen freely.
FREE_POSE_JOINTS = 6


class FrameResolver(Protocol):
    """Knows where frames are."""

    def resolve(self, frame_id: str, positions_rad: Mapping[str, float]) -> Pose | PlanningFailure:
        """The pose of a frame in the robot's root link."""


@dataclass(frozen=True)
class RequestContext:
    """What the fields of one request mean.

    Attributes:
        robot: the arm.
        group: the joints that move.
        frames: where frames are.
        start_rad: position of every movable joint, for frames that move with the arm [rad].
        parameters: what counts where the request says nothing.
        warnings: what was left out of account, a sentence each; grows while the request is read.
    """

    robot: RobotModel
    group: Group
    frames: FrameResolver
    start_rad: Mapping[str, float]
    parameters: MoveItParameters
    warnings: list[str] = field(default_factory=list)

    @property
    def chooses_orientation(self) -> bool:
        """Whether the group has the joints to meet any orientation."""
        return len(self.group.joints) >= FREE_POSE_JOINTS

    def link(self, name: str) -> str:
        """A link by its name; the tip when it is empty.

        Raises:
            RefusedError: there is no such link.
        """
        if not name:
            configured = self.parameters.end_effector_link
            return configured if configured and self.group.name == self.parameters.group_name else self.group.tip_link
        if name not in self.robot.links:
            known = ", ".join(self.robot.links)
            raise refused(
                MoveItErrorCode.INVALID_LINK_NAME, f"the robot has no link {name!r}; it has: {known}", link=name
            )
        return name

    def placed(self, frame_id: str, message: Message, where: str) -> Pose:
        """A geometry_msgs/Pose that is given in a frame, in the robot's root link.

        Args:
            frame_id: the frame; empty for the root link.
            message: the pose.
            where: path of its field.

        Raises:
            RefusedError: a number that is not finite, or a frame that nobody knows.
        """
        frame = required(self.frames.resolve(frame_id, self.start_rad))
        return in_root(frame, required(read_pose(message, where)))


def group_of(robot: RobotModel, name: str, parameters: MoveItParameters) -> Group:
    """A planning group by its name; the configured one when it is empty.

    Raises:
        RefusedError: there is no such group.
    """
    wanted = name or parameters.group_name
    if wanted not in robot.groups:
        known = ", ".join(sorted(robot.groups))
        raise refused(
            MoveItErrorCode.INVALID_GROUP_NAME, f"there is no planning group {name!r}; there are: {known}", group=name
        )
    return robot.groups[wanted]
