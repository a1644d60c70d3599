from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planners.scene import Pose
from protocol.registry import Registry
from robot.description.forward_kinematics import ForwardPlacements
from robot.messages import ArmState, Mode
from robot.trajectory import Trajectory
from server.execution.motions import Performed
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.display import (
    CONTACTS_TOPIC,
    PATH_TOPIC,
    PIPELINE_TOPIC,
    STATIC_TRANSFORMS_TOPIC,
    TRANSFORMS_TOPIC,
    DisplayTopics,
    TransformsTopics,
)
from server.moveit.poses import matrix_of
from tests.helpers.fake_arm import HOME
from tests.helpers.moveit import ROBOT

MOTION = Trajectory(("elbow_flex",), np.array([0.0, 1.0]), np.array([[0.0], [0.5]]), np.zeros((2, 1)), np.zeros((2, 1)))
TYPES = {
    PATH_TOPIC: "moveit_msgs/DisplayTrajectory",
    CONTACTS_TOPIC: "visualization_msgs/MarkerArray",
    PIPELINE_TOPIC: "moveit_msgs/PipelineState",
}

JOINTS = tuple(joint.name for joint in ROBOT.movable_joints)
WATCHER = Node("watcher")


@pytest.fixture
def graph() -> Graph:
    return Graph(Registry.load())


@pytest.fixture
def display(graph: Graph) -> DisplayTopics:
    return DisplayTopics(graph, ROBOT)


def listen(graph: Graph, topic: str) -> list:
    heard: list = []
    subscriber = Subscriber(lambda news: heard.append(news.msg))
    heard += [kept.msg for kept in graph.subscribe(Node("viewer"), topic, TYPES[topic], subscriber)]
    return heard


def test_a_planned_motion_is_shown_with_its_start(graph: Graph, display: DisplayTopics) -> None:
    heard = listen(graph, PATH_TOPIC)
    display.performed(Performed(HOME, (MOTION, MOTION)))
    (shown,) = heard
    assert shown["model_id"] == ROBOT.name
    assert len(shown["trajectory"]) == 2
    assert shown["trajectory_start"]["joint_state"]["name"] == list(HOME)


def test_contacts_are_spheres_in_place_of_those_before(graph, display) -> None:
    heard = listen(graph, CONTACTS_TOPIC)
    display.contacts([{"first": "gripper_link", "second": "crate", "depth_m": 0.01, "point_m": (0.3, 0.1, 0.2)}])
    clear, ball = heard[0]["markers"]
    assert clear["action"] == 3
    assert ball["ns"] == "gripper_link, crate"
    assert ball["pose"]["position"] == {"x": 0.3, "y": 0.1, "z": 0.2}
    assert ball["header"]["frame_id"] == ROBOT.root_link


def test_the_state_of_the_pipeline_is_published_for_subscribers_alone(graph: Graph, display: DisplayTopics) -> None:
    display.pipeline({}, {})
    heard = listen(graph, PIPELINE_TOPIC)
    display.pipeline({"group_name": "arm"}, {"planning_time": 0.5})
    (told,) = heard
    assert told["request"]["group_name"] == "arm"
    assert told["response"]["planning_time"] == 0.5


class Screen:
    """The topics, and what somebody hears who subscribes after the start."""

    def __init__(self, rate_hz: float = 50.0) -> None:
        self.graph = Graph(Registry.load())
        self.topics = TransformsTopics(self.graph, ROBOT, rate_hz)
        self.heard: list[Any] = []
        for topic in (TRANSFORMS_TOPIC, STATIC_TRANSFORMS_TOPIC):
            before = self.graph.subscribe(
                WATCHER, topic, None, Subscriber(lambda published: self.heard.append(published.msg))
            )
            self.heard += [published.msg for published in before]

    def show(self, clock_s: float, position_rad: float = 0.0, stamp_s: float = 0.0) -> None:
        positions = np.full(len(JOINTS), position_rad)
        self.topics.take_state(ArmState(stamp_s, Mode.HOLDING, JOINTS, position_rad=positions, clock_s=clock_s))


@pytest.fixture
def screen() -> Screen:
    return Screen()


def test_both_transform_topics_together_place_every_link_as_forward_kinematics_does(screen: Screen) -> None:
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


@pytest.mark.parametrize("rate_hz", [1.0, 50.0, 100.0])
def test_transforms_come_at_most_at_their_rate(rate_hz: float) -> None:
    screen = Screen(rate_hz)
    for tick in range(100):
        screen.show(10.0 + tick * 0.01)
    assert len(screen.heard) == pytest.approx(1 + rate_hz, abs=1)


@pytest.mark.parametrize("jump_s", [3600.0, -3600.0, 6.3e8, -6.3e8])
def test_a_machines_clock_that_is_set_neither_silences_transforms_nor_brings_more(
    screen: Screen, jump_s: float
) -> None:
    for tick in range(100):
        screen.show(10.0 + tick * 0.01, stamp_s=1e9 + tick * 0.01 + (tick % 2) * jump_s)
    assert len(screen.heard) == pytest.approx(1 + 50, abs=1)


def test_a_disconnected_arm_has_no_transforms(screen: Screen) -> None:
    screen.topics.take_state(ArmState(1.0, Mode.DISCONNECTED, JOINTS))
    assert len(screen.heard) == 1
