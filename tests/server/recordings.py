"""Recordings made for tests."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from protocol.codecs import cdr
from protocol.messages import Stamp, complete
from protocol.registry import Registry
from server.recording.files import RecordedMessage, RecordingFile
from server.recording.reading import messages

REGISTRY = Registry.load()
START_NS = 1_700_000_000_000_000_000


def entry(
    topic: str,
    type_name: str,
    msg: dict[str, Any],
    at_s: float = 0.0,
    *,
    latched: bool = False,
    registry: Registry = REGISTRY,
) -> RecordedMessage:
    """A message as a recording has it, published and recorded ``at_s`` after `START_NS`."""
    canonical = registry.canonical(type_name)
    completed = complete(registry, canonical, msg, Stamp(0, 0))
    at_ns = START_NS + round(at_s * 1e9)
    return RecordedMessage(topic, canonical, latched, at_ns, at_ns, cdr.serialize(registry, canonical, completed))


def text(number: int, topic: str = "/t") -> RecordedMessage:
    """One message a second: its number."""
    return entry(topic, "std_msgs/String", {"data": str(number)}, number)


def record(path: Path, entries: Iterable[RecordedMessage], registry: Registry = REGISTRY) -> Path:
    """Write a whole recording in place of what is there."""
    path.unlink(missing_ok=True)
    file = RecordingFile(path, registry)
    for each in entries:
        file.add(each)
    file.end()
    return path


def recorded_messages(path: Path) -> list[RecordedMessage]:
    """Return all messages of a recording, as they are in the file."""
    return list(messages(path))


def record_killed(path: Path, chunks: Iterable[Iterable[RecordedMessage]]) -> Path:
    """Write a recording, in these chunks, of a process that ends without ending it."""
    path.unlink(missing_ok=True)
    file = RecordingFile(path, REGISTRY)
    for chunk in chunks:
        for each in chunk:
            file.add(each)
        file.flush()
    file.abandon()
    return path
