from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import pytest

from protocol.registry import Registry
from robot import logs as changed
from robot.logs import OUR_LOGGER
from server.graph.node import Node
from server.graph.topics import Graph
from server.operations import log_levels
from server.operations.log_levels import GET, MAX_ASKED, SET, LogLevels, toggle_debug

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
    LogLevels(made).open()
    return made


def call(graph: Graph, service: str, **request: Any) -> dict[str, Any]:
    responses: list[Any] = []
    graph.services.call(CALLER, service, request, responses.append)
    assert responses[0].ok, responses[0].values
    values: dict[str, Any] = responses[0].values
    return values


async def test_a_level_is_set_and_told(graph: Graph) -> None:
    done = call(graph, SET, levels=[{"name": "armbridge.gateway", "level": 40}])
    assert done == {"results": [{"successful": True, "reason": ""}]}
    assert logging.getLogger("armbridge.gateway").level == logging.ERROR
    told = call(graph, GET, names=["armbridge.gateway", "armbridge.nothing", "root"])
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
    bad, other = call(graph, SET, levels=[{"name": name, "level": level}, good])["results"]
    assert not bad["successful"]
    assert reason in bad["reason"]
    assert other["successful"]


async def test_loggers_without_end_are_refused(graph: Graph) -> None:
    names = [f"armbridge.many.l{number}" for number in range(changed.MAX_CHANGED_LOGGERS + 1)]
    results = call(graph, SET, levels=[{"name": name, "level": 0} for name in names])["results"]
    assert [each["successful"] for each in results].count(False) == 1
    assert f"{changed.MAX_CHANGED_LOGGERS} loggers" in results[-1]["reason"]


async def test_asking_for_a_level_makes_no_logger(graph: Graph) -> None:
    call(graph, GET, names=["armbridge.never_seen"])
    assert "armbridge.never_seen" not in logging.root.manager.loggerDict


def test_the_signal_begins_and_ends_debugging(caplog: pytest.LogCaptureFixture) -> None:
    toggle_debug()
    assert log_levels.log.isEnabledFor(logging.DEBUG)
    toggle_debug()
    assert logging.getLogger(OUR_LOGGER).level == logging.NOTSET
    assert ["debug now" in record.message for record in caplog.records] == [True, False]


@pytest.mark.parametrize(("service", "field", "entry"), [(GET, "names", "armbridge"), (SET, "levels", {})])
async def test_more_than_there_are_loggers_are_refused_at_once(
    graph: Graph, service: str, field: str, entry: object
) -> None:
    responses: list[Any] = []
    graph.services.call(CALLER, service, {field: [entry] * (MAX_ASKED + 1)}, responses.append)
    assert (responses[0].ok, responses[0].values) == (
        False,
        f"{field}: {MAX_ASKED + 1} loggers, the limit is {MAX_ASKED}",
    )
