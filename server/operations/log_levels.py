"""The log's levels while the server runs: by services, as ROS 2 nodes have them, and by SIGUSR1."""

from __future__ import annotations

import asyncio
import logging
import re
import signal
from typing import Any

from robot import logs
from robot.logs import MAX_CHANGED_LOGGERS, OUR_LOGGER, LoggerLevel
from server.errors import ServiceError
from server.graph.node import Node
from server.graph.topics import Graph

log = logging.getLogger("armbridge.operations")

GET = "/armbridge/get_logger_levels"
SET = "/armbridge/set_logger_levels"

# rcl_interfaces/LoggerLevel counts as Python does; 0 leaves the level to the logger above.
LEVELS = {
    0: "unset",
    logging.DEBUG: "debug",
    logging.INFO: "info",
    logging.WARNING: "warn",
    logging.ERROR: "error",
    logging.CRITICAL: "fatal",
}

# Loggers in one call; there are a few dozen.
MAX_ASKED = 1000

_OURS = re.compile(rf"{OUR_LOGGER}(\.[a-z0-9_]{{1,40}}){{0,4}}")


class LogLevels:
    """Offers the services and listens to the signal.

    Args:
        graph: where the services are.
    """

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self._node = Node(OUR_LOGGER)

    def open(self) -> None:
        """Begin."""
        self._graph.services.offer(self._node, GET, "rcl_interfaces/srv/GetLoggerLevels", _get)
        self._graph.services.offer(self._node, SET, "rcl_interfaces/srv/SetLoggerLevels", _set)
        asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, toggle_debug)


def toggle_debug() -> None:
    """Log everything, or no longer."""
    debug = logging.getLogger(OUR_LOGGER).level != logging.DEBUG
    logs.change(LoggerLevel(OUR_LOGGER, logging.DEBUG if debug else logging.NOTSET))
    log.warning("SIGUSR1: the log's level is %s", "debug now" if debug else "again what the settings say")


def _get(request: dict[str, Any]) -> dict[str, Any]:
    names = _few(request["names"], "names")
    return {"levels": [{"name": name, "level": _level(name)} for name in names]}


def _few(asked: list[Any], field: str) -> list[Any]:
    if len(asked) > MAX_ASKED:
        raise ServiceError(f"{field}: {len(asked)} loggers, the limit is {MAX_ASKED}")
    return asked


def _level(name: str) -> int:
    """The level that holds for a logger; 0 for one that is not ours."""
    return logging.getLogger(name).getEffectiveLevel() if _is_ours(name) else 0


def _set(request: dict[str, Any]) -> dict[str, Any]:
    refusals = [_change(each["name"], each["level"]) for each in _few(request["levels"], "levels")]
    return {"results": [{"successful": not reason, "reason": reason} for reason in refusals]}


def _change(name: str, level: int) -> str:
    """Change a level; returns why not, or nothing."""
    if not _OURS.fullmatch(name):
        return f"name: must be {OUR_LOGGER} or a logger below it, as {OUR_LOGGER}.gateway, not {name[:80]!r}"
    if level not in LEVELS:
        return f"level: must be one of {', '.join(map(str, LEVELS))}, not {level}"
    if not logs.change(LoggerLevel(name, level)):
        return f"name: the levels of {MAX_CHANGED_LOGGERS} loggers have been changed already, the limit"
    log.warning("the level of %s is %s now", name, LEVELS[level])
    return ""


def _is_ours(name: str) -> bool:
    """Whether this is one of our loggers, that there is: asking must not make any."""
    return bool(_OURS.fullmatch(name)) and name in logging.root.manager.loggerDict
