"""Log records of both generations."""

from typing import Any

import pytest

from protocol.dialect import declared_in_ros1, from_ros1, spell_type, to_ros1
from protocol.errors import MessageError
from protocol.messages import Stamp, complete
from protocol.registry import Registry
from protocol.type_descriptions import typedefs

REGISTRY = Registry.load()
NOW = Stamp(1, 2)
LEVELS = [(10, 1), (20, 2), (30, 4), (40, 8), (50, 16)]


def record(**fields: Any) -> dict[str, Any]:
    return complete(REGISTRY, "rcl_interfaces/Log", fields, NOW)


@pytest.mark.parametrize(("ours", "theirs"), LEVELS)
def test_each_level_has_its_number_in_either_generation(ours: int, theirs: int) -> None:
    spelled = to_ros1(REGISTRY, "rcl_interfaces/Log", record(level=ours))
    assert spelled["level"] == theirs
    assert from_ros1(REGISTRY, "rcl_interfaces/Log", {"level": theirs}) == {"level": ours}


@pytest.mark.parametrize(("level", "theirs"), [(0, 1), (5, 1), (25, 2), (49, 8), (255, 16)])
def test_a_level_between_two_counts_as_the_lower_one(level: int, theirs: int) -> None:
    assert to_ros1(REGISTRY, "rcl_interfaces/Log", record(level=level))["level"] == theirs


def test_the_levels_are_those_of_both_definitions() -> None:
    ours = [constant.value for constant in REGISTRY.message("rcl_interfaces/Log").constants]
    theirs = [constant.value for constant in REGISTRY.ros1.message("rosgraph_msgs/Log").constants]
    assert list(zip(ours, theirs, strict=True)) == LEVELS


def test_a_record_goes_out_with_the_fields_that_ros1_declares() -> None:
    message = record(stamp={"sec": 3, "nanosec": 4}, level=30, name="n", msg="m", file="f", function="g", line=5)
    spelled = to_ros1(REGISTRY, "rcl_interfaces/Log", message)
    assert sorted(spelled) == sorted(field.name for field in REGISTRY.ros1.message("rosgraph_msgs/Log").fields)
    assert spelled == {
        "header": {"seq": 0, "stamp": {"secs": 3, "nsecs": 4}, "frame_id": ""},
        "level": 4,
        "name": "n",
        "msg": "m",
        "file": "f",
        "function": "g",
        "line": 5,
        "topics": [],
    }
    assert complete(REGISTRY, "rcl_interfaces/Log", from_ros1(REGISTRY, "rcl_interfaces/Log", spelled), NOW) == message


@pytest.mark.parametrize("message", [[], {"header": 7}, {"header": {"stamp": []}}, {"level": "high"}])
def test_what_cannot_be_understood_is_left_for_the_validation(message: object) -> None:
    with pytest.raises(MessageError):
        complete(REGISTRY, "rcl_interfaces/Log", from_ros1(REGISTRY, "rcl_interfaces/Log", message), NOW)


@pytest.mark.parametrize("name", ["rcl_interfaces/msg/Log", "rcl_interfaces/Log"])
def test_ros1_clients_are_told_their_own_type(name: str) -> None:
    assert spell_type(name, "ros1") == "rosgraph_msgs/Log"
    assert declared_in_ros1(REGISTRY, name).name == "rosgraph_msgs/msg/Log"
    assert typedefs(REGISTRY, name, "ros1")[0]["fieldnames"][0] == "header"
