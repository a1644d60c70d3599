from __future__ import annotations

import pytest

from server.rosapi.question import Question, of_type


def test_a_name_is_qualified() -> None:
    assert Question({"topic": "chat"}, "ros2").name("topic") == "/chat"


def test_types_are_spelled_for_the_caller() -> None:
    names = ["std_msgs/msg/String", "rosapi_msgs/srv/Topics"]
    assert Question({}, "ros2").spell_all(names) == names
    assert Question({}, "ros1").spell_all(names) == ["std_msgs/String", "rosapi/Topics"]
    assert Question({}, "ros1").spell("") == ""


@pytest.mark.parametrize(
    "wanted", ["rosapi_msgs/srv/Topics", "rosapi_msgs/Topics", "rosapi/Topics", "rosapi/srv/Topics"]
)
def test_names_are_found_by_any_spelling_of_their_type(wanted: str) -> None:
    types = {"/b": "rosapi_msgs/srv/Topics", "/c": "std_srvs/srv/Trigger", "/a": "rosapi_msgs/srv/Topics"}
    assert of_type(types, wanted) == ["/a", "/b"]


def test_a_time_is_found_by_the_name_that_either_generation_has_for_it() -> None:
    types = {"/now": "builtin_interfaces/msg/Time"}
    assert of_type(types, "builtin_interfaces/Time") == of_type(types, "time") == ["/now"]


def test_nothing_is_of_a_type_that_nobody_knows() -> None:
    assert of_type({"/a": "std_msgs/msg/String"}, "no/Such") == []
