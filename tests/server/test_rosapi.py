from __future__ import annotations

import json
from typing import Any

import pytest

from protocol.registry import Registry
from server.calls import Response
from server.graph import Graph, Subscriber
from server.node import Node
from server.rosapi import MAX_PARAMETER_BYTES, RosApi, node_name

REGISTRY = Registry.load()
ARM, CLIENT = Node("arm"), Node("client 127.0.0.1:53944", remote=True)


class NoTimer:
    """Nothing here waits."""

    def cancel(self) -> None:
        pass


class World:
    """A graph with two nodes, and rosapi to ask about it."""

    def __init__(self) -> None:
        self.graph = Graph(REGISTRY, wall_clock=lambda: 12.5, call_later=lambda _delay_s, _action: NoTimer())
        RosApi(self.graph, self.graph.services, self.graph.actions, REGISTRY, lambda: 12.5).open()
        self.graph.advertise(ARM, "/joint_states", "sensor_msgs/JointState")
        self.graph.subscribe(CLIENT, "/joint_states", None, Subscriber(lambda _publication: None))
        self.graph.advertise(CLIENT, "/chatter", "std_msgs/String")
        self.graph.services.offer(ARM, "/arm/stop", "std_srvs/Trigger", lambda _request: {"success": True})

    def ask(self, service: str, /, **arguments: Any) -> dict[str, Any]:
        response = self.response(service, arguments)
        assert response.ok, response.values
        values: dict[str, Any] = response.values
        return values

    def response(self, service: str, arguments: Any) -> Response:
        responses: list[Response] = []
        self.graph.services.call(CLIENT, f"/rosapi/{service}", arguments, responses.append)
        assert len(responses) == 1
        return responses[0]


@pytest.fixture
def world() -> World:
    return World()


def test_topics_come_with_their_types(world: World) -> None:
    answer = world.ask("topics")
    assert dict(zip(answer["topics"], answer["types"], strict=True)) == {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/chatter": "std_msgs/msg/String",
    }


@pytest.mark.parametrize("type_name", ["std_msgs/String", "std_msgs/msg/String"])
def test_topics_are_found_by_either_spelling_of_their_type(world: World, type_name: str) -> None:
    assert world.ask("topics_for_type", type=type_name)["topics"] == ["/chatter"]


def test_a_type_that_nobody_knows_has_no_topics_and_no_services(world: World) -> None:
    assert world.ask("topics_for_type", type="no/Such")["topics"] == []
    assert world.ask("services_for_type", type="no/Such")["services"] == []


@pytest.mark.parametrize(("topic", "type_name"), [("joint_states", "sensor_msgs/msg/JointState"), ("/nowhere", "")])
def test_the_type_of_a_topic_is_told_and_empty_when_unknown(world: World, topic: str, type_name: str) -> None:
    assert world.ask("topic_type", topic=topic)["type"] == type_name


def test_raw_types_hold_the_text_of_every_dependency(world: World) -> None:
    answer = world.ask("topics_and_raw_types")
    text = dict(zip(answer["topics"], answer["typedefs_full_text"], strict=True))["/joint_states"]
    assert "float64[] position" in text
    assert "MSG: std_msgs/Header" in text
    assert "MSG: builtin_interfaces/Time" in text


def test_services_are_listed_with_type_and_node(world: World) -> None:
    assert {"/arm/stop", "/rosapi/services"} <= set(world.ask("services")["services"])
    assert world.ask("service_type", service="/arm/stop")["type"] == "std_srvs/srv/Trigger"
    assert world.ask("service_type", service="/nobody")["type"] == ""
    assert world.ask("services_for_type", type="std_srvs/Trigger")["services"] == ["/arm/stop"]
    assert world.ask("service_node", service="/arm/stop")["node"] == "/arm"
    assert world.ask("service_node", service="/nobody")["node"] == ""


def test_providers_are_asked_for_by_type(world: World) -> None:
    assert world.ask("service_providers", service="std_srvs/Trigger")["providers"] == ["/arm"]


def test_nodes_and_what_they_do_are_told(world: World) -> None:
    client = "/client_127_0_0_1_53944"
    assert set(world.ask("nodes")["nodes"]) == {"/arm", client, "/rosapi"}
    assert world.ask("node_details", node=client) == {
        "subscribing": ["/joint_states"],
        "publishing": ["/chatter"],
        "services": [],
    }
    assert world.ask("node_details", node="/arm")["services"] == ["/arm/stop"]
    assert world.ask("publishers", topic="/joint_states")["publishers"] == ["/arm"]
    assert world.ask("subscribers", topic="joint_states")["subscribers"] == [client]


def test_names_of_nodes_are_ros_names() -> None:
    assert node_name(CLIENT) == "/client_127_0_0_1_53944"


def test_message_details_have_plain_field_names(world: World) -> None:
    main, *others = world.ask("message_details", type="sensor_msgs/JointState")["typedefs"]
    assert main["type"] == "sensor_msgs/JointState"
    assert main["fieldnames"] == ["header", "name", "position", "velocity", "effort"]
    assert main["fieldarraylen"] == [-1, 0, 0, 0, 0]
    assert {"std_msgs/Header", "builtin_interfaces/Time"} == {other["type"] for other in others}


def test_service_details_tell_both_members(world: World) -> None:
    request = world.ask("service_request_details", type="std_srvs/SetBool")["typedefs"][0]
    response = world.ask("service_response_details", type="std_srvs/srv/SetBool")["typedefs"][0]
    assert request["fieldnames"] == ["data"]
    assert response["fieldnames"] == ["success", "message"]


@pytest.mark.parametrize("service", ["message_details", "service_request_details", "service_response_details"])
def test_details_of_a_type_that_nobody_knows_fail_with_its_name(world: World, service: str) -> None:
    response = world.response(service, {"type": "no/Such"})
    assert not response.ok
    assert "no/Such" in response.values


def test_the_time_is_the_servers(world: World) -> None:
    assert world.ask("get_time")["time"] == {"sec": 12, "nanosec": 500_000_000}


def test_the_version_is_one_that_clients_know(world: World) -> None:
    assert world.ask("get_ros_version") == {"version": 2, "distro": "jazzy"}


def test_a_parameter_is_kept_until_it_is_deleted(world: World) -> None:
    assert world.ask("get_param", name="/speed", default_value="0.1")["value"] == "0.1"
    world.ask("set_param", name="/speed", value="0.5")
    assert world.ask("get_param", name="/speed")["value"] == "0.5"
    assert world.ask("has_param", name="/speed")["exists"] is True
    assert world.ask("get_param_names")["names"] == ["/speed"]
    world.ask("delete_param", name="/speed")
    assert world.ask("has_param", name="/speed")["exists"] is False


def test_services_that_only_ros_1_has_are_answered(world: World) -> None:
    world.ask("set_param", name="/speed", value="0.5")
    assert world.ask("search_param", name="/speed")["global_name"] == "/speed"
    assert world.ask("search_param", name="/nothing")["global_name"] == ""
    assert world.ask("service_host", service="/arm/stop")["host"]
    assert world.ask("service_host", service="/nobody")["host"] == ""


@pytest.mark.parametrize(
    ("value", "words"), [("{", "JSON"), (json.dumps("x" * MAX_PARAMETER_BYTES), str(MAX_PARAMETER_BYTES))]
)
def test_a_parameter_that_cannot_be_kept_is_refused_with_its_reason(world: World, value: str, words: str) -> None:
    response = world.response("set_param", {"name": "/speed", "value": value})
    assert not response.ok
    assert words in response.values
