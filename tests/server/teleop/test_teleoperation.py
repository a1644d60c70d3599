"""Samples from a topic: read, refused with the field, and taken from one client at a time."""

import math
from typing import Any

import pytest

from protocol.publication import PublishedMessage
from server.errors import ServiceError
from server.graph.permissions import Node
from server.interfaces import load_registry
from server.teleop.following import STALE_S
from server.teleop.teleoperation import MAX_JOINTS, Leader, read_sample
from tests.helpers.clock import FakeClock
from tests.helpers.messages import time_message

REGISTRY = load_registry(())


def message(stamp_s: float, **positions_rad: float) -> dict[str, Any]:
    joints = {"name": list(positions_rad), "position": list(positions_rad.values()), "velocity": [], "effort": []}
    return {"header": {"stamp": time_message(stamp_s), "frame_id": ""}, **joints}


def send(leader: Leader, publisher: Node, msg: dict[str, Any], now_s: float) -> None:
    published = PublishedMessage("/glove", "sensor_msgs/msg/JointState", msg, REGISTRY, now_s, publisher=publisher)
    leader.take_message(published)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"position": []}, "name: must have 1 to 32 joints, as many as position has values, 0, not 1"),
        ({"name": [], "position": []}, "name: must have 1 to 32 joints"),
        ({"name": ["j"] * (MAX_JOINTS + 1), "position": [0.0] * (MAX_JOINTS + 1)}, "name: must have 1 to 32 joints"),
        ({"position": [math.nan]}, "position of elbow: must be a finite number, not nan"),
    ],
)
def test_a_message_that_cannot_be_followed_is_refused_with_its_field(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ServiceError, match=said):
        read_sample(message(1.0, elbow=0.5) | change, 99.0)
    clock = FakeClock()
    leader = Leader("/glove", {}, clock)
    send(leader, Node("one"), message(1.0, elbow=0.5) | change, clock.now_s)
    assert leader.joint_names == ()


def test_while_one_client_leads_another_is_not_followed_and_takes_over_after_a_silence() -> None:
    clock, one, other = FakeClock(), Node("one"), Node("other")
    leader = Leader("/glove", {}, clock)
    send(leader, one, message(50.0, elbow=0.1), clock.now_s)
    send(leader, other, message(60.0, elbow=0.9), clock.now_s)
    first = leader.samples.pose(clock.now_s)
    clock.advance(STALE_S + 0.01)
    # Its clock is far behind that of the first.
    send(leader, other, message(10.0, elbow=0.9), clock.now_s)
    second = leader.samples.pose(clock.now_s)
    assert [pose and pose.positions_rad for pose in (first, second)] == [{"elbow": 0.1}, {"elbow": 0.9}]
