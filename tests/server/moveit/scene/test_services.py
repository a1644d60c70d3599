import logging
from copy import copy

import numpy as np
import pytest

from protocol.registry import Registry
from server.graph import Graph
from server.moveit.poses import matrix_of
from server.moveit.scene.interface import APPLY, CLEAR_OCTOMAP, GET, SceneServices
from server.moveit.scene.scene_state import AssumedStates, SceneState
from server.node import Node
from tests.helpers.clock import FakeClock
from tests.helpers.planning_scene import BENT, FORWARD, JOINTS, ROBOT, box, current_state, pose

REGISTRY = Registry.load()


class Client:
    """Somebody who calls the services of a scene."""

    def __init__(self):
        self.state, self.assumed = SceneState(ROBOT), AssumedStates(ROBOT)
        self.graph = Graph(REGISTRY, call_later=FakeClock().call_later)
        self.node = Node("client", remote=True)
        SceneServices(self.graph, Node("scene"), ROBOT, self.state, self.assumed).open(current_state())

    def another(self):
        other = copy(self)
        other.node = Node("another", remote=True)
        return other

    def call(self, service, **request):
        answers = []
        self.graph.services.call(self.node, service, request, answers.append)
        assert answers[0].ok, answers[0].values
        return answers[0].values

    def get(self, components=0):
        return self.call(GET, components={"components": components})["scene"]

    def apply(self, **scene):
        return self.call(APPLY, scene={"is_diff": True, **scene})["success"]

    def joints(self):
        joint_state = self.get()["robot_state"]["joint_state"]
        return dict(zip(joint_state["name"], joint_state["position"], strict=True))


def state_of(position_rad):
    return {"is_diff": True, "joint_state": {"name": list(JOINTS), "position": [position_rad] * len(JOINTS)}}


def test_what_is_applied_is_there():
    client = Client()
    assert client.apply(world={"collision_objects": [box("cup", at=pose(0.3))]})
    (cup,) = client.another().get()["world"]["collision_objects"]
    assert (cup["id"], cup["pose"]["position"]["x"]) == ("cup", 0.3)


def test_the_answer_is_a_complete_message():
    client = Client()
    assert client.apply(world={"collision_objects": [box("cup", at=pose(0.3))]})
    for components in (0, 8, 671):
        answer = client.call(GET, components={"components": components})
        assert client.graph.interfaces.complete("moveit_msgs/srv/GetPlanningScene_Response", answer) == answer


def test_a_refusal_is_no_success_and_its_sentence_is_in_the_log(caplog):
    with caplog.at_level(logging.WARNING, "armbridge"):
        assert not Client().apply(world={"collision_objects": [{"id": "ghost", "operation": 1}]})
    assert "no object 'ghost'" in caplog.text


def test_an_assumed_state_is_given_back_to_the_client_that_set_it():
    client = Client()
    assert client.joints() == pytest.approx(BENT)
    assert client.apply(robot_state=state_of(0.5))
    assert client.joints() == dict.fromkeys(JOINTS, 0.5)
    assert client.another().joints() == pytest.approx(BENT)


def test_a_scene_sent_back_assumes_nothing():
    client = Client()
    assert client.apply(**{**client.get(), "is_diff": True})
    assert client.assumed.of(client.node) is None


def test_moving_frames_are_where_the_client_assumes_the_arm():
    client = Client()
    lid = box("lid", frame="gripper_link")
    assert client.apply(robot_state=state_of(0.5), world={"collision_objects": [lid]})
    expected = FORWARD.transforms(dict.fromkeys(JOINTS, 0.5))["gripper_link"]
    np.testing.assert_allclose(matrix_of(client.state.contents.objects["lid"].pose), expected, atol=1e-12)


def test_with_a_refusal_nothing_is_assumed():
    client = Client()
    assert not client.apply(robot_state=state_of(0.5), world={"collision_objects": [{"id": "x"}]})
    assert client.joints() == pytest.approx(BENT)


def test_a_state_that_is_none_is_refused_with_all_that_comes_with_it():
    client = Client()
    bad = {"is_diff": True, "joint_state": {"name": ["knee"], "position": [0.0]}}
    assert not client.apply(robot_state=bad, world={"collision_objects": [box("cup")]})
    assert client.state.contents.objects == {}


def test_compas_fabs_way_to_take_a_thing_again_and_again_keeps_it_in_the_hand():
    """Put everything down, assume a state, move the thing to the hand, take it by its name alone."""
    client = Client()
    assert client.apply(world={"collision_objects": [box("tool")]})
    for position_rad in (0.1, 0.4, -0.2):
        put_down = [
            {"link_name": held["link_name"], "object": {"operation": 1}}
            for held in client.get(671)["robot_state"]["attached_collision_objects"]
        ]
        assert client.apply(robot_state={**state_of(position_rad), "attached_collision_objects": put_down})
        move = {"id": "tool", "header": {"frame_id": "gripper_link"}, "pose": pose(0.1), "operation": 3}
        assert client.apply(world={"collision_objects": [move]})
        take = {"link_name": "gripper_link", "object": {"id": "tool", "header": {"frame_id": "gripper_link"}}}
        assert client.apply(robot_state={"is_diff": True, "attached_collision_objects": [take]})
        held = client.state.contents.attached["tool"].thing.pose
        np.testing.assert_allclose(held.position_m, (0.1, 0.0, 0.0), atol=1e-12)


def test_the_octomap_that_is_not_there_can_be_cleared():
    assert Client().call(CLEAR_OCTOMAP) == {}
