"""The log in ROS: records on ``/rosout``, and services for the loggers' levels, as ROS 2 nodes have them."""

from __future__ import annotations

import asyncio
import logging
import re
from typing import Any

from protocol.messages import Stamp
from robot import logs
from robot.logs import MAX_CHANGED_LOGGERS, OUR_LOGGER, LoggerLevel, message_of
from server.errors import ServiceError
from server.graph.node import Node
from server.graph.topics import Graph

log = logging.getLogger("armbridge.monitoring")

ROSOUT_TOPIC = "/rosout"

# A longer burst repeats itself; records that are left out are still in the log itself.
MAX_WAITING = 1000

GET_LEVELS = "/armbridge/get_logger_levels"
SET_LEVELS = "/armbridge/set_logger_levels"

# rcl_interfaces/LoggerLevel counts as Python does; 0 leaves the level to the parent logger.
LEVELS = {
    0: "unset",
    logging.DEBUG: "debug",
    logging.INFO: "info",
    logging.WARNING: "warn",
    logging.ERROR: "error",
    logging.CRITICAL: "fatal",
}

# Loggers in one request; there are a few dozen.
MAX_REQUESTED = 1000

_OURS = re.compile(rf"{OUR_LOGGER}(\.[a-z0-9_]{{1,40}}){{0,4}}")


class Rosout(logging.Handler):
    """Publishes every record of the server's log, from its construction to :meth:`close`.

    Args:
        graph: graph to publish on.
        loop: the event loop of the graph; records come from other threads as well.
    """

    def __init__(self, graph: Graph, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._graph = graph
        self._loop = loop
        self._node = Node("rosout")
        self._waiting = 0
        graph.advertise(self._node, ROSOUT_TOPIC, "rcl_interfaces/msg/Log")
        logging.getLogger(OUR_LOGGER).addHandler(self)

    def close(self) -> None:
        """Publish no more records."""
        logging.getLogger(OUR_LOGGER).removeHandler(self)
        super().close()

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a record soon; never at once, as it may be about the very message that is being published."""
        if self._waiting >= MAX_WAITING or self._loop.is_closed():
            return
        self._waiting += 1
        self._loop.call_soon_threadsafe(self._publish, log_message(record))

    def _publish(self, message: dict[str, Any]) -> None:
        self._waiting -= 1
        self._graph.publish(self._node, ROSOUT_TOPIC, message)


def log_message(record: logging.LogRecord) -> dict[str, Any]:
    """Return the rcl_interfaces/Log of a record; Python and ROS count levels alike, 10 to 50."""
    return {
        "stamp": Stamp.from_seconds(record.created).as_message(),
        "level": max(10, min(50, record.levelno // 10 * 10)),
        "name": record.name,
        "msg": message_of(record),
        "file": record.filename,
        "function": record.funcName or "",
        "line": record.lineno,
    }


def offer_level_services(graph: Graph) -> None:
    """Offer the services that get and set the levels of loggers."""
    node = Node(OUR_LOGGER)
    graph.services.offer(node, GET_LEVELS, "rcl_interfaces/srv/GetLoggerLevels", _get_levels)
    graph.services.offer(node, SET_LEVELS, "rcl_interfaces/srv/SetLoggerLevels", _set_levels)


def _get_levels(request: dict[str, Any]) -> dict[str, Any]:
    names = _limited(request["names"], "names")
    return {"levels": [{"name": name, "level": _level(name)} for name in names]}


def _set_levels(request: dict[str, Any]) -> dict[str, Any]:
    reasons = [_change(each["name"], each["level"]) for each in _limited(request["levels"], "levels")]
    return {"results": [{"successful": not reason, "reason": reason} for reason in reasons]}


def _limited(requested: list[Any], field: str) -> list[Any]:
    if len(requested) > MAX_REQUESTED:
        raise ServiceError(f"{field}: {len(requested)} loggers, the limit is {MAX_REQUESTED}")
    return requested


def _level(name: str) -> int:
    """Return the level that holds for a logger; 0 for one that is not the server's."""
    return logging.getLogger(name).getEffectiveLevel() if _exists(name) else 0


def _change(name: str, level: int) -> str:
    """Change a level; return the reason for a refusal, or an empty text."""
    if not _OURS.fullmatch(name):
        return f"name: must be {OUR_LOGGER} or a logger below it, as {OUR_LOGGER}.gateway, not {name[:80]!r}"
    if level not in LEVELS:
        return f"level: must be one of {', '.join(map(str, LEVELS))}, not {level}"
    if not logs.change(LoggerLevel(name, level)):
        return f"name: the levels of {MAX_CHANGED_LOGGERS} loggers have been changed already, the limit"
    log.warning("the level of %s is %s now", name, LEVELS[level])
    return ""


def _exists(name: str) -> bool:
    """Return True for an existing logger of the server; a request for its level must not create it."""
    return bool(_OURS.fullmatch(name)) and name in logging.root.manager.loggerDict
