import functools
import json
from typing import Any

import pytest

from protocol.dialect import Dialect
from server import rosapi
from server.errors import ServiceError
from server.graph.permissions import Node
from server.graph.services import Response
from server.graph.topics import Graph, Subscriber
from server.rosapi import DONE, MAX_PARAMETER_BYTES, Parameters, Request, RosApi
from tests.helpers.clock import FakeClock
from tests.helpers.cost import count_calls
from tests.helpers.messages import REGISTRY

DIALECTS: tuple[Dialect, ...] = ("ros2", "ros1")
ARM, CLIENT = Node("arm"), Node("client 127.0.0.1:53944", remote=True)


class AskedWorld:
    """The graph, in a time that stands still."""

    def __init__(self) -> None:
        self.graph = Graph(
            REGISTRY, wall_clock=lambda: 12.5, call_later=FakeClock().call_later, relay_unknown_types=True
        )
        RosApi(self.graph)
        self.graph.advertise(ARM, "/joint_states", "sensor_msgs/JointState")
        self.graph.subscribe(CLIENT, "/joint_states", None, Subscriber(lambda _published: None))
        self.graph.advertise(CLIENT, "/chatter", "std_msgs/String")
        self.graph.services.offer(ARM, "/arm/stop", "std_srvs/Trigger", lambda _request: {"success": True})

    def ask(self, service: str, dialect: Dialect = "ros2", /, **arguments: Any) -> Any:
        response = self.response(service, arguments, dialect)
        assert response.ok, response.values
        return response.values

    def response(self, service: str, arguments: Any, dialect: Dialect = "ros2") -> Response:
        responses: list[Response] = []
        self.graph.services.call(CLIENT, f"/rosapi/{service}", arguments, responses.append, dialect=dialect)
        assert len(responses) == 1
        return responses[0]


@pytest.fixture
def world() -> AskedWorld:
    return AskedWorld()


def test_clients_of_a_dialect_know_it(world: AskedWorld) -> None:
    assert world.ask("get_ros_version") == {"version": 2, "distro": "jazzy"}
    assert world.ask("get_ros_version", "ros1") == {"version": 1, "distro": "noetic"}


def test_a_failed_question_fails_the_call_with_its_reason(world: AskedWorld) -> None:
    response = world.response("set_param", {"name": "/speed", "value": "{"})
    assert not response.ok
    assert "value: must be JSON text" in response.values


def test_topics_are_found_by_every_spelling_of_their_type(world: AskedWorld) -> None:
    world.graph.advertise(CLIENT, "/now", "builtin_interfaces/Time")
    for topic, spellings in {
        "/chatter": ("std_msgs/String", "std_msgs/msg/String"),
        "/now": ("builtin_interfaces/Time", "time"),
    }.items():
        for type_name in spellings:
            assert world.ask("topics_for_type", type=type_name)["topics"] == [topic], type_name
    assert world.ask("topics_for_type", type="no/Such")["topics"] == []
    assert world.ask("services_for_type", type="no/Such")["services"] == []
    assert world.ask("topic_type", topic="joint_states")["type"] == "sensor_msgs/msg/JointState"
    assert world.ask("topic_type", topic="/nowhere")["type"] == ""


def test_services_and_nodes_are_told_with_what_they_do(world: AskedWorld) -> None:
    assert {"/arm/stop", "/rosapi/services"} <= set(world.ask("services")["services"])
    assert world.ask("services_for_type", type="std_srvs/Trigger")["services"] == ["/arm/stop"]
    assert world.ask("service_providers", service="std_srvs/Trigger")["providers"] == ["/arm"]
    for service, type_name, node in (("/arm/stop", "std_srvs/srv/Trigger", "/arm"), ("/nobody", "", "")):
        assert world.ask("service_type", service=service)["type"] == type_name
        assert world.ask("service_node", service=service)["node"] == node
        assert bool(world.ask("service_host", service=service)["host"]) is bool(node)
    client = "/client_127_0_0_1_53944"
    assert set(world.ask("nodes")["nodes"]) == {"/arm", client, "/rosapi"}
    details = {"subscribing": ["/joint_states"], "publishing": ["/chatter"], "services": []}
    assert world.ask("node_details", node=client) == details
    assert world.ask("node_details", node="/arm")["services"] == ["/arm/stop"]
    assert world.ask("publishers", topic="/joint_states")["publishers"] == ["/arm"]
    assert world.ask("subscribers", topic="joint_states")["subscribers"] == [client]


def test_types_of_messages_and_actions_are_told_with_every_part(world: AskedWorld) -> None:
    first = world.ask("message_details", type="sensor_msgs/JointState")
    main, *others = first["typedefs"]
    assert main["type"] == "sensor_msgs/JointState"
    assert main["fieldnames"] == ["header", "name", "position", "velocity", "effort"]
    assert main["fieldarraylen"] == [-1, 0, 0, 0, 0]
    assert {"std_msgs/Header", "builtin_interfaces/Time"} == {other["type"] for other in others}
    for part, field in {"goal": "command", "result": "reached_goal", "feedback": "stalled"}.items():
        for dialect in DIALECTS:
            details = world.ask(f"action_{part}_details", dialect, type="control_msgs/GripperCommand")
            assert field in details["typedefs"][0]["fieldnames"], (part, dialect)
    world.graph.actions.offer(ARM, "/grip", "control_msgs/GripperCommand", lambda _goal: None)
    assert world.ask("action_type", action="grip")["type"] == "control_msgs/action/GripperCommand"
    assert world.ask("action_type", "ros1", action="/grip")["type"] == "control_msgs/GripperCommand"
    assert world.ask("action_type", action="/nobody")["type"] == ""


def test_all_types_are_listed_by_kind_and_to_a_ros1_client_those_of_ros1(world: AskedWorld) -> None:
    interfaces = world.ask("interfaces")["interfaces"]
    assert {"std_msgs/msg/String", "std_srvs/srv/SetBool", "control_msgs/action/GripperCommand"} <= set(interfaces)
    assert len(interfaces) == len(set(interfaces)) == len(list(REGISTRY.type_names()))
    interfaces = world.ask("interfaces", "ros1")["interfaces"]
    assert {"std_msgs/String", "rosgraph_msgs/Log", "control_msgs/GripperCommandActionGoal"} <= set(interfaces)
    assert not any(name.startswith("rcl_interfaces/") for name in interfaces)


HIDDEN = "/grip/_action/cancel_goal"


def test_what_belongs_to_an_action_is_not_listed_but_found_by_name(world: AskedWorld) -> None:
    world.graph.actions.offer(ARM, "/grip", "control_msgs/GripperCommand", lambda _goal: None)
    world.graph.advertise(ARM, "/grip/_hidden", "std_msgs/Empty")
    assert not any("/_" in name for name in world.ask("services")["services"])
    assert not any("/_" in name for name in world.ask("topics")["topics"])
    raw = world.ask("topics_and_raw_types")
    assert not any("/_" in name for name in raw["topics"])
    assert len(raw["topics"]) == len(raw["typedefs_full_text"])
    assert world.ask("services_for_type", type="action_msgs/CancelGoal")["services"] == []
    assert world.ask("topics_for_type", type="std_msgs/Empty")["topics"] == []
    assert world.ask("service_type", service=HIDDEN)["type"] == "action_msgs/srv/CancelGoal"
    assert world.ask("topic_type", topic="/grip/_hidden")["type"] == "std_msgs/msg/Empty"
    world.graph.remove(ARM)
    assert world.ask("topics")["topics"] == world.ask("topics", "ros1")["topics"]


DETAILS = ["message", "service_request", "service_response", "action_goal", "action_result", "action_feedback"]


def test_details_of_a_type_that_nobody_knows_fail_with_its_name(world: AskedWorld) -> None:
    for part in DETAILS:
        response = world.response(f"{part}_details", {"type": "no/Such"})
        assert (response.ok, "no/Such" in str(response.values)) == (False, True), part


def test_raw_types_are_those_of_the_callers_generation_and_empty_if_unknown(world: AskedWorld) -> None:
    world.graph.advertise(ARM, "/log", "rcl_interfaces/Log")
    answer = world.ask("topics_and_raw_types", "ros1")
    texts = dict(zip(answer["topics"], answer["typedefs_full_text"], strict=True))
    names = dict(zip(answer["topics"], answer["types"], strict=True))
    assert "MSG: std_msgs/Header\nuint32 seq\ntime stamp\n" in texts["/joint_states"]
    assert (names["/joint_states"], names["/log"]) == ("sensor_msgs/JointState", "rosgraph_msgs/Log")
    assert dict(zip(*world.ask("topics", "ros1").values(), strict=True)) == names
    assert "MSG: std_msgs/Header\n" in texts["/log"]
    assert "builtin_interfaces" not in "".join(texts.values())
    answer = world.ask("topics_and_raw_types")
    text = dict(zip(answer["topics"], answer["typedefs_full_text"], strict=True))["/joint_states"]
    assert all(each in text for each in ("float64[] position", "MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"))
    world.graph.advertise(ARM, "/thing", "acme_msgs/Thing")
    for dialect, spelled in (("ros2", "acme_msgs/msg/Thing"), ("ros1", "acme_msgs/Thing")):
        answer = world.response("topics_and_raw_types", {}, dialect).values
        assert (answer["types"][-1], answer["typedefs_full_text"][-1]) == (spelled, "")


def test_the_texts_of_many_topics_are_bounded(world: AskedWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = world.ask("topics_and_raw_types")["typedefs_full_text"]
    monkeypatch.setattr(rosapi, "MAX_TEXTS_CHARACTERS", sum(map(len, whole)) - 1)
    answer = AskedWorld().ask("topics_and_raw_types")
    assert answer["typedefs_full_text"] == [whole[0], ""]
    assert len(answer["topics"]) == len(answer["types"]) == 2


def test_every_response_is_complete_as_it_is(world: AskedWorld) -> None:
    details = {f"action_{part}_details": {"type": "control_msgs/PointHead"} for part in ("goal", "result", "feedback")}
    given = details | {"message_details": {"type": "sensor_msgs/JointState"}, "set_param": {"name": "/a", "value": "1"}}
    by_field = {"type": "std_srvs/SetBool", "topic": "/joint_states", "service": "/arm/stop", "node": "/arm"}
    types = world.graph.message_types
    for service, type_name in world.graph.services.names.types().items():
        if service.startswith("/rosapi/"):
            short = service.removeprefix("/rosapi/")
            fields = [field.name for field in types.registry.message(f"{type_name}_Request").fields]
            arguments: Any = {name: by_field[name] for name in fields if name in by_field} | given.get(short, {})
            world.ask(short, "ros1", **arguments)
            response = world.ask(short, "ros2", **arguments)
            completed = types.complete(f"{type_name}_Response", response)
            assert response == completed
            assert list(response) == list(completed), service


def test_a_lookup_costs_the_same_however_much_others_offer() -> None:
    for service, arguments in (
        ("nodes", {}),
        *((service, {"topic": "/joint_states"}) for service in ("topic_type", "publishers")),
        ("topics_for_type", {"type": "std_msgs/String"}),
        ("services_for_type", {"type": "std_srvs/Trigger"}),
        ("service_providers", {"service": "std_srvs/Trigger"}),
        ("node_details", {"node": "/arm"}),
    ):
        costs = []
        for others in (10, 1000):
            world, other = AskedWorld(), Node("other", remote=True)
            for number in range(others):
                world.graph.advertise(other, f"/t{number}", "std_msgs/Empty")
                world.graph.services.offer_calls(other, f"/s{number}", "std_srvs/SetBool", lambda _call: None)
            costs.append(count_calls(functools.partial(world.ask, service, **arguments)))
        assert costs[0] == costs[1], service


def test_a_client_that_has_shown_who_it_is_is_found_by_its_new_name(world: AskedWorld) -> None:
    world.ask("nodes")
    CLIENT.name, former = "ada (127.0.0.1:53944)", CLIENT.name
    try:
        assert "/ada_127_0_0_1_53944" in world.ask("nodes")["nodes"]
        assert world.ask("node_details", node="/ada_127_0_0_1_53944")["publishing"] == ["/chatter"]
    finally:
        CLIENT.name = former


class Kept(Parameters):
    """Parameters, asked as by a service."""

    def ask(self, service: str, dialect: Dialect = "ros2", /, **request: Any) -> dict[str, Any]:
        return self.handlers[service](Request(request, dialect))


@pytest.fixture
def kept() -> Kept:
    return Kept()


def test_a_parameter_is_kept_until_it_is_deleted(kept: Kept) -> None:
    assert kept.ask("set_param", name="/speed", value="0.5") == DONE
    assert kept.ask("get_param", name="/speed", default_value="") == {**DONE, "value": "0.5"}
    assert kept.ask("search_param", name="/speed") == {"global_name": "/speed"}
    assert kept.ask("delete_param", name="/speed") == DONE
    assert kept.ask("has_param", name="/speed") == {"exists": False}
    assert kept.ask("search_param", name="/speed") == {"global_name": ""}


def test_the_default_of_an_unknown_parameter_is_answered_as_json_and_one_that_is_no_json_refused(kept: Kept) -> None:
    defaults = {"0.1": 0.1, '"text"': "text", "text": "text", "null": None, "{": "{", "[" * 200_000: "[" * 200_000}
    for default, value in defaults.items():
        answer = kept.ask("get_param", name="/nothing", default_value=default)
        assert json.loads(answer.pop("value")) == value
        assert answer == DONE
    for value in ("", "{", "[" * 200_000):
        with pytest.raises(ServiceError, match="value: must be JSON text"):
            kept.ask("set_param", name="/speed", value=value)
    assert kept.ask("get_param_names") == {"names": []}


def test_parameters_have_the_name_of_their_node_and_those_of_the_server_are_there(kept: Kept) -> None:
    kept.ask("set_param", name="camera:rate", value="30")
    for name in ("camera:rate", "/camera:rate"):
        assert kept.ask("get_param", name=name, default_value="")["value"] == "30"
        assert kept.ask("has_param", name=name) == {"exists": True}
    assert kept.ask("get_param_names") == {"names": ["/camera:rate"]}
    kept.keep("/robot_description", '"<robot/>"')
    assert kept.ask("get_param", name="/robot_description", default_value="")["value"] == '"<robot/>"'
    kept.ask("delete_param", name="/robot_description")
    assert kept.ask("get_param_names") == {"names": ["/camera:rate"]}


def test_the_number_of_parameters_is_bounded(kept: Kept, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rosapi, "MAX_PARAMETERS", 2)
    for name in ("/a", "/b", "/a"):
        kept.ask("set_param", name=name, value="1")
    with pytest.raises(ServiceError, match="there are 2 parameters already"):
        kept.ask("set_param", name="/c", value="1")


def test_all_parameters_together_are_bounded_in_bytes_and_a_deleted_one_makes_room(kept: Kept) -> None:
    half = json.dumps("x" * (MAX_PARAMETER_BYTES // 2))
    kept.ask("set_param", name="/a", value=half)
    kept.ask("set_param", name="/a", value=half)
    with pytest.raises(ServiceError, match=f"the limit is {MAX_PARAMETER_BYTES}"):
        kept.ask("set_param", name="/b", value=half)
    with pytest.raises(ServiceError, match="the limit is"):
        kept.ask("set_param", name="x" * MAX_PARAMETER_BYTES, value="1")
    kept.ask("delete_param", name="/a")
    kept.ask("delete_param", name="/a")
    kept.ask("set_param", name="/b", value=half)
    assert kept.ask("get_param_names") == {"names": ["/b"]}
