import pytest

from protocol.errors import InterfaceError, MessageError
from protocol.messages import ListLimits
from protocol.publication import LARGE_BYTES
from server.graph.message_types import (
    BYTES_AT_ONCE,
    FREE_VALUES,
    ROS1_BYTES_AT_ONCE,
    VALUES_AT_ONCE,
    MessageTypes,
    PostponedError,
    ReceivedMessage,
)
from tests.helpers.messages import REGISTRY

STRICT, RELAYING = MessageTypes(REGISTRY), MessageTypes(REGISTRY, relay_unknown_types=True)
POSES = "geometry_msgs/msg/PoseArray"


@pytest.mark.parametrize("name", ["Thing", "a/b/c/d", ""])
def test_an_invalid_type_name_is_refused_even_when_unknown_types_are_relayed(name: str) -> None:
    with pytest.raises(InterfaceError):
        RELAYING.canonical(name, "msg")


def test_messages_of_unknown_types_are_objects_as_they_came() -> None:
    assert RELAYING.complete("acme_msgs/msg/Thing", {"a": [None]}) == {"a": [None]}
    with pytest.raises(MessageError, match="acme_msgs/msg/Thing"):
        RELAYING.complete("acme_msgs/msg/Thing", [1])
    with pytest.raises(MessageError, match="as an object"):
        RELAYING.complete_arguments("acme_msgs/srv/Do_Request", [1])


def test_a_small_message_of_a_client_is_completed_at_once_and_any_of_the_server_itself() -> None:
    received = ReceivedMessage({"poses": [{}] * 10}, 50)
    assert len(STRICT.complete(POSES, received)["poses"]) == 10
    assert received.cost_bytes == 50
    assert len(STRICT.complete(POSES, {"poses": [{}] * FREE_VALUES})["poses"]) == FREE_VALUES


def test_a_large_message_of_a_client_is_completed_in_the_background_first() -> None:
    for received in (
        ReceivedMessage({"poses": [{}] * (VALUES_AT_ONCE // 7 + 1)}, 2000),
        ReceivedMessage({"poses": []}, BYTES_AT_ONCE + 1),
        ReceivedMessage({"poses": []}, ROS1_BYTES_AT_ONCE + 1, "ros1"),
    ):
        with pytest.raises(PostponedError) as postponed:
            STRICT.complete(POSES, received)
        assert postponed.value.message is received
        received.complete(STRICT, postponed.value.type_name)
        assert STRICT.complete(POSES, received) is STRICT.complete(POSES, received)
        assert received.cost_bytes >= LARGE_BYTES


def test_a_message_completed_for_another_type_is_not_taken_and_an_error_is_raised_when_it_is_used() -> None:
    received = ReceivedMessage({"poses": []}, BYTES_AT_ONCE + 1)
    received.complete(STRICT, POSES)
    with pytest.raises(PostponedError):
        STRICT.complete("geometry_msgs/msg/Polygon", received)
    received = ReceivedMessage({"poses": [{"position": 1}]}, BYTES_AT_ONCE + 1)
    received.complete(STRICT, POSES)
    with pytest.raises(MessageError, match="position"):
        STRICT.complete(POSES, received)


def test_a_message_grows_by_what_came_and_a_little_no_more() -> None:
    elements = FREE_VALUES // 7 + 1
    received = ReceivedMessage({"poses": [{}] * elements}, 0)
    with pytest.raises(MessageError, match=f"at most {FREE_VALUES} values"):
        STRICT.complete(POSES, received)
    longer = ReceivedMessage({"poses": [{}] * elements}, 7)
    longer.complete(STRICT, POSES)
    assert len(STRICT.complete(POSES, longer)["poses"]) == elements


def test_a_message_that_a_thread_completes_has_the_limits_of_its_reader() -> None:
    type_name = "moveit_msgs/srv/GetMotionSequence_Request"
    limits = ListLimits({"moveit_msgs/msg/MotionSequenceRequest.items": 2})
    # In order of declaration, fields count as well.
    message = ReceivedMessage([{"items": [{}] * 3}], BYTES_AT_ONCE + 1)
    with pytest.raises(PostponedError):
        STRICT.complete_arguments(type_name, message, limits)
    message.complete(STRICT, type_name)
    with pytest.raises(MessageError, match="at most 2 elements in all, got 3"):
        STRICT.complete_arguments(type_name, message, limits)
