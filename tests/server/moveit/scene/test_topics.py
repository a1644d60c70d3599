import logging

import pytest

from protocol.errors import MessageError
from protocol.registry import Registry
from server.graph import Graph
from server.moveit.scene.interface import SceneTopics
from server.moveit.scene.scene_state import SceneState
from server.node import Node
from tests.helpers.planning_scene import ROBOT, box, current_state


def opened():
    graph, state = Graph(Registry.load()), SceneState(ROBOT)
    SceneTopics(graph, Node("scene"), state).open(current_state())
    return graph, state


CUP = box("cup")
MESSAGES = {
    "/planning_scene": {"is_diff": True, "world": {"collision_objects": [CUP]}},
    "/planning_scene_world": {"collision_objects": [CUP]},
    "/collision_object": CUP,
    "/attached_collision_object": {
        "link_name": "gripper_link",
        "object": {**CUP, "header": {"frame_id": "gripper_link"}},
    },
}


@pytest.mark.parametrize(("topic", "message"), MESSAGES.items())
def test_every_topic_changes_the_scene(topic, message):
    graph, state = opened()
    graph.publish(Node("client"), topic, message)
    assert "cup" in {**state.contents.objects, **state.contents.attached}


@pytest.mark.parametrize("topic", MESSAGES)
def test_what_is_refused_is_told_to_the_log_by_its_topic(topic, caplog):
    graph, _ = opened()
    bad = {"id": "ghost", "operation": 1}
    messages = {
        "/planning_scene": {"is_diff": True, "world": {"collision_objects": [bad]}},
        "/planning_scene_world": {"collision_objects": [bad]},
        "/collision_object": bad,
        "/attached_collision_object": {"object": bad},
    }
    with caplog.at_level(logging.WARNING, "armbridge"):
        graph.publish(Node("client"), topic, messages[topic])
    assert topic in caplog.text
    assert "'ghost'" in caplog.text


def test_a_message_of_another_shape_is_told_to_the_log_as_well(caplog):
    graph, _ = opened()
    with caplog.at_level(logging.WARNING, "armbridge"), pytest.raises(MessageError):
        graph.publish(Node("client"), "/collision_object", {"id": 5})
    assert "/collision_object: refused" in caplog.text
