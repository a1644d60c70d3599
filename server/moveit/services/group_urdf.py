"""``/get_urdf``: the description of one planning group alone."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any

from robot.description.model import Group, RobotModel
from server.graph.node import Node
from server.moveit.requests.codes import success
from server.moveit.requests.context import Message
from server.moveit.services.planning_context import PlanningContext


def get_urdf(context: PlanningContext, request: Message, caller: Node) -> dict[str, Any]:  # noqa: ARG001 - as every service
    """The URDF of a group; the response of moveit_msgs/GetGroupUrdf.

    Raises:
        RefusedError: there is no such group.
    """
    group = context.group(request["group_name"])
    return {"error_code": success(), "urdf_string": group_urdf(context.robot, group)}


def group_urdf(robot: RobotModel, group: Group) -> str:
    """The links and joints from a group's base to its tip, as a URDF of their own."""
    by_child = {joint.child: joint for joint in robot.joints.values()}
    links, joints = {group.base_link}, set()
    for name in group.joints:
        joints.add(name)
        links |= {robot.joints[name].parent, robot.joints[name].child}
    link = group.tip_link
    while link != group.base_link and link in by_child:
        joints.add(by_child[link].name)
        links.add(link)
        link = by_child[link].parent
    # Our own file: model.parse has read it before.
    whole = ET.fromstring(robot.urdf)  # noqa: S314
    part = ET.Element("robot", {"name": group.name})
    for element in whole:
        wanted = {"link": links, "joint": joints}.get(element.tag)
        if wanted is None or element.get("name") in wanted:
            part.append(element)
    return ET.tostring(part, encoding="unicode")
