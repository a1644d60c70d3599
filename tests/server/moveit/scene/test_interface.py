"""Topics and services of the planning scene."""

import asyncio
import contextlib

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from harness.waiting import TIMEOUT_S
from protocol.errors import MessageError
from server.errors import GraphError, RefusedError
from server.execution.monitors import state_message
from server.graph.permissions import Node
from server.graph.topics import Graph
from server.moveit.messages import matrix_of
from server.moveit.parameters import MoveItParameters
from server.moveit.scene import interface
from server.moveit.scene.scene_state import AT_ONCE_ELEMENTS, AssumedStates, SceneChange, SceneState
from tests.helpers.clock import FakeClock
from tests.helpers.fake_arm import JOINTS
from tests.helpers.graph import answered, listen
from tests.helpers.moveit import (
    BENT,
    FORWARD,
    REGISTRY,
    ROBOT,
    box,
    collision_object,
    current_state,
    diff,
    held,
    message,
    pose,
    scene_state,
)
from tests.helpers.resources import examples

CUP, GHOST, CROWD = box("cup"), {"id": "ghost", "operation": 1}, {"primitives": [{}] * 1001}
# A message that a topic takes, one that it refuses, and one with more shapes than a scene has.
MESSAGES = {
    "/planning_scene": [{"is_diff": True, "world": {"collision_objects": [each]}} for each in (CUP, GHOST, CROWD)],
    "/planning_scene_world": [{"collision_objects": [each]} for each in (CUP, GHOST, CROWD)],
    "/collision_object": [CUP, GHOST, CROWD],
    "/attached_collision_object": [
        {"link_name": "gripper_link", "object": {**CUP, "header": {"frame_id": "gripper_link"}}},
        {"object": GHOST},
        {"object": CROWD},
    ],
}


@pytest.mark.parametrize(("topic", "messages"), MESSAGES.items(), ids=MESSAGES)
async def test_every_topic_changes_the_scene_and_refuses_with_its_name(topic, messages, caplog):
    graph, state = Graph(REGISTRY), SceneState(ROBOT)
    interface.SceneInterface(graph, state, AssumedStates(ROBOT), current_state(), MoveItParameters())
    graph.publish(Node("client"), topic, messages[0])
    assert "cup" in {**state.contents.objects, **state.contents.attached}
    with pytest.raises(GraphError, match=f"topic {topic}: refused, nothing is changed: .*'ghost'"):
        graph.publish(Node("client"), topic, messages[1])
    # Refused before it is completed.
    with pytest.raises(MessageError, match="primitives: wanted at most 1000 elements in all, got 1001"):
        graph.publish(Node("client", remote=True), topic, messages[2])
    assert topic in caplog.text


class Client:
    """Somebody who calls the services of a scene."""

    def __init__(self):
        self.state, self.assumed = SceneState(ROBOT), AssumedStates(ROBOT)
        self.clock = FakeClock()
        self.graph = Graph(REGISTRY, call_later=self.clock.call_later)
        self.node = Node("client", remote=True)
        interface.SceneInterface(self.graph, self.state, self.assumed, current_state(), MoveItParameters())

    def call(self, service, **request):
        response = answered(self.graph, service, self.node, **request)
        assert response.ok, response.values
        return response.values

    def get(self, components=0):
        return self.call(interface.GET, components={"components": components})["scene"]

    def apply(self, **scene):
        return self.call(interface.APPLY, scene={"is_diff": True, **scene})["success"]

    def joints(self):
        joint_state = self.get()["robot_state"]["joint_state"]
        return dict(zip(joint_state["name"], joint_state["position"], strict=True))


def state_of(position_rad):
    return {"is_diff": True, "joint_state": {"name": list(JOINTS), "position": [position_rad] * len(JOINTS)}}


async def test_the_answer_is_a_complete_message():
    client = Client()
    assert client.apply(world={"collision_objects": [box("cup", at=pose(0.3))]})
    for components in (0, 8, 671):
        answer = client.call(interface.GET, components={"components": components})
        assert client.graph.message_types.complete("moveit_msgs/srv/GetPlanningScene_Response", answer) == answer
    # The octomap that is not there can be cleared.
    assert client.call(interface.CLEAR_OCTOMAP) == {}


async def test_a_refusal_tells_its_reason_in_response_and_log_and_is_of_all_that_comes_with_it(caplog):
    scene = {"is_diff": True, "world": {"collision_objects": [{"id": "ghost", "operation": 1}]}}
    response = answered(Client().graph, interface.APPLY, scene=scene)
    assert response.values == {"success": False}
    assert response.reason.startswith("refused, nothing is changed: world.collision_objects[0]: there is no object")
    assert "no object 'ghost'" in caplog.text
    client = Client()
    bad = {"is_diff": True, "joint_state": {"name": ["knee"], "position": [0.0]}}
    assert not client.apply(robot_state=bad, world={"collision_objects": [box("cup")]})
    assert client.state.contents.objects == {}


MANY = [box(str(number), at=pose(2.0)) for number in range(100)]


@pytest.mark.parametrize("waited_s", [1.0, 59.0])
async def test_a_large_scene_may_take_longer_than_a_call_of_a_client_and_later_calls_wait_for_it(waited_s):
    client, answers = Client(), []
    scene = {"is_diff": True, "world": {"collision_objects": MANY}}
    for service, request in ((interface.APPLY, {"scene": scene}), (interface.GET, {})):
        client.graph.services.call(client.node, service, request, answers.append)
    assert not answers
    client.clock.advance(waited_s)
    await asyncio.wait_for(client.state.settled(), TIMEOUT_S)
    while len(answers) < 2:
        await asyncio.sleep(0)
    assert [answer.ok for answer in answers] == [True, True]
    assert len(answers[1].values["scene"]["world"]["collision_objects"]) == 100


@pytest.mark.parametrize("objects", [MANY, MANY[:1]])
async def test_a_scene_whose_call_was_answered_with_a_failure_is_not_applied_afterwards(objects, caplog):
    client, answers = Client(), []
    assert client.apply(world={"collision_objects": [box("cup")]})
    contents = client.state.contents
    # Behind another change that takes a thread, also a small one waits for its turn.
    client.state.submit(SceneChange(lambda _draft: None, AT_ONCE_ELEMENTS + 1), None)
    scene = {"is_diff": True, "world": {"collision_objects": objects}, "robot_state": state_of(0.1)}
    client.graph.services.call(client.node, interface.APPLY, {"scene": scene}, answers.append, timeout_s=2.0)
    client.clock.advance(2.1)
    assert [answer.ok for answer in answers] == [False]
    await asyncio.wait_for(client.state.settled(), TIMEOUT_S)
    assert client.state.contents.objects.keys() == contents.objects.keys()
    assert client.joints() != dict.fromkeys(JOINTS, 0.1)
    assert "nothing is changed: its request ended before the change was applied" in caplog.text


async def test_a_scene_whose_client_leaves_before_it_is_made_is_made_all_the_same():
    client = Client()
    scene = {"is_diff": True, "world": {"collision_objects": MANY}, "robot_state": state_of(0.1)}
    client.graph.services.call(client.node, interface.APPLY, {"scene": scene}, lambda _answer: None)
    client.graph.services.remove(client.node)
    await asyncio.wait_for(client.state.settled(), TIMEOUT_S)
    assert len(client.state.contents.objects) == 100
    assert client.joints() != dict.fromkeys(JOINTS, 0.1)


async def test_an_assumed_state_is_given_back_to_the_client_that_set_it_and_a_scene_sent_back_assumes_nothing():
    client = Client()
    assert client.joints() == pytest.approx(BENT)
    assert client.apply(**{**client.get(), "is_diff": True})
    assert client.assumed.of(client.node) is None
    assert client.apply(robot_state=state_of(0.5))
    assert client.joints() == dict.fromkeys(JOINTS, 0.5)
    client.node = Node("another", remote=True)
    assert client.joints() == pytest.approx(BENT)


async def test_moving_frames_are_where_the_client_assumes_the_arm():
    client = Client()
    lid = box("lid", frame="gripper_link")
    assert client.apply(robot_state=state_of(0.5), world={"collision_objects": [lid]})
    expected = FORWARD.transforms(dict.fromkeys(JOINTS, 0.5))["gripper_link"]
    np.testing.assert_allclose(matrix_of(client.state.contents.objects["lid"].pose), expected, atol=1e-12)


# Not the default.
PERIOD_S = 0.5


class Watched:
    """A scene that is monitored, and who has subscribed."""

    def __init__(self):
        self.clock, self.state = FakeClock(), scene_state(box("table"))
        graph = Graph(REGISTRY, self.clock, call_later=self.clock.call_later)
        self.monitored = interface.MonitoredScenePublisher(graph, self.state, current_state(), 2.0)
        self.heard = listen(graph, interface.MONITORED_TOPIC)

    def add(self, name, **fields):
        self.state.apply(self.state.collision_object(collision_object(**box(name, **fields))).apply, BENT)


def ids(message):
    return [each["id"] for each in message["world"]["collision_objects"]]


def test_a_subscriber_gets_the_whole_scene_first_and_then_fast_changes_together_but_none_that_is_reverted():
    watched = Watched()
    (whole,) = watched.heard
    assert (whole["is_diff"], ids(whole)) == (False, ["table"])
    assert len(whole["robot_state"]["joint_state"]["name"]) == 6
    for number in range(10):
        watched.add(str(number))
        watched.clock.advance(0.1 * PERIOD_S)
    watched.clock.advance(PERIOD_S)
    assert [ids(change) for change in watched.heard[1:]] == [["0"], [str(number) for number in range(1, 10)]]
    assert all(change["is_diff"] for change in watched.heard[1:])
    # Nothing is published of a change that is reverted in time, nor after the end.
    watched.add("cup")
    watched.clock.advance(PERIOD_S)
    watched.add("pen")
    watched.add("pen", operation=1)
    watched.clock.advance(PERIOD_S)
    assert len(watched.heard) == 4
    watched.add("pen")
    watched.monitored.close()
    watched.clock.advance(PERIOD_S)
    assert len(watched.heard) == 4


STATE = state_message(BENT, ROBOT.root_link, 0.0)
RED = {"r": 1.0, "g": 0.0, "b": 0.0, "a": 1.0}
RACK = {**box("rack", at=pose(0.3)), "subframe_names": ["hook"], "subframe_poses": [pose(0.1)]}
SETTINGS = {
    "name": "kitchen",
    "link_padding": [{"link_name": "wrist_link", "padding": 0.01}],
    "link_scale": [{"link_name": "wrist_link", "scale": 1.25}],
    "object_colors": [{"id": "rack", "color": RED}],
    "allowed_collision_matrix": {"default_entry_names": ["rack"], "default_entry_values": [True]},
}


def full():
    state = scene_state(RACK, box("cup"))
    state.apply_diff(diff(robot_state={"attached_collision_objects": [held("cup")]}, **SETTINGS), BENT)
    return state


FULL = full()


FIELDS = {
    "name": interface.SCENE_SETTINGS,
    "robot_model_name": interface.SCENE_SETTINGS,
    "fixed_frame_transforms": interface.TRANSFORMS,
    "allowed_collision_matrix": interface.ALLOWED_COLLISION_MATRIX,
    "link_padding": interface.LINK_PADDING_AND_SCALING,
    "link_scale": interface.LINK_PADDING_AND_SCALING,
    "object_colors": interface.OBJECT_COLORS,
}


@pytest.mark.parametrize(("field", "component"), FIELDS.items())
def test_a_field_that_is_not_requested_is_empty(field, component):
    alone, all_of_it, without = (
        interface.scene_message(FULL.contents, ROBOT, STATE, components)[field]
        for components in (component, 0, interface.EVERYTHING - component)
    )
    assert alone == all_of_it != without == message("PlanningScene")[field]


def test_a_scene_sent_back_as_a_diff_or_whole_changes_nothing():
    state = full()
    contents, scene = state.contents, state.scene
    for is_diff in (True, False):
        sent = message("PlanningScene", **interface.scene_message(contents, ROBOT, STATE, interface.EVERYTHING)) | {
            "is_diff": is_diff
        }
        state.apply_diff(sent, BENT)
        assert (state.contents, state.scene) == (contents, scene)


ADD = {"world": {"collision_objects": [box("a")]}}
MOVE = {"world": {"collision_objects": [box("a", at=pose(0.1))]}}
REMOVE_ALL = {"world": {"collision_objects": [{"id": "", "operation": 1}]}}
TAKE = {"robot_state": {"attached_collision_objects": [held("a", **box("a"))]}}
PUT_DOWN = {"robot_state": {"attached_collision_objects": [held("", "", operation=1)]}}
CHANGES = [
    ADD,
    MOVE,
    REMOVE_ALL,
    TAKE,
    PUT_DOWN,
    {"world": {"collision_objects": [box("b", at=pose(0.1))]}},
    {"robot_state": {"attached_collision_objects": [held("b", "wrist_link", **box("b", at=pose(0.2)))]}},
    *({field: value} for field, value in SETTINGS.items()),
]


def after(changes):
    state = SceneState(ROBOT)
    for change in changes:
        # Some contradict the scene before; those change nothing.
        with contextlib.suppress(RefusedError):
            state.apply_diff(diff(**change), BENT)
    return state


@example([ADD], [MOVE])
@example([ADD], [TAKE])
@example([], [SETTINGS])
@example([TAKE], [PUT_DOWN])
@example([TAKE], [PUT_DOWN, REMOVE_ALL])
@examples(30)
@given(st.lists(st.sampled_from(CHANGES), max_size=4), st.lists(st.sampled_from(CHANGES), max_size=4))
def test_a_diff_turns_one_scene_into_another(first, then):
    follower, leader = after(first), after([*first, *then])
    sent = interface.scene_diff(follower.contents, leader.contents, ROBOT)
    # It is published as it is, and so a complete message.
    assert message("PlanningScene", **sent) == sent
    follower.apply_diff(sent, BENT)
    ours, theirs = follower.contents, leader.contents
    for mine, others in ((ours.objects, theirs.objects), (ours.attached, theirs.attached)):
        assert {name: each.message for name, each in mine.items()} == {name: e.message for name, e in others.items()}
    assert (ours.padding_m, ours.scale) == (theirs.padding_m, theirs.scale)
    assert ours.allowed_collisions == theirs.allowed_collisions
    # A difference removes no colours.
    assert theirs.colors.items() <= ours.colors.items()
