"""Where clients want the joints to be taken to be, each for itself.

Some set a state in the scene and ask what would be true there, over several calls (compas_fab). Nothing is ever
executed from such a state.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any
from weakref import WeakKeyDictionary

from planners.problem import MoveItErrorCode
from robot.description.model import RobotModel
from server.graph.node import Node
from server.moveit.requests.refusals import refused

Message = Mapping[str, Any]


class AssumedStates:
    """The assumed joint positions of every client that has said some; a client that has left is forgotten.

    Args:
        robot: the arm.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._joints = {joint.name for joint in robot.movable_joints}
        # Nobody but the client's connection keeps its node, so what is kept here has as many entries as it has clients.
        self._assumed: WeakKeyDictionary[Node, Mapping[str, float]] = WeakKeyDictionary()
        self._believed: WeakKeyDictionary[Node, Mapping[str, float]] = WeakKeyDictionary()

    def of(self, node: Node) -> Mapping[str, float] | None:
        """Assumed positions of a client by joint, perhaps not of all joints [rad]; None when it has said none."""
        return self._assumed.get(node)

    def completed(
        self, assumed_rad: Mapping[str, float] | None, measured_rad: Mapping[str, float] | None
    ) -> dict[str, float] | None:
        """Position of every movable joint as somebody sees it who assumes some [rad]; None while not all are known.

        Args:
            assumed_rad: by joint [rad].
            measured_rad: where the joints are [rad].
        """
        positions = {**(measured_rad or {}), **(assumed_rad or {})}
        return positions if positions.keys() >= self._joints else None

    def tell(self, node: Node, positions_rad: Mapping[str, float]) -> None:
        """Note what a client has been told: sent back as it is, it says nothing."""
        self._believed[node] = positions_rad

    def stated(self, node: Node, robot_state: Message) -> Mapping[str, float] | None:
        """What a client will have assumed when it has said a moveit_msgs/RobotState, by joint [rad].

        Args:
            node: the client.
            robot_state: one without joints says nothing; with ``is_diff``, joints that are not named stay as they were.

        Raises:
            RefusedError: an unknown joint, or a position that is none.
        """
        named = self._read(robot_state["joint_state"])
        before, believed = self._assumed.get(node), self._believed.get(node, {})
        if all(believed.get(joint) == position for joint, position in named.items()):
            return before
        return {**(before or {}), **named} if robot_state["is_diff"] else named

    def assume(self, node: Node, positions_rad: Mapping[str, float] | None) -> None:
        """Take over what a client has stated."""
        if positions_rad is not None:
            self._assumed[node] = positions_rad
            self._believed[node] = {**self._believed.get(node, {}), **positions_rad}

    def _read(self, joint_state: Message) -> dict[str, float]:
        names, positions = joint_state["name"], joint_state["position"]
        where = "robot_state.joint_state"
        if len(names) != len(positions):
            raise _wrong(f"{where}: name has {len(names)} entries and position {len(positions)}; they must be as many")
        for name, position in zip(names, positions, strict=True):
            if name not in self._joints:
                known = ", ".join(sorted(self._joints))
                raise _wrong(f"{where}.name: there is no joint {name!r}; the robot has {known}", joint=name)
            if not math.isfinite(position):
                raise _wrong(f"{where}.position of joint {name!r} must be a finite number, not {position}", joint=name)
        return dict(zip(names, positions, strict=True))


def _wrong(message: str, **details: Any) -> Exception:
    return refused(MoveItErrorCode.INVALID_ROBOT_STATE, message, **details)
