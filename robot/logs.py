"""Logging of the server and its children in plain text or JSON, with tokens blotted out and floods limited."""

from __future__ import annotations

import functools
import json
import logging
import os
import re
import socket
import stat
import sys
import time
import weakref
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from types import TracebackType
from typing import TYPE_CHECKING, Literal, TypeAlias

if TYPE_CHECKING:
    from robot.processes import Child

LogFormat: TypeAlias = Literal["plain", "json"]

PLAIN = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"

# Subjects of a line that are fields of their own in JSON, where the line names them (``extra`` of the logging module).
SUBJECTS = ("client", "goal", "code")

OUR_LOGGER = "armbridge"  # parent of all loggers of this program; libraries have theirs beside it
MAX_MESSAGE_CHARACTERS = 4000  # messages quote clients, whose text may be as long as a WebSocket message

# Tokens stand in URLs and headers, which libraries quote in their own messages.
_SECRET = re.compile(r"((?:[?&]|\b)(?:access_)?token=|\bBearer\s+)[^\s&\"'<>]+", re.IGNORECASE)

MAX_KEYS = 100  # subjects that a limiter remembers: clients choose what their refusals are about

# Lines of one place in the program: at once, and in the long run [1/s]. A day of that is 200 MB.
BURST = 500
LINES_PER_S = 10.0

MAX_CHANGED_LOGGERS = 100  # made-up names included; the levels of the program's own thirty can always be changed


def configure(level: int | str, log_format: LogFormat, process: str = "server", arm: str = "") -> None:
    """Log to standard error; to be called once in each process. The arm's name begins the message of plain lines."""
    try:
        handler: logging.Handler = StderrHandler()
    except (OSError, AttributeError):
        # The terminal of another user, or no file, as in tests and where it is closed.
        handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter(process) if log_format == "json" else PlainFormatter(arm))
    handler.addFilter(FloodFilter())
    logging.basicConfig(level=level, handlers=[handler])
    if log_format == "json":
        sys.excepthook = _log_exception


class StderrHandler(logging.Handler):
    """Handler of standard error that leaves lines out rather than wait; raises OSError where that is impossible.

    A terminal that Ctrl-S holds, or a pipe that nobody reads, would keep the server from a stop, and the arm from its
    ticks.
    """

    def __init__(self) -> None:
        super().__init__()
        descriptor = sys.stderr.fileno()
        mode = os.fstat(descriptor).st_mode
        self._left_out = 0
        if stat.S_ISSOCK(mode):
            # The journal's.
            journal = socket.socket(fileno=os.dup(descriptor))
            self._write: Callable[[bytes], int] = lambda line: journal.send(line, socket.MSG_DONTWAIT)
            return
        if not stat.S_ISREG(mode):
            # Opened again, since the shell shares the flags of what it has opened; a file has room.
            path = f"/proc/self/fd/{descriptor}"
            descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
        self._write = functools.partial(os.write, descriptor)

    def emit(self, record: logging.LogRecord) -> None:
        record.suppressed = getattr(record, "suppressed", 0) + self._left_out
        try:
            self._write(f"{self.format(record)}\n".encode(errors="backslashreplace"))
            self._left_out = 0
        except OSError:
            self._left_out += 1
        except Exception:  # noqa: BLE001 - as every handler: a wrong line must not end what logs it
            self.handleError(record)


def format_in_use() -> LogFormat:
    found = any(isinstance(handler.formatter, JsonFormatter) for handler in logging.getLogger().handlers)
    return "json" if found else "plain"


def _log_exception(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    logging.getLogger(OUR_LOGGER).critical("ended by an exception", exc_info=(kind, error, traceback))


class PlainFormatter(logging.Formatter):
    """Formatter of lines for people."""

    def __init__(self, arm: str = "") -> None:
        super().__init__(PLAIN)
        self._arm = f"{arm}: " if arm else ""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - as logging calls it
        """Format the line without its traceback; line breaks and terminal control characters are escaped."""
        message = f"{self._arm}{message_of(record)}"
        record.message = message if message.isprintable() else repr(message)[1:-1]
        return super().formatMessage(record)

    def format(self, record: logging.LogRecord) -> str:
        return without_secrets(super().format(record))


class JsonFormatter(logging.Formatter):
    """Formatter of one JSON object a line, for programs that collect logs."""

    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        """Format the line; a traceback is the field ``exception``."""
        fields = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": message_of(record),
            "process": self._process,
            "pid": record.process,
        }
        fields |= {name: value for name in SUBJECTS if (value := getattr(record, name, ""))}
        if record.exc_info:
            fields["exception"] = without_secrets(self.formatException(record.exc_info))
        return json.dumps(fields, default=str)


def message_of(record: logging.LogRecord) -> str:
    """Return the message of a record, cut to :data:`MAX_MESSAGE_CHARACTERS` and with tokens blotted out."""
    text = record.getMessage()
    if len(text) > MAX_MESSAGE_CHARACTERS:
        text = f"{text[:MAX_MESSAGE_CHARACTERS]}... ({len(text)} characters)"
    return without_secrets(text) + suppressed_note(getattr(record, "suppressed", 0))


def without_secrets(text: str) -> str:
    return _SECRET.sub(r"\1***", text)


class LogLimiter:
    """Limiter of repeated lines: a token bucket for each of the first keys; by default each key has one line, ever."""

    __slots__ = ("_buckets", "_burst", "_end_is_written", "_lines_per_s", "_max_keys")

    def __init__(self, burst: int = 1, lines_per_s: float = 0.0, max_keys: int | None = MAX_KEYS) -> None:
        self._burst = float(burst)
        self._lines_per_s = lines_per_s
        self._max_keys = max_keys
        self._end_is_written = False
        # By the hash of the key, which may be as long as a message of a client.
        self._buckets: dict[int, _Bucket] = {}

    def write(
        self,
        logger: logging.Logger,
        level: int,
        line: str,
        key: Hashable,
        now_s: float = 0.0,
        extra: Mapping[str, str] | None = None,
    ) -> None:
        """Write a line if it is due, and how many like it were not; write once that there are too many keys."""
        if self.due(key, now_s):
            logger.log(level, "%s%s", line, suppressed_note(self.suppressed(key)), stacklevel=2, extra=extra)
        elif hash(key) not in self._buckets and not self._end_is_written:
            self._end_is_written = True
            logger.log(level, "%d lines of this kind were written; further ones are not", len(self._buckets))

    def due(self, key: Hashable, now_s: float) -> bool:
        """Count a line, and return True when it is due."""
        bucket = self._buckets.get(hash(key))
        if bucket is None:
            if self._max_keys is not None and len(self._buckets) >= self._max_keys:
                return False
            bucket = self._buckets[hash(key)] = _Bucket(self._burst, now_s)
        bucket.left = min(self._burst, bucket.left + (now_s - bucket.counted_s) * self._lines_per_s)
        bucket.counted_s = now_s
        if bucket.left < 1.0:
            bucket.suppressed += 1
            return False
        bucket.left -= 1.0
        bucket.reported, bucket.suppressed = bucket.suppressed, 0
        return True

    def suppressed(self, key: Hashable) -> int:
        """Return the number of lines of a key that were suppressed before its latest due one."""
        bucket = self._buckets.get(hash(key))
        return 0 if bucket is None else bucket.reported


@dataclass(slots=True)
class _Bucket:
    left: float
    counted_s: float
    suppressed: int = 0
    reported: int = 0


def suppressed_note(count: int) -> str:
    """Return the note on lines that were suppressed before a line; empty without any."""
    return f" ({count} more lines like this were left out before)" if count else ""


class FloodFilter(logging.Filter):
    """Filter that limits the lines of each place in the program."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        # As many keys as the program has calls of the log.
        self._limiter = LogLimiter(BURST, LINES_PER_S, max_keys=None)

    def filter(self, record: logging.LogRecord) -> bool:
        """Return True for a record to write; it carries the number of records suppressed before it."""
        place = record.pathname, record.lineno
        if not self._limiter.due(place, self._clock()):
            return False
        record.suppressed = self._limiter.suppressed(place)
        return True


@dataclass(frozen=True)
class LoggerLevel:
    """Least level of a logger, numbered as Python does; 0 leaves the level to the parent logger."""

    name: str
    level: int


_followers: weakref.WeakSet[Child] = weakref.WeakSet()
_changed: dict[str, LoggerLevel] = {}


def change(level: LoggerLevel) -> bool:
    """Change a logger's level in this process and in all children; return False for too many names of no logger."""
    # A name with dots makes places for loggers above it, which are none.
    known = level.name in _changed or isinstance(logging.root.manager.loggerDict.get(level.name), logging.Logger)
    if not known and len(_changed) >= MAX_CHANGED_LOGGERS:
        return False
    _changed[level.name] = level
    apply(level)
    for follower in list(_followers):
        follower.send(level)
    return True


def follow(child: Child) -> None:
    """Send a child all changes of levels, from before and from now on, until it is no longer referenced."""
    _followers.add(child)
    for level in _changed.values():
        child.send(level)


def apply(change: LoggerLevel) -> None:
    """Change a logger's level in this process alone."""
    logging.getLogger(change.name).setLevel(change.level)


MAX_LINE_CHARACTERS = 3000  # text of a line that is passed on; a traceback has thirty lines


@dataclass(frozen=True)
class LogLine:
    """Line of a process's log, on its way to the place that keeps the last lines."""

    at_s: float  # wall-clock time [s since the epoch]
    level: int  # level, numbered as Python does
    logger: str
    process: str
    text: str  # message without tokens, and the traceback below it; at most MAX_LINE_CHARACTERS
    monotonic_s: float  # monotonic time of the machine, which all of its processes share [s]


class LineHandler(logging.Handler):
    """Handler that passes on each record of our loggers as a line, in the thread that has logged it, until closed."""

    def __init__(self, process: str, take: Callable[[LogLine], None]) -> None:
        super().__init__()
        self._process = process
        self.take = take
        self.addFilter(FloodFilter())
        logging.getLogger(OUR_LOGGER).addHandler(self)

    def close(self) -> None:
        logging.getLogger(OUR_LOGGER).removeHandler(self)
        super().close()

    def emit(self, record: logging.LogRecord) -> None:
        text = message_of(record)
        if record.exc_info:
            text = f"{text}\n{without_secrets(logging.Formatter().formatException(record.exc_info))}"
        text = text[:MAX_LINE_CHARACTERS]
        self.take(LogLine(record.created, record.levelno, record.name, self._process, text, time.monotonic()))


def pass_on(line: LogLine) -> None:
    """Pass a line that a child process has sent to the handlers of this process."""
    for handler in logging.getLogger(OUR_LOGGER).handlers:
        if isinstance(handler, LineHandler):
            handler.take(line)
