from __future__ import annotations

import pytest

from server.rosapi.participants import node_name
from tests.helpers.asked_world import CLIENT, AskedWorld


@pytest.fixture
def world() -> AskedWorld:
    return AskedWorld()


def test_topics_come_with_their_types(world: AskedWorld) -> None:
    answer = world.ask("topics")
    assert dict(zip(answer["topics"], answer["types"], strict=True)) == {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/chatter": "std_msgs/msg/String",
    }


@pytest.mark.parametrize("type_name", ["std_msgs/String", "std_msgs/msg/String"])
def test_topics_are_found_by_either_spelling_of_their_type(world: AskedWorld, type_name: str) -> None:
    assert world.ask("topics_for_type", type=type_name)["topics"] == ["/chatter"]


def test_a_type_that_nobody_knows_has_no_topics_and_no_services(world: AskedWorld) -> None:
    assert world.ask("topics_for_type", type="no/Such")["topics"] == []
    assert world.ask("services_for_type", type="no/Such")["services"] == []


@pytest.mark.parametrize(("topic", "type_name"), [("joint_states", "sensor_msgs/msg/JointState"), ("/nowhere", "")])
def test_the_type_of_a_topic_is_told_and_empty_when_unknown(world: AskedWorld, topic: str, type_name: str) -> None:
    assert world.ask("topic_type", topic=topic)["type"] == type_name


def test_services_are_listed_with_type_and_node(world: AskedWorld) -> None:
    assert {"/arm/stop", "/rosapi/services"} <= set(world.ask("services")["services"])
    assert world.ask("service_type", service="/arm/stop")["type"] == "std_srvs/srv/Trigger"
    assert world.ask("service_type", service="/nobody")["type"] == ""
    assert world.ask("services_for_type", type="std_srvs/Trigger")["services"] == ["/arm/stop"]
    assert world.ask("service_node", service="/arm/stop")["node"] == "/arm"
    assert world.ask("service_node", service="/nobody")["node"] == ""


def test_providers_are_asked_for_by_type(world: AskedWorld) -> None:
    assert world.ask("service_providers", service="std_srvs/Trigger")["providers"] == ["/arm"]


def test_nodes_and_what_they_do_are_told(world: AskedWorld) -> None:
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


def test_a_service_is_on_the_servers_host(world: AskedWorld) -> None:
    assert world.ask("service_host", service="/arm/stop")["host"]
    assert world.ask("service_host", service="/nobody")["host"] == ""


def test_types_are_spelled_as_the_callers_generation_does(world: AskedWorld) -> None:
    topics = world.ask("topics", "ros1")
    assert dict(zip(topics["topics"], topics["types"], strict=True)) == {
        "/joint_states": "sensor_msgs/JointState",
        "/chatter": "std_msgs/String",
    }
    assert world.ask("topic_type", "ros1", topic="chatter")["type"] == "std_msgs/String"
    assert world.ask("topic_type", "ros1", topic="/nowhere")["type"] == ""
    assert world.ask("service_type", "ros1", service="/arm/stop")["type"] == "std_srvs/Trigger"
    assert world.ask("service_type", "ros1", service="/rosapi/topics")["type"] == "rosapi/Topics"
