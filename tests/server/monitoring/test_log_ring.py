import logging
from collections.abc import Iterator

import pytest

from harness.clients import ArmClient
from robot import logs
from robot.logs import MAX_LINE_CHARACTERS, LogLine
from server.graph.topics import Graph
from server.monitoring.log_ring import MAX_CHARACTERS, MAX_LINES, SERVICE, LogRing, shown
from tests.helpers.graph import answered
from tests.helpers.messages import REGISTRY

LOG = logging.getLogger("armbridge.test")


@pytest.fixture
def ring() -> Iterator[LogRing]:
    made = LogRing()
    yield made
    made.close()


def line(text: str, at_s: float = 0.0) -> LogLine:
    return LogLine(at_s, logging.INFO, "armbridge.arm", "robot.control.loop", text, at_s)


def texts(ring: LogRing, from_s: float = 0.0) -> list[str]:
    return [each.text for each in ring.since(from_s)]


def test_lines_of_the_server_and_of_its_children_are_kept_as_they_come(ring: LogRing) -> None:
    LOG.warning("too %s", "hot")
    logs.pass_on(line("the arm holds"))
    assert texts(ring) == ["too hot", "the arm holds"]
    assert [each.process for each in ring.since(0.0)] == ["server", "robot.control.loop"]
    ring.close()
    LOG.warning("too late")
    logs.pass_on(line("too late"))
    assert texts(ring) == ["too hot", "the arm holds"]


def test_a_token_is_not_kept(ring: LogRing) -> None:
    LOG.warning("refused: %s", "/?token=s3cret")
    try:
        int("ws://host/?token=s3cret")
    except ValueError:
        LOG.exception("a bug")
    assert "s3cret" not in "".join(texts(ring))
    assert "ws://host/?token=***" in texts(ring)[1]


def test_the_lines_of_the_last_minute_are_told_apart(ring: LogRing) -> None:
    for at_s in (10.0, 70.0, 130.0):
        logs.pass_on(line(f"{at_s:g}", at_s))
    assert texts(ring, 70.0) == ["70", "130"]


def test_lines_without_end_and_long_ones_do_not_fill_the_memory(ring: LogRing) -> None:
    for number in range(MAX_LINES + 10):
        ring.take(line(str(number)))
    assert (len(texts(ring)), texts(ring)[0]) == (MAX_LINES, "10")
    LOG.warning("x" * 10 * MAX_LINE_CHARACTERS)
    assert len(texts(ring)[-1]) == MAX_LINE_CHARACTERS
    for _ in range(MAX_LINES):
        ring.take(line("x" * MAX_LINE_CHARACTERS))
    assert MAX_CHARACTERS - MAX_LINE_CHARACTERS < sum(map(len, texts(ring))) <= MAX_CHARACTERS


def test_a_burst_does_not_push_everything_else_out(ring: LogRing) -> None:
    LOG.warning("before the burst")
    for number in range(2 * MAX_LINES):
        LOG.warning("%d", number)
    assert texts(ring)[0] == "before the burst"


async def test_the_service_tells_the_lines_with_time_level_and_process(ring: LogRing) -> None:
    graph = Graph(REGISTRY)
    ring.offer(graph)
    ring.take(line("the arm holds", 1.5))
    told = "1970-01-01T00:00:01.500+00:00 INFO    robot.control.loop armbridge.arm: the arm holds"
    assert answered(graph, SERVICE).values == {"success": True, "message": told}
    assert shown(line("the arm holds", 1.5)) == told


async def test_a_running_server_keeps_the_lines_of_its_arm_process(client: ArmClient) -> None:
    told = (await client.call(SERVICE))["message"]
    assert "robot.control.loop armbridge.arm: " in told
    assert "armbridge is ready: " in told
