from __future__ import annotations

import logging
from typing import Any

import pytest

from planners.servo.question import ServoStatus
from server.graph import Graph, Subscriber
from server.moveit.servo.servo_node import INT8, LOGGED_AGAIN_S, STATUS_TOPIC, StatusTopic
from server.node import Node
from tests.helpers.clock import FakeClock
from tests.helpers.in_process import REGISTRY


class Rig:
    """A status topic and what is heard there."""

    def __init__(self, type_name: str) -> None:
        graph = Graph(REGISTRY)
        self.clock = FakeClock()
        self.heard: list[dict[str, Any]] = []
        self.topic = StatusTopic(graph, Node("servo_node"), type_name, self.clock)
        self.topic.open()
        subscriber = Subscriber(lambda publication: self.heard.append(dict(publication.msg)))
        graph.subscribe(Node("client"), STATUS_TOPIC, type_name, subscriber)


def test_code_and_words_are_told() -> None:
    rig = Rig("moveit_msgs/ServoStatus")
    rig.topic.tell(ServoStatus.JOINT_BOUND, "elbow_flex at the limit")
    assert rig.heard == [{"code": 6, "message": "elbow_flex at the limit"}]


def test_humble_gets_its_own_numbers() -> None:
    rig = Rig(INT8)
    for status in (ServoStatus.JOINT_BOUND, ServoStatus.HALT_FOR_COLLISION, ServoStatus.HALT_FOR_SINGULARITY):
        rig.topic.tell(status, "")
    assert [each["data"] for each in rig.heard] == [5, 4, 2]


def test_a_refusal_is_logged_once_while_it_is_repeated(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig("moveit_msgs/ServoStatus")
    with caplog.at_level(logging.WARNING, "armbridge.servo"):
        for _ in range(10):
            rig.topic.tell(ServoStatus.INVALID, "the arm is relaxed")
            rig.topic.tell(ServoStatus.NO_WARNING, "")
        assert len(caplog.records) == 1
        rig.clock.advance(1.1 * LOGGED_AGAIN_S)
        rig.topic.tell(ServoStatus.INVALID, "the arm is relaxed")
    assert len(caplog.records) == 2
    assert len(rig.heard) == 21
