from __future__ import annotations

import bson
import pytest

from protocol.registry import Registry
from protocol.session import Session
from server.gateway.client_context import MessageTranslator
from server.graph.message_types import MessageTypes, ReceivedMessage

REGISTRY = Registry.load()

HEADER = "std_msgs/msg/Header"
ROS2 = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"}
ROS1 = {"seq": 0, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "base"}
IMAGE = "sensor_msgs/msg/CompressedImage"


@pytest.fixture
def session() -> Session:
    return Session()


@pytest.fixture
def translator(session: Session) -> MessageTranslator:
    return MessageTranslator(session, REGISTRY)


def test_a_client_of_ros2_is_spelled_to_as_the_server_does(translator: MessageTranslator) -> None:
    assert translator.to_client(HEADER, ROS2) is ROS2
    assert translator.from_client(ReceivedMessage(ROS2, 0)).dialect == "ros2"


def test_a_client_of_ros1_is_understood_and_spelled_to_in_its_way(
    session: Session, translator: MessageTranslator
) -> None:
    session.dialect = "ros1"
    assert translator.to_client(HEADER, ROS2) == ROS1
    received = translator.from_client(ReceivedMessage(ROS1, 0))
    assert MessageTypes(REGISTRY).complete(HEADER, received) == ROS2


@pytest.mark.parametrize(
    ("type_name", "kind", "dialect"),
    [
        ("control_msgs/GripperCommandActionGoal", "msg", "ros1"),
        ("std_msgs/String", "msg", "ros2"),
        ("acme_msgs/Nothing", "msg", "ros2"),
        ("rosapi/Topics", "srv", "ros2"),
        (None, "srv", "ros2"),
        (["x"], "srv", "ros2"),
    ],
)
def test_a_type_that_only_ros1_has_shows_the_dialect(
    session: Session, translator: MessageTranslator, type_name: object, kind: str, dialect: str
) -> None:
    translator.detect_dialect(type_name, kind)  # type: ignore[arg-type]
    assert session.dialect == dialect


def test_a_client_that_speaks_bson_gets_octets(session: Session, translator: MessageTranslator) -> None:
    image = {"header": ROS2, "format": "png", "data": "AQI="}
    assert translator.to_client(IMAGE, image)["data"] == "AQI="
    session.receive_frame(bson.encode({"op": "set_level", "level": "none"}), 0.0)
    assert translator.to_client(IMAGE, image)["data"] == b"\x01\x02"


@pytest.mark.parametrize("type_name", ["acme_msgs/msg/Thing", "acme_msgs/srv/Do_Request"])
def test_messages_of_unknown_types_stay_as_they_are(
    session: Session, translator: MessageTranslator, type_name: str
) -> None:
    session.dialect = "ros1"
    assert translator.to_client(type_name, {"a": 1}) == {"a": 1}
    received = translator.from_client(ReceivedMessage({"a": 1}, 0))
    assert MessageTypes(REGISTRY, relay_unknown_types=True).complete(type_name, received) == {"a": 1}
