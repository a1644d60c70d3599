from __future__ import annotations

from typing import Any

import pytest

from protocol.limits import Limits
from tests.helpers.conformance import cases, play
from tests.helpers.in_process import InProcess


@pytest.mark.parametrize("case", cases(), ids=lambda case: case["name"])
async def test_conformance_in_process(case: dict[str, Any]) -> None:
    options = {option: case.get(option, False) for option in ("relay_unknown_types", "rosapi")}
    await play(case, InProcess(**options))


@pytest.fixture
def world() -> InProcess:
    return InProcess()


def test_a_refusal_is_logged_with_client_operation_and_reason(
    world: InProcess, caplog: pytest.LogCaptureFixture
) -> None:
    world.say("x", op="publish", topic="/nobody", msg={})
    assert "x: refused: publish: topic /nobody" in caplog.text


def test_a_bug_in_one_operation_does_not_take_the_client_with_it(
    world: InProcess, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(world.graph, "advertise", lambda *_, **__: 1 / 0)
    world.say("x", op="advertise", topic="/a", type="std_msgs/String")
    assert "x: advertise failed" in caplog.text
    world.say("x", op="subscribe", topic="/b", type="std_msgs/String")
    assert "/b" in world.graph.topic_types()


async def test_a_client_that_leaves_takes_all_with_it(world: InProcess) -> None:
    world.say("x", op="advertise_service", service="/s", type="std_srvs/SetBool")
    world.say("x", op="advertise_action", action="/a", type="control_msgs/PointHead")
    world.say("x", op="subscribe", topic="/t", type="std_msgs/String")
    await world.close("x")
    assert world.graph.services.types() == {}
    assert world.graph.actions.types() == {}
    assert world.graph.topic_types() == {}


async def test_messages_that_were_dropped_are_told_when_the_client_leaves(caplog: pytest.LogCaptureFixture) -> None:
    world = InProcess(Limits(max_queued_topic_bytes=1000))
    slow = world.client("slow")
    slow.receive_frame('{"op":"subscribe","topic":"/t","type":"std_msgs/String"}')
    talker = world.client("talker")
    for _ in range(10):
        talker.receive_frame('{"op":"publish","topic":"/t","msg":{"data":"%s"}}' % ("x" * 200))
    await world.close("slow")
    assert f"slow: {slow.session.dropped} messages were dropped" in caplog.text
    assert slow.session.dropped > 0
