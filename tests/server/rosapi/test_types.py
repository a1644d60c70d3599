from __future__ import annotations

import pytest

from server.rosapi import types
from tests.helpers.asked_world import ARM, AskedWorld


@pytest.fixture
def world() -> AskedWorld:
    return AskedWorld()


def test_raw_types_hold_the_text_of_every_dependency(world: AskedWorld) -> None:
    answer = world.ask("topics_and_raw_types")
    text = dict(zip(answer["topics"], answer["typedefs_full_text"], strict=True))["/joint_states"]
    assert "float64[] position" in text
    assert "MSG: std_msgs/Header" in text
    assert "MSG: builtin_interfaces/Time" in text


def test_message_details_have_plain_field_names(world: AskedWorld) -> None:
    main, *others = world.ask("message_details", type="sensor_msgs/JointState")["typedefs"]
    assert main["type"] == "sensor_msgs/JointState"
    assert main["fieldnames"] == ["header", "name", "position", "velocity", "effort"]
    assert main["fieldarraylen"] == [-1, 0, 0, 0, 0]
    assert {"std_msgs/Header", "builtin_interfaces/Time"} == {other["type"] for other in others}


def test_service_details_tell_both_members(world: AskedWorld) -> None:
    request = world.ask("service_request_details", type="std_srvs/SetBool")["typedefs"][0]
    response = world.ask("service_response_details", type="std_srvs/srv/SetBool")["typedefs"][0]
    assert request["fieldnames"] == ["data"]
    assert response["fieldnames"] == ["success", "message"]


@pytest.mark.parametrize("service", ["message_details", "service_request_details", "service_response_details"])
def test_details_of_a_type_that_nobody_knows_fail_with_its_name(world: AskedWorld, service: str) -> None:
    response = world.response(service, {"type": "no/Such"})
    assert not response.ok
    assert "no/Such" in response.values


def test_raw_types_are_those_of_the_callers_generation(world: AskedWorld) -> None:
    world.graph.advertise(ARM, "/log", "rcl_interfaces/Log")
    answer = world.ask("topics_and_raw_types", "ros1")
    texts = dict(zip(answer["topics"], answer["typedefs_full_text"], strict=True))
    names = dict(zip(answer["topics"], answer["types"], strict=True))
    assert "MSG: std_msgs/Header\nuint32 seq\ntime stamp\n" in texts["/joint_states"]
    assert (names["/joint_states"], names["/log"]) == ("sensor_msgs/JointState", "rcl_interfaces/Log")
    assert "time stamp\n" in texts["/log"]
    assert "builtin_interfaces" not in "".join(texts.values())
    assert "builtin_interfaces" in "".join(world.ask("topics_and_raw_types")["typedefs_full_text"])


def test_a_type_that_is_relayed_unknown_has_no_text(world: AskedWorld) -> None:
    world.graph.advertise(ARM, "/thing", "acme_msgs/Thing")
    for dialect, spelled in (("ros2", "acme_msgs/msg/Thing"), ("ros1", "acme_msgs/Thing")):
        answer = world.response("topics_and_raw_types", {}, dialect).values
        assert (answer["types"][-1], answer["typedefs_full_text"][-1]) == (spelled, "")


def test_details_are_those_of_the_callers_generation(world: AskedWorld) -> None:
    header, time = world.ask("message_details", "ros1", type="std_msgs/Header")["typedefs"]
    assert (header["fieldnames"], header["fieldtypes"]) == (["seq", "stamp", "frame_id"], ["uint32", "time", "string"])
    assert (time["type"], time["fieldnames"]) == ("time", ["secs", "nsecs"])
    request = world.ask("service_request_details", "ros1", type="rosapi/GetParam")["typedefs"][0]
    assert (request["type"], request["fieldnames"]) == ("rosapi/GetParamRequest", ["name", "default"])


def test_the_texts_of_many_topics_are_bounded(world: AskedWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = world.ask("topics_and_raw_types")["typedefs_full_text"]
    monkeypatch.setattr(types, "MAX_TEXTS_CHARACTERS", sum(map(len, whole)) - 1)
    answer = world.ask("topics_and_raw_types")
    assert answer["typedefs_full_text"] == [whole[0], ""]
    assert len(answer["topics"]) == len(answer["types"]) == 2
