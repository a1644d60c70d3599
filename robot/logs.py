"""The log of the server and of its children, who share one terminal: plain lines or JSON, and nothing secret in it.

A bound on the log: what one place in the program says again and again is left out beyond a rate.

Clients and machines decide how often something goes wrong, and a log must not fill the disk with it.

Levels of loggers that are changed while the server runs: in the server and in every child, now or later.

A bound on lines of the log that say the same again and again: the first, second, fourth, eighth, … are written.
"""

from __future__ import annotations

import json
import logging
import re
import sys
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from types import TracebackType
from typing import Literal, Protocol, TypeAlias

LogFormat: TypeAlias = Literal["plain", "json"]

PLAIN = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"

# All of ours are below it; libraries have theirs beside it.
OUR_LOGGER = "armbridge"

# What clients send is quoted in messages, and may be as long as a message of theirs.
MAX_MESSAGE_CHARACTERS = 4000

# Tokens stand in URLs and headers, which libraries quote in their own messages.
_SECRET = re.compile(r"((?:[?&]|\b)(?:access_)?token=|\bBearer\s+)[^\s&\"'<>]+", re.IGNORECASE)


@dataclass(frozen=True)
class LoggerLevel:
    """A logger's least level, numbered as Python does; 0 leaves the level to the logger above it."""

    name: str
    level: int


def without_secrets(text: str) -> str:
    """A text in which tokens are blotted out."""
    return _SECRET.sub(r"\1***", text)


def message_of(record: logging.LogRecord) -> str:
    """What a record says: no longer than anybody reads, and with tokens blotted out."""
    text = record.getMessage()
    if len(text) > MAX_MESSAGE_CHARACTERS:
        text = f"{text[:MAX_MESSAGE_CHARACTERS]}... ({len(text)} characters)"
    return without_secrets(text) + left_out_note(record)


class PlainFormatter(logging.Formatter):
    """A line for people."""

    def __init__(self) -> None:
        super().__init__(PLAIN)

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - as logging calls it
        """The line alone, without a line break or anything else that a terminal obeys."""
        message = message_of(record)
        record.message = message if message.isprintable() else repr(message)[1:-1]
        return super().formatMessage(record)

    def format(self, record: logging.LogRecord) -> str:
        """The line, and the traceback below it."""
        return without_secrets(super().format(record))


class JsonFormatter(logging.Formatter):
    """One JSON object a line, for programs that gather logs.

    Args:
        process: what the process is, as ``server``.
    """

    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        """The line."""
        fields = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": message_of(record),
            "process": self._process,
            "pid": record.process,
        }
        if record.exc_info:
            fields["exception"] = without_secrets(self.formatException(record.exc_info))
        return json.dumps(fields, default=str)


def configure(level: int | str, log_format: LogFormat, process: str = "server") -> None:
    """Log to standard error; to be called once in each process.

    Args:
        level: the least level, by number or name.
        log_format: how a line looks.
        process: what the process is.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter(process) if log_format == "json" else PlainFormatter())
    handler.addFilter(FloodFilter())
    logging.basicConfig(level=level, handlers=[handler])
    if log_format == "json":
        sys.excepthook = _log_exception


def format_in_use() -> LogFormat:
    """How this process logs."""
    found = any(isinstance(handler.formatter, JsonFormatter) for handler in logging.getLogger().handlers)
    return "json" if found else "plain"


def apply(change: LoggerLevel) -> None:
    """Change a logger's level in this process."""
    logging.getLogger(change.name).setLevel(change.level)


def _log_exception(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    """Have the end of a process by an exception told as all else is."""
    logging.getLogger(OUR_LOGGER).critical("ended by an exception", exc_info=(kind, error, traceback))


# Of one place: lines at once, and in the long run [1/s]. A day of that is 200 MB.
BURST = 500
LINES_PER_S = 10.0

Place: TypeAlias = tuple[str, int]


class FloodFilter(logging.Filter):
    """Lets records through that are not too many; how many were left out is told with the next that is not.

    Args:
        clock: monotonic time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        # Lines that are left and when they were counted, and how many were left out; no more of them than the program
        # has calls of the log.
        self._shares: dict[Place, tuple[float, float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is told."""
        place, now_s = (record.pathname, record.lineno), self._clock()
        left, counted_s, left_out = self._shares.get(place, (float(BURST), now_s, 0))
        left = min(float(BURST), left + (now_s - counted_s) * LINES_PER_S)
        if left < 1.0:
            self._shares[place] = left, now_s, left_out + 1
            return False
        self._shares[place] = left - 1.0, now_s, 0
        record.left_out = left_out
        return True


def left_out_note(record: logging.LogRecord) -> str:
    """How many records like this one were left out before it; empty for none."""
    count = getattr(record, "left_out", 0)
    return f" ({count} more lines like this were left out before)" if count else ""


# Loggers whose levels can be changed; there are some thirty.
MAX_CHANGED_LOGGERS = 100


class Follower(Protocol):
    """A child, which applies what it is sent."""

    def send(self, message: object) -> None:
        """Send it a message."""


_followers: weakref.WeakSet[Follower] = weakref.WeakSet()
_changed: dict[str, LoggerLevel] = {}


def change(level: LoggerLevel) -> bool:
    """Change a logger's level.

    Returns:
        False when so many other loggers have been changed that no further one is.
    """
    if level.name not in _changed and len(_changed) >= MAX_CHANGED_LOGGERS:
        return False
    _changed[level.name] = level
    apply(level)
    for follower in list(_followers):
        follower.send(level)
    return True


def follow(child: Follower) -> None:
    """Have a child follow, as long as somebody keeps it; it is told what has been changed already."""
    _followers.add(child)
    for level in _changed.values():
        child.send(level)


# What has not happened for so long is told as the first time.
CALM_S = 600.0


class Repeats:
    """Count of one event.

    Attributes:
        count: how often it has happened since it was calm.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last_s = float("-inf")

    def due(self, now_s: float) -> bool:
        """Count the event once more; returns whether it is to be told.

        Args:
            now_s: monotonic time [s].
        """
        if now_s - self._last_s > CALM_S:
            self.count = 0
        self._last_s = now_s
        self.count += 1
        return self.count & (self.count - 1) == 0

    @property
    def note(self) -> str:
        """Text to append to the line; empty the first time."""
        return f" ({self.count} times so far)" if self.count > 1 else ""
