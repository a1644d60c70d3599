from __future__ import annotations

import pytest

from protocol.errors import InterfaceError, MessageError
from protocol.messages import Stamp
from protocol.registry import Registry
from server.graph.message_types import MessageTypes

REGISTRY = Registry.load()

STRICT = MessageTypes(REGISTRY, wall_clock=lambda: 12.5)
RELAYING = MessageTypes(REGISTRY, relay_unknown_types=True)


def test_the_time_of_receipt_is_now() -> None:
    assert STRICT.now() == Stamp(12, 500_000_000)
    assert STRICT.complete("std_msgs/msg/Header", {})["stamp"] == {"sec": 12, "nanosec": 500_000_000}
    assert STRICT.complete("std_msgs/msg/Header", {}, Stamp(1, 2))["stamp"] == {"sec": 1, "nanosec": 2}


@pytest.mark.parametrize("name", ["std_srvs/SetBool", "std_srvs/srv/SetBool"])
def test_names_in_two_and_three_parts_are_one(name: str) -> None:
    assert STRICT.canonical(name, "srv") == RELAYING.canonical(name, "srv") == "std_srvs/srv/SetBool"


def test_unknown_types_are_refused_unless_they_are_relayed() -> None:
    with pytest.raises(InterfaceError):
        STRICT.canonical("acme_msgs/Thing", "msg")
    assert RELAYING.canonical("acme_msgs/Thing", "msg") == "acme_msgs/msg/Thing"
    assert RELAYING.canonical("acme_msgs/srv/Do", "srv") == "acme_msgs/srv/Do"


@pytest.mark.parametrize("name", ["Thing", "a/b/c/d", ""])
def test_an_invalid_type_name_is_refused_even_when_unknown_types_are_relayed(name: str) -> None:
    with pytest.raises(InterfaceError):
        RELAYING.canonical(name, "msg")


def test_known_types_are_checked_even_then() -> None:
    with pytest.raises(MessageError):
        RELAYING.complete("std_msgs/msg/String", {"data": 5})


def test_messages_of_unknown_types_stay_as_they_are_but_are_objects() -> None:
    assert RELAYING.complete("acme_msgs/msg/Thing", {"a": [None]}) == {"a": [None]}
    with pytest.raises(MessageError, match="acme_msgs/msg/Thing"):
        RELAYING.complete("acme_msgs/msg/Thing", [1])


REQUEST = "rosapi_msgs/srv/SetParam_Request"


@pytest.mark.parametrize("arguments", [{"name": "a", "value": "1"}, ["a", "1"]])
def test_arguments_come_by_name_or_in_order(arguments: object) -> None:
    completed = STRICT.complete_arguments(REQUEST, arguments)
    assert (completed["name"], completed["value"]) == ("a", "1")


@pytest.mark.parametrize("arguments", [None, 5, "text", [], {}])
def test_anything_else_stands_for_no_arguments(arguments: object) -> None:
    assert STRICT.complete_arguments(REQUEST, arguments) == STRICT.complete(REQUEST, {})


def test_too_many_arguments_are_refused_with_the_names_there_are() -> None:
    with pytest.raises(MessageError, match=r"name, value.*got 9"):
        STRICT.complete_arguments(REQUEST, ["x"] * 9)


def test_arguments_in_order_need_a_known_type() -> None:
    with pytest.raises(MessageError, match="as an object"):
        RELAYING.complete_arguments("acme_msgs/srv/Do_Request", [1])
