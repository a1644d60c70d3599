"""Context in which the fields of a request are read: robot, group, frames, start and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from planners.problem import MoveItErrorCode
from planners.scene import Pose
from robot.description.model import Group, RobotModel
from server.moveit.error_codes import refused
from server.moveit.parameters import MoveItParameters
from server.moveit.poses import Message, read_pose
from server.moveit.scene.frames import Frames, in_root

# A pose has six dimensions: a group with fewer joints cannot reach any orientation.
FREE_POSE_JOINTS = 6


@dataclass(frozen=True)
class RequestContext:
    """Context of one request.

    Attributes:
        warnings: a sentence for each part of the request that is not followed; grows while the request is read.
    """

    robot: RobotModel
    group: Group
    frames: Frames
    start_rad: Mapping[str, float]
    parameters: MoveItParameters
    warnings: list[str] = field(default_factory=list)

    def link(self, name: str) -> str:
        """Return the name of a link; the tip's for an empty name."""
        if not name:
            return checked_tip(tip_link(self.robot, self.group, self.parameters), self.group)
        if name not in self.robot.links:
            known = ", ".join(self.robot.links)
            raise refused(
                MoveItErrorCode.INVALID_LINK_NAME, f"the robot has no link {name!r}; it has: {known}", link=name
            )
        return name

    def placed(self, frame_id: str, message: Message, where: str) -> Pose:
        """Transform a geometry_msgs/Pose from a frame into the root link.

        Args:
            frame_id: the frame; empty for the root link.
        """
        frame = self.frames.resolve(frame_id, self.start_rad)
        return in_root(frame, read_pose(message, where))


def chooses_orientation(group: Group) -> bool:
    """Return true if a group has the joints to reach any orientation."""
    return len(group.joints) >= FREE_POSE_JOINTS


def checked_tip(link: str, group: Group) -> str:
    """Return the tip of a group."""
    if not link:
        raise refused(
            MoveItErrorCode.INVALID_LINK_NAME,
            f"group {group.name} has no tip, for its joints are not one chain: name a link, or another group",
            group=group.name,
        )
    return link


def tip_link(robot: RobotModel, group: Group, parameters: MoveItParameters) -> str:
    """Return the link that goals of a group move when they name none; empty where the group is not one chain."""
    if group.name != (parameters.group_name or robot.default_group):
        return group.tip_link
    if parameters.end_effector_link:
        return parameters.end_effector_link
    return robot.tip_link if group.name == robot.default_group else group.tip_link


def planning_group(robot: RobotModel, name: str, parameters: MoveItParameters) -> Group:
    """Return a planning group; for an empty name the configured one, or else the robot's default."""
    wanted = name or parameters.group_name or robot.default_group
    if wanted not in robot.groups:
        known = ", ".join(sorted(robot.groups))
        raise refused(
            MoveItErrorCode.INVALID_GROUP_NAME,
            f"there is no planning group {wanted!r}; there are: {known}",
            group=wanted,
        )
    return robot.groups[wanted]
