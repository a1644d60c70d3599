"""Publishes what was recorded, as it was timed."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncIterator, Iterable, Iterator
from dataclasses import dataclass

from protocol.codecs import cdr
from protocol.errors import ProtocolError
from server.errors import GraphError
from server.graph.node import Node
from server.graph.topics import Graph
from server.recording.mcap_file import Entry
from server.recording.reader import Recording, Track

log = logging.getLogger("armbridge.replay")


@dataclass
class Tally:
    """How many messages were published, and how many could not be read."""

    published: int = 0
    unreadable: int = 0


class Player:
    """Publishes the topics of a recording on a graph.

    Args:
        graph: where.
        recording: what.
        rate: how many seconds of the recording pass in a second.

    Attributes:
        tally: what has become of the messages so far.
    """

    def __init__(self, graph: Graph, recording: Recording, rate: float = 1.0) -> None:
        self._graph = graph
        self._recording = recording
        self._rate = rate
        self._node = Node("replay")
        self._topics: dict[str, Track] = {}
        self._told: set[str] = set()
        self.tally = Tally()

    def advertise(self, tracks: Iterable[Track]) -> None:
        """Offer the recorded topics; one that cannot be offered is told to the log and left out."""
        for track in tracks:
            if self._is_taken(track.topic):
                log.info("%s is left out: the replaying server has its own", track.topic)
            elif problem := track.problem or self._advertise(track):
                log.warning("%s is left out: it %s", track.topic, problem)
            else:
                self._topics.setdefault(track.topic, track)

    async def play(self) -> None:
        """Publish every message at its time, once through the file.

        Raises:
            RecordingError: the file can no longer be read.
        """
        loop = asyncio.get_running_loop()
        started_s, first_ns = loop.time(), None
        async for entry in self._entries():
            first_ns = entry.log_time_ns if first_ns is None else first_ns
            due_s = started_s + (entry.log_time_ns - first_ns) / 1e9 / self._rate
            # Also when it is late already: a client wants its turn between two messages.
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            self._publish(entry)

    def _is_taken(self, topic: str) -> bool:
        others = (publisher for publisher in self._graph.publishers(topic) if publisher is not self._node)
        return any(not publisher.remote for publisher in others)

    def _advertise(self, track: Track) -> str:
        """Offer a topic; returns what stands against it."""
        try:
            self._graph.advertise(self._node, track.topic, track.type_name, latch=track.latched)
        except GraphError as error:
            return f"cannot be offered: {error}"
        return ""

    def _publish(self, entry: Entry) -> None:
        track = self._topics.get(entry.topic)
        if track is None or track.type_name != entry.type_name:
            return
        try:
            message = cdr.deserialize(self._graph.interfaces.registry, entry.type_name, entry.octets)
            self._graph.publish(self._node, entry.topic, message)
        except (ProtocolError, GraphError) as error:
            self.tally.unreadable += 1
            if entry.topic not in self._told:
                self._told.add(entry.topic)
                log.warning("%s: a message of %s cannot be read: %s", entry.topic, entry.type_name, error)
        else:
            self.tally.published += 1

    async def _entries(self) -> AsyncIterator[Entry]:
        """The messages of the file; the next chunk is unpacked in a thread while one is played."""
        chunks = self._recording.entries()
        coming = asyncio.create_task(asyncio.to_thread(_next, chunks))
        try:
            while (entries := await coming) is not None:
                coming = asyncio.create_task(asyncio.to_thread(_next, chunks))
                for entry in entries:
                    yield entry
        finally:
            # A thread cannot be cancelled, and the file is not to be closed while it reads.
            await asyncio.wait([coming])


def _next(chunks: Iterator[list[Entry]]) -> list[Entry] | None:
    return next(chunks, None)
