"""Forward kinematics of a URDF without a kinematics library, for frames and markers."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from robot.description.model import RobotModel
from robot.description.urdf import Mimic, joint_motion, origin_transform, parsed, unit_axis
from robot.trajectory import Vector


class ForwardPlacements:
    """Forward kinematics of one robot."""

    def __init__(self, robot: RobotModel) -> None:
        self._root = robot.root_link
        elements = {joint.get("name"): joint for joint in parsed(robot.urdf).iterfind("joint")}
        by_child = {joint.child: joint for joint in robot.joints.values()}
        # Links come parents before children.
        self._steps = [
            _Step(
                joint.parent,
                link,
                (joint.mimic or Mimic(joint.name, 1.0, 0.0)) if joint.moves else None,
                joint.type == "prismatic",
                unit_axis(elements[joint.name]),
                origin_transform(elements[joint.name]),
            )
            for link in robot.links
            if (joint := by_child.get(link)) is not None
        ]
        self._by_child = {step.child: step for step in self._steps}

    def transforms(self, positions_rad: Mapping[str, float]) -> dict[str, Vector]:
        """Compute ``transform_link_to_root`` of every link, shape (4, 4) [m], from all joints' positions [rad or m]."""
        placed = {self._root: np.eye(4)}
        for step in self._steps:
            place = placed[step.parent] @ step.transform_joint_to_parent
            placed[step.child] = place if step.leader is None else place @ _moved(step, positions_rad)
        return placed

    def axis(self, link: str) -> Vector:
        """Return the axis of the joint above a link in the link's frame, a unit vector, shape (3,)."""
        return self._by_child[link].axis

    def joint_transform(self, link: str, positions_rad: Mapping[str, float]) -> tuple[str, Vector]:
        """Return the parent of a link and the link's transform to it, shape (4, 4) [m]."""
        step = self._by_child[link]
        return step.parent, step.transform_joint_to_parent @ _moved(step, positions_rad)


@dataclass(frozen=True)
class _Step:
    """Joint with its fixed transform and axis."""

    parent: str
    child: str
    leader: Mimic | None  # joint whose position it takes, mostly itself; None for a fixed joint
    slides: bool
    axis: Vector
    transform_joint_to_parent: Vector


def _moved(step: _Step, positions_rad: Mapping[str, float]) -> Vector:
    if step.leader is None:
        return np.eye(4)
    position = step.leader.multiplier * positions_rad[step.leader.joint] + step.leader.offset
    return joint_motion(step.axis, position, slides=step.slides)
