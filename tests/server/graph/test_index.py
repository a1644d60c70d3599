from __future__ import annotations

import pytest

from server.graph.index import Index, TypedNames


@pytest.fixture
def index() -> Index[str, int]:
    return Index()


def test_items_are_found_by_their_key_in_order_each_once(index: Index[str, int]) -> None:
    for item in (3, 1, 2, 1):
        index.add("a", item)
    assert index.of("a") == [3, 1, 2]
    assert index.count("a") == 3
    assert index.of("b") == []
    assert index.count("b") == 0


def test_a_key_without_items_is_none(index: Index[str, int]) -> None:
    index.add("a", 1)
    index.add("b", 1)
    index.discard("a", 1)
    assert list(index) == ["b"]


def test_what_is_not_there_can_be_taken_away(index: Index[str, int]) -> None:
    index.add("a", 1)
    index.discard("a", 2)
    index.discard("b", 1)
    assert index.of("a") == [1]


@pytest.fixture
def names() -> TypedNames:
    names = TypedNames()
    names.add("/b", "rosapi_msgs/srv/Topics")
    names.add("/c", "std_srvs/srv/Trigger")
    names.add("/a", "rosapi_msgs/srv/Topics")
    return names


def test_types_are_told_in_either_spelling(names: TypedNames) -> None:
    assert names.type_of("/a") == "rosapi_msgs/srv/Topics"
    assert names.type_of("/a", "ros1") == "rosapi/Topics"
    assert names.type_of("/x") is None
    assert names.types("ros1") == {"/b": "rosapi/Topics", "/c": "std_srvs/Trigger", "/a": "rosapi/Topics"}
    assert len(names) == 3


@pytest.mark.parametrize(
    "wanted", ["rosapi_msgs/srv/Topics", "rosapi_msgs/Topics", "rosapi/Topics", "rosapi/srv/Topics"]
)
def test_names_are_found_by_any_spelling_of_their_type(names: TypedNames, wanted: str) -> None:
    assert names.of_type(wanted) == ["/b", "/a"]


def test_a_time_is_found_by_the_name_that_either_generation_has_for_it() -> None:
    names = TypedNames()
    names.add("/now", "builtin_interfaces/msg/Time")
    assert names.of_type("builtin_interfaces/Time") == names.of_type("time") == ["/now"]


def test_nothing_is_of_a_type_that_nobody_knows(names: TypedNames) -> None:
    assert names.of_type("no/Such") == []


def test_a_name_that_is_gone_is_not_found(names: TypedNames) -> None:
    names.remove("/a")
    assert names.of_type("rosapi/Topics") == ["/b"]
    assert "/a" not in names.types()
    assert names.type_of("/a", "ros1") is None


def test_every_change_is_counted(names: TypedNames) -> None:
    before = names.revision
    names.remove("/a")
    names.add("/a", "std_srvs/srv/Trigger")
    names.types()
    assert names.revision == before + 2
