from __future__ import annotations

import pytest

from protocol.dialect import Dialect
from tests.helpers.asked_world import AskedWorld


@pytest.fixture
def world() -> AskedWorld:
    return AskedWorld()


def test_the_time_is_the_servers(world: AskedWorld) -> None:
    assert world.ask("get_time")["time"] == {"sec": 12, "nanosec": 500_000_000}


@pytest.mark.parametrize(
    ("dialect", "version"),
    [("ros2", {"version": 2, "distro": "jazzy"}), ("ros1", {"version": 1, "distro": "noetic"})],
)
def test_the_version_is_one_that_clients_of_the_dialect_know(
    world: AskedWorld, dialect: Dialect, version: dict[str, object]
) -> None:
    assert world.ask("get_ros_version", dialect) == version


@pytest.mark.parametrize("dialect", ["ros2", "ros1"])
def test_every_service_answers_in_both_dialects(world: AskedWorld, dialect: Dialect) -> None:
    requests = {"message_details": {"type": "std_msgs/String"}, "set_param": {"name": "/a", "value": "1"}}
    services = [name for name in world.graph.services.types() if name.startswith("/rosapi/")]
    assert len(services) == 26
    for service in services:
        short = service.removeprefix("/rosapi/")
        kind = {"type": "std_srvs/SetBool"} if short.startswith("service_re") else {}
        world.ask(short, dialect, **requests.get(short, kind))


def test_a_failed_question_fails_the_call_with_its_reason(world: AskedWorld) -> None:
    response = world.response("set_param", {"name": "/speed", "value": "{"})
    assert not response.ok
    assert "value: must be JSON text" in response.values
