"""``/rosout``: the server's log as rcl_interfaces/Log messages."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from protocol.messages import Stamp
from robot.logs import message_of
from server.graph.node import Node
from server.graph.topics import Graph

TOPIC = "/rosout"
TYPE = "rcl_interfaces/msg/Log"

# A burst longer than this says the same again and again; what is lost is still in the log itself.
MAX_WAITING = 1000


class Rosout(logging.Handler):
    """Publishes every record of the log.

    Args:
        graph: where the topic is.
        loop: the event loop of the graph; records come from other threads as well.
    """

    def __init__(self, graph: Graph, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._graph = graph
        self._loop = loop
        self._node = Node("rosout")
        self._waiting = 0

    def open(self) -> None:
        """Advertise the topic and listen to the log."""
        self._graph.advertise(self._node, TOPIC, TYPE)
        logging.getLogger("armbridge").addHandler(self)

    def close(self) -> None:
        """Listen no more."""
        logging.getLogger("armbridge").removeHandler(self)
        super().close()

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a record soon; never at once, for it may be about the very message that is being published."""
        if self._waiting >= MAX_WAITING or self._loop.is_closed():
            return
        self._waiting += 1
        self._loop.call_soon_threadsafe(self._publish, as_message(record))

    def _publish(self, message: dict[str, Any]) -> None:
        self._waiting -= 1
        self._graph.publish(self._node, TOPIC, message)


def as_message(record: logging.LogRecord) -> dict[str, Any]:
    """The rcl_interfaces/Log of a record; Python and ROS count levels alike, 10 to 50."""
    return {
        "stamp": Stamp.from_seconds(record.created).as_message(),
        "level": max(10, min(50, record.levelno // 10 * 10)),
        "name": record.name,
        "msg": message_of(record),
        "file": record.filename,
        "function": record.funcName or "",
        "line": record.lineno,
    }
