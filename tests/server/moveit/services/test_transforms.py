from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from planners.scene import Pose
from protocol.registry import Registry
from robot.description.forward_kinematics import ForwardPlacements
from robot.messages import ArmState, Mode
from server.actionlib import ActionlibBridge
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.moveit.messages import matrix_of, pose_of
from server.moveit.scene.frames import Frames
from server.moveit.scene.scene_state import SceneState
from server.moveit.services import description
from server.moveit.services.description import (
    ACTION,
    SERVICE,
    STATIC_TRANSFORMS_TOPIC,
    TRANSFORMS_TOPIC,
    TransformRepublisher,
    TransformsTopics,
)
from tests.helpers.gateway import InProcess
from tests.helpers.moveit import ROBOT

JOINTS = tuple(joint.name for joint in ROBOT.movable_joints)
# As roslib's clients ask by default.
REQUEST = {
    "source_frames": ["gripper_link", "/shoulder_link", "nowhere"],
    "target_frame": ROBOT.root_link,
    "angular_thres": 2.0,
    "trans_thres": 0.01,
    "rate": 10.0,
}


class World(InProcess):
    """Clients, and an arm of which one joint moves."""

    def __init__(self) -> None:
        super().__init__()
        self.republisher = TransformRepublisher(self.graph, Frames(ROBOT, SceneState(ROBOT)), self.clock)

    def move(self, elbow_rad: float, seconds: float = 1.0) -> None:
        """Have the arm be at an angle after some time."""
        self.clock.advance(seconds)
        positions_rad = np.array([elbow_rad if name == "elbow_flex" else 0.0 for name in JOINTS])
        self.republisher.take_state(ArmState(1.0, Mode.HOLDING, JOINTS, position_rad=positions_rad))

    def send_goal(
        self, client: str = "c", package: str = "tf2_web_republisher_interfaces", **thresholds: float
    ) -> None:
        fields = {"action": ACTION, "action_type": f"{package}/TFSubscription", "feedback": True}
        self.say(client, op="send_action_goal", id="g", args={**REQUEST, **thresholds}, **fields)

    def moved(self, client: str = "c") -> list[str]:
        """The frames whose transforms a client has heard since the last time."""
        messages = [each.get("values") or each["msg"] for each in self.heard(client)]
        return [transform["child_frame_id"] for message in messages for transform in message["transforms"]]


@pytest.fixture
def world() -> World:
    return World()


@pytest.mark.parametrize("package", ["tf2_web_republisher_interfaces", "tf2_web_republisher_msgs"])
def test_an_actions_feedback_has_the_transforms_of_the_known_frames(world: World, package: str) -> None:
    world.send_goal(package=package)
    world.move(0.4)
    (feedback,) = world.heard("c")
    gripper, shoulder = feedback["values"]["transforms"]
    assert (gripper["header"]["frame_id"], gripper["child_frame_id"]) == (ROBOT.root_link, "gripper_link")
    assert shoulder["child_frame_id"] == "shoulder_link"
    positions_rad = {name: 0.4 if name == "elbow_flex" else 0.0 for name in JOINTS}
    pose = pose_of(ForwardPlacements(ROBOT).transforms(positions_rad)["gripper_link"])
    assert list(gripper["transform"]["translation"].values()) == pytest.approx(pose.position_m)
    assert list(gripper["transform"]["rotation"].values()) == pytest.approx(pose.orientation)


@pytest.mark.parametrize(
    ("thresholds", "small_rad", "large_rad"),
    [({}, 0.001, 0.5), ({"trans_thres": 10.0}, np.radians(1.0), np.radians(3.0))],
    ids=["distance", "angle in degrees"],
)
def test_only_transforms_beyond_the_thresholds_are_sent_again_at_the_rate(
    world: World, thresholds: dict[str, float], small_rad: float, large_rad: float
) -> None:
    world.send_goal(**thresholds)
    world.move(0.0)
    assert world.moved() == ["gripper_link", "shoulder_link"]
    for elbow_rad, seconds, moved in ((small_rad, 1.0, []), (large_rad, 0.02, []), (large_rad, 0.1, ["gripper_link"])):
        world.move(elbow_rad, seconds)
        assert world.moved() == moved


def test_a_goal_ends_when_it_is_cancelled_and_when_its_sender_leaves(world: World) -> None:
    world.send_goal("a")
    world.send_goal("b")
    world.say("a", op="cancel_action_goal", id="g", action=ACTION)
    (result,) = world.heard("a")
    assert (result["op"], result["status"]) == ("action_result", 5)
    world.client("b").leave()
    world.move(0.4)
    assert not world.republisher._goals


def test_a_topic_has_all_transforms_for_a_new_subscriber_and_ends_without_one(world: World) -> None:
    world.say("c", op="call_service", service=SERVICE, args={**REQUEST, "timeout": {"sec": 2}})
    topic = world.heard("c")[0]["values"]["topic_name"]
    for _ in range(2):
        world.say("c", op="subscribe", topic=topic)
        for _ in range(3):
            world.move(0.4)
        assert world.moved() == ["gripper_link", "shoulder_link"]
        world.say("c", op="unsubscribe", topic=topic)
        world.move(0.4)
    world.move(0.4)
    assert topic in world.graph.topic_types()
    world.move(0.4)
    assert topic not in world.graph.topic_types()


def test_a_client_of_ros1_hears_the_transforms_by_actionlib(world: World) -> None:
    ActionlibBridge(world.graph, world.clock, world.clock.call_later).open([ACTION])
    goal_type = "tf2_web_republisher/TFSubscriptionActionGoal"
    world.say("c", op="advertise", topic=f"{ACTION}/goal", type=goal_type)
    world.say("c", op="subscribe", topic=f"{ACTION}/feedback")
    world.say("c", op="publish", topic=f"{ACTION}/goal", msg={"goal_id": {"id": "g"}, "goal": REQUEST})
    world.move(0.4)
    (feedback,) = world.heard("c")
    assert feedback["msg"]["status"]["goal_id"]["id"] == "g"
    transform = feedback["msg"]["feedback"]["transforms"][0]
    assert transform["child_frame_id"] == "gripper_link"
    assert "secs" in transform["header"]["stamp"]


def test_the_number_of_subscriptions_is_bounded(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(description, "MAX_SUBSCRIPTIONS", 1)
    world.send_goal("a")
    world.say("c", op="call_service", service=SERVICE, args=REQUEST)
    world.send_goal("c")
    for answer in world.heard("c"):
        assert (answer["result"], answer["values"]) == (False, "there are 1 subscriptions already, the limit")


class Screen:
    """The topics, and what somebody hears who subscribes after the start."""

    def __init__(self, rate_hz: float = 50.0) -> None:
        self.graph = Graph(Registry.load())
        self.topics = TransformsTopics(self.graph, ROBOT, rate_hz)
        self.heard: list[Any] = []
        for topic in (TRANSFORMS_TOPIC, STATIC_TRANSFORMS_TOPIC):
            before = self.graph.subscribe(
                Node("watcher"), topic, None, Subscriber(lambda published: self.heard.append(published.msg))
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
