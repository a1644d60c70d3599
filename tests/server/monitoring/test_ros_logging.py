from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Iterator
from typing import Any

import pytest

from protocol.registry import Registry
from robot import logs as changed
from robot.logs import OUR_LOGGER
from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.monitoring.ros_logging import (
    GET_LEVELS,
    MAX_REQUESTED,
    MAX_WAITING,
    ROSOUT_TOPIC,
    SET_LEVELS,
    Rosout,
    offer_level_services,
)

LOG = logging.getLogger("armbridge.test")


@pytest.fixture
async def heard() -> AsyncIterator[list[Any]]:
    graph = Graph(Registry.load())
    rosout = Rosout(graph, asyncio.get_running_loop())
    messages: list[Any] = []
    graph.subscribe(Node("test"), ROSOUT_TOPIC, None, Subscriber(lambda publication: messages.append(publication.msg)))
    yield messages
    rosout.close()


async def test_a_record_is_published_with_level_name_and_place(heard: list[Any]) -> None:
    LOG.warning("too %s", "hot")
    await asyncio.sleep(0)
    assert [(m["level"], m["name"], m["msg"], m["file"]) for m in heard] == [
        (30, "armbridge.test", "too hot", "test_ros_logging.py")
    ]


async def test_a_record_of_another_thread_is_published(heard: list[Any]) -> None:
    await asyncio.to_thread(LOG.error, "from afar")
    async with asyncio.timeout(30.0):
        while not heard:
            await asyncio.sleep(0)
    assert [m["msg"] for m in heard] == ["from afar"]


async def test_a_token_is_not_published(heard: list[Any]) -> None:
    LOG.warning("refused: %s", "/?token=s3cret")
    await asyncio.sleep(0)
    assert [m["msg"] for m in heard] == ["refused: /?token=***"]


async def test_a_burst_is_bounded(heard: list[Any]) -> None:
    for number in range(MAX_WAITING + 500):
        LOG.warning("%d", number)
    await asyncio.sleep(0)
    assert len(heard) == MAX_WAITING
    LOG.warning("after the burst")
    await asyncio.sleep(0)
    assert heard[-1]["msg"] == "after the burst"


# Levels.

CALLER = Node("caller")


@pytest.fixture(autouse=True)
def levels_are_put_back(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(changed, "_changed", {})
    before = {name: logging.getLogger(name).level for name in (OUR_LOGGER, "armbridge.gateway")}
    yield
    for name, level in before.items():
        logging.getLogger(name).setLevel(level)


@pytest.fixture
async def graph() -> Graph:
    made = Graph(Registry.load())
    offer_level_services(made)
    return made


def call(graph: Graph, service: str, **request: Any) -> dict[str, Any]:
    responses: list[Any] = []
    graph.services.call(CALLER, service, request, responses.append)
    assert responses[0].ok, responses[0].values
    values: dict[str, Any] = responses[0].values
    return values


async def test_a_level_is_set_and_told(graph: Graph) -> None:
    done = call(graph, SET_LEVELS, levels=[{"name": "armbridge.gateway", "level": 40}])
    assert done == {"results": [{"successful": True, "reason": ""}]}
    assert logging.getLogger("armbridge.gateway").level == logging.ERROR
    told = call(graph, GET_LEVELS, names=["armbridge.gateway", "armbridge.nothing", "root"])
    assert [level["level"] for level in told["levels"]] == [40, 0, 0]


REFUSED = {
    "another's logger": ("asyncio", 10, "name: must be armbridge or a logger below it"),
    "the root": ("", 10, "name: must be"),
    "a name that is none": ("armbridge.Über", 10, "name: must be"),
    "a level between": ("armbridge", 15, "level: must be one of 0, 10, 20, 30, 40, 50, not 15"),
}


@pytest.mark.parametrize(("name", "level", "reason"), REFUSED.values(), ids=REFUSED.keys())
async def test_what_cannot_be_set_is_refused_by_field_and_value(
    graph: Graph, name: str, level: int, reason: str
) -> None:
    good = {"name": "armbridge.gateway", "level": 30}
    bad, other = call(graph, SET_LEVELS, levels=[{"name": name, "level": level}, good])["results"]
    assert not bad["successful"]
    assert reason in bad["reason"]
    assert other["successful"]


async def test_loggers_without_end_are_refused(graph: Graph) -> None:
    names = [f"armbridge.many.l{number}" for number in range(changed.MAX_CHANGED_LOGGERS + 1)]
    results = call(graph, SET_LEVELS, levels=[{"name": name, "level": 0} for name in names])["results"]
    assert [each["successful"] for each in results].count(False) == 1
    assert f"{changed.MAX_CHANGED_LOGGERS} loggers" in results[-1]["reason"]


async def test_asking_for_a_level_makes_no_logger(graph: Graph) -> None:
    call(graph, GET_LEVELS, names=["armbridge.never_seen"])
    assert "armbridge.never_seen" not in logging.root.manager.loggerDict


@pytest.mark.parametrize(
    ("service", "field", "entry"), [(GET_LEVELS, "names", "armbridge"), (SET_LEVELS, "levels", {})]
)
async def test_more_than_there_are_loggers_are_refused_at_once(
    graph: Graph, service: str, field: str, entry: object
) -> None:
    responses: list[Any] = []
    graph.services.call(CALLER, service, {field: [entry] * (MAX_REQUESTED + 1)}, responses.append)
    assert (responses[0].ok, responses[0].values) == (
        False,
        f"{field}: {MAX_REQUESTED + 1} loggers, the limit is {MAX_REQUESTED}",
    )
