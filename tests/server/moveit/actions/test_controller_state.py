from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from protocol.registry import Registry
from robot import model
from server.graph import Graph, Subscriber
from server.moveit.actions.joint_trajectory_controller import ControllerState
from server.node import Node
from tests.helpers.played_arm import JOINTS, PlayedArm

GROUP = model.builtin().groups["arm"]
STATE = replace(PlayedArm().state, goal_rad=np.full(len(JOINTS), 0.3), position_rad=np.full(len(JOINTS), 0.2))


@pytest.mark.parametrize("name", ["state", "controller_state"])
async def test_who_listens_hears_where_the_joints_should_be_and_are(name: str) -> None:
    graph = Graph(Registry.load())
    told = ControllerState(graph, GROUP)
    told.open()
    heard: list[Any] = []
    subscriber = Subscriber(lambda publication: heard.append(publication.msg))
    graph.subscribe(Node("client"), f"/arm_controller/{name}", None, subscriber)
    told.take_state(STATE)
    told.take_state(replace(STATE, goal_rad=None))
    assert len(heard) == 1
    assert heard[0]["joint_names"] == list(GROUP.joints)
    assert heard[0]["reference"]["positions"] == [0.3] * len(GROUP.joints)
    assert heard[0]["error"]["positions"] == pytest.approx([0.1] * len(GROUP.joints))
    assert heard[0]["speed_scaling_factor"] == 1.0
