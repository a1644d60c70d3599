"""The log of the server and of its children, who share one terminal: plain lines or JSON, and nothing secret in it."""

from __future__ import annotations

import json
import logging
import re
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from types import TracebackType
from typing import Literal, TypeAlias

from robot.log_flood import FloodFilter, left_out_note

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
