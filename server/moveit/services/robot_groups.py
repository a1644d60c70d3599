"""``/armbridge/robot``: the joint groups of a robot as JSON, for a page that reads neither URDF nor SRDF for them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from robot.description.joined import chain_lengths_m
from robot.description.model import RobotModel
from robot.description.srdf import Group
from server.graph.node import Node
from server.graph.topics import Graph
from server.moveit.actions.gripper import GRIPPER_ACTION
from server.moveit.parameters import MoveItParameters
from server.moveit.requests.constraints import planning_group, tip_link

ROBOT_TOPIC = "/armbridge/robot"


def publish_groups(
    graph: Graph, robot: RobotModel, arms: Mapping[str, RobotModel], parameters: MoveItParameters
) -> None:
    """Publish the groups, latched, of one arm with an empty name or of several arms by their names."""
    node = Node("robot groups")
    graph.advertise(node, ROBOT_TOPIC, "std_msgs/String", latch=True)
    graph.publish(node, ROBOT_TOPIC, {"data": json.dumps(groups_document(robot, arms, parameters))})


def groups_document(robot: RobotModel, arms: Mapping[str, RobotModel], parameters: MoveItParameters) -> dict[str, Any]:
    """Return the joints with their types, the groups without grippers, and a bound of the tips' reach [m]."""
    grippers = {joint for arm in arms.values() if arm.gripper for joint in arm.gripper.joints}
    groups = [group for group in robot.groups.values() if not grippers.issuperset(group.joints)]
    return {
        "joints": {joint.name: joint.type for joint in robot.movable_joints},
        "default_group": planning_group(robot, "", parameters).name,
        "groups": [_group(group, robot, arms, tip_link(robot, group, parameters)) for group in groups],
        "reach_m": max(chain_lengths_m(robot).values()),
    }


def _group(group: Group, robot: RobotModel, arms: Mapping[str, RobotModel], tip: str) -> dict[str, Any]:
    # A group with joints of several arms is driven by no arm's servo node, and has no gripper of its own.
    name = next((name for name, arm in arms.items() if arm.joints.keys() >= set(group.joints)), None)
    namespace = None if name is None else f"/{name}" if name else ""
    gripper = None if name is None else arms[name].gripper
    return {
        "name": group.name,
        "joints": group.joints,
        "tip": tip or None,
        "touch_links": _carried_by(tip, robot) if tip else [],
        "namespace": namespace,
        "gripper": gripper
        and {
            "joints": gripper.joints,
            "open": gripper.open,
            "closed": gripper.closed,
            "action": f"{namespace}{GRIPPER_ACTION}",
        },
    }


def _carried_by(tip: str, robot: RobotModel) -> list[str]:
    """Return the links that an object at the tip may touch: the tip's rigid body, and all that it carries."""
    above = {joint.child: joint for joint in robot.joints.values()}
    body = tip
    while body in above and not above[body].moves:
        body = above[body].parent

    def is_carried(link: str) -> bool:
        while link != body and link in above:
            link = above[link].parent
        return link == body

    return [link for link in robot.links if is_carried(link)]
