from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from protocol.registry import Registry
from robot.messages import ArmState, Mode
from server.arm.topics import TOPIC, JointStates, states_are_observed
from server.graph.local_graph import LocalGraph
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber


@pytest.fixture
def heard() -> tuple[JointStates, list[Any]]:
    graph = Graph(Registry.load())
    states = JointStates(LocalGraph(graph))
    messages: list[Any] = []
    graph.subscribe(Node("test"), TOPIC, None, Subscriber(lambda published: messages.append(published.msg)))
    return states, messages


def test_a_state_is_published_with_the_time_of_its_reading(heard: tuple[JointStates, list[Any]]) -> None:
    states, messages = heard
    array = np.array([0.1, -0.2])
    states.publish(
        ArmState(1234.25, Mode.HOLDING, ("a", "b"), position_rad=array, velocity_rad_s=array * 2, load=array * 3)
    )
    assert messages == [
        {
            "header": {"stamp": {"sec": 1234, "nanosec": 250_000_000}, "frame_id": ""},
            "name": ["a", "b"],
            "position": pytest.approx([0.1, -0.2]),
            "velocity": pytest.approx([0.2, -0.4]),
            "effort": pytest.approx([0.3, -0.6]),
        }
    ]


def test_an_arm_that_is_not_there_has_no_joint_states(heard: tuple[JointStates, list[Any]]) -> None:
    states, messages = heard
    states.publish(ArmState(1.8e9, Mode.DISCONNECTED, ("a",), reason="unplugged"))
    assert messages == []


@pytest.mark.parametrize(
    ("topic", "observed"),
    [
        ("/joint_states", True),
        ("/tf", True),
        ("/arm_controller/state", True),
        ("/arm_with_torso_controller/controller_state", True),
        ("/arm/state", False),
        ("/diagnostics", False),
    ],
)
def test_states_are_observed_while_somebody_subscribes_to_what_follows_them(topic: str, observed: bool) -> None:
    graph, node = Graph(Registry.load()), Node("test")
    publisher = Node("arm")
    graph.advertise(publisher, topic, "std_msgs/String")
    assert not states_are_observed(graph)
    graph.subscribe(node, topic, None, Subscriber(lambda _: None))
    assert states_are_observed(graph) is observed
    graph.remove(node)
    assert not states_are_observed(graph)
