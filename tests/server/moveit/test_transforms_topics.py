from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planners.scene import Pose
from protocol.registry import Registry
from robot.description import model
from robot.description.forward_kinematics import ForwardPlacements
from robot.messages import ArmState, Mode
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.poses import matrix_of
from server.moveit.transforms_topics import STATIC_TRANSFORMS_TOPIC, TRANSFORMS_TOPIC, TransformsTopics

ROBOT = model.builtin()
JOINTS = tuple(joint.name for joint in ROBOT.movable_joints)
WATCHER = Node("watcher")


class Screen:
    """The topics, and what somebody hears who subscribes after the start."""

    def __init__(self, rate_hz: float = 50.0) -> None:
        self.graph = Graph(Registry.load())
        self.topics = TransformsTopics(self.graph, ROBOT, rate_hz)
        self.topics.open(0.0)
        self.heard: list[Any] = []
        for topic in (TRANSFORMS_TOPIC, STATIC_TRANSFORMS_TOPIC):
            before = self.graph.subscribe(
                WATCHER, topic, None, Subscriber(lambda publication: self.heard.append(publication.msg))
            )
            self.heard += [publication.msg for publication in before]

    def show(self, stamp_s: float, position_rad: float = 0.0) -> None:
        positions = np.full(len(JOINTS), position_rad)
        self.topics.take_state(ArmState(stamp_s, Mode.HOLDING, JOINTS, position_rad=positions))


@pytest.fixture
def screen() -> Screen:
    return Screen()


def test_both_topics_together_place_every_link_where_forward_kinematics_does(screen: Screen) -> None:
    screen.show(1.0, 0.4)
    placed = {ROBOT.root_link: np.eye(4)}
    transforms = {each["child_frame_id"]: each for message in screen.heard for each in message["transforms"]}
    for link in ROBOT.links[1:]:
        parent, own = transforms[link]["header"]["frame_id"], transforms[link]["transform"]
        translation, rotation = own["translation"], own["rotation"]
        pose = Pose(tuple(translation[axis] for axis in "xyz"), tuple(rotation[axis] for axis in "xyzw"))
        placed[link] = placed[parent] @ matrix_of(pose)
    for link, transform in ForwardPlacements(ROBOT).transforms(dict.fromkeys(JOINTS, 0.4)).items():
        assert placed[link] == pytest.approx(transform, abs=1e-9)


def test_transforms_are_stamped_with_the_time_of_the_reading(screen: Screen) -> None:
    screen.show(12.25)
    assert screen.heard[-1]["transforms"][0]["header"]["stamp"] == {"sec": 12, "nanosec": 250_000_000}


@pytest.mark.parametrize("rate_hz", [1.0, 50.0, 100.0])
def test_they_come_at_their_rate_at_most(rate_hz: float) -> None:
    screen = Screen(rate_hz)
    for tick in range(100):
        screen.show(10.0 + tick * 0.01)
    assert len(screen.heard) == pytest.approx(1 + rate_hz, abs=1)


def test_a_clock_that_is_set_back_does_not_silence_them(screen: Screen) -> None:
    screen.show(1000.0)
    screen.show(500.0)
    assert len(screen.heard) == 3


def test_an_arm_that_is_not_there_has_no_transforms(screen: Screen) -> None:
    screen.topics.take_state(ArmState(1.0, Mode.DISCONNECTED, JOINTS))
    assert len(screen.heard) == 1


def test_nothing_is_worked_out_while_nobody_listens(screen: Screen) -> None:
    screen.graph.unsubscribe(WATCHER, TRANSFORMS_TOPIC)
    # Without its joints no transform could be worked out.
    screen.topics.take_state(ArmState(1.0, Mode.HOLDING, (), position_rad=np.zeros(0)))
    assert len(screen.heard) == 1
