"""Replay of a recording: a player, and a server without an arm around it."""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import Iterator
from pathlib import Path

import uvloop

from protocol.codecs import cdr
from protocol.errors import ProtocolError
from robot.logs import LogLimiter
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.errors import GraphError, RecordingError
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.graph.topics import Graph
from server.interfaces import load_registry
from server.lifecycle import on_hangup, stop_signals, unless_ended
from server.recording.files import RecordedMessage
from server.recording.reading import messages
from server.rosapi import RosApi

log = logging.getLogger("armbridge.recording")

# Messages that a thread reads for the event loop at once, fewer of raw images.
MESSAGES_AT_A_TIME = 500
BYTES_AT_A_TIME = 16_777_216


def replay(recording: Path, server: ServerSettings, access: AccessSettings) -> None:
    """Serve a recording to clients until its end, SIGINT or SIGTERM.

    Raises RecordingError for the file, ConfigurationError for certificate and tokens, or none where others could
    connect, and StartError for the port.
    """
    # Ahead of the event loop: a signal ends a read that waits at once here.
    if next(messages(recording), None) is None:
        raise RecordingError(recording, "has no messages of ROS 2")
    uvloop.run(serve(recording, server, access))


async def serve(recording: Path, server: ServerSettings, access: AccessSettings) -> None:
    """Start a server, play until the end or a signal, stop."""
    graph = Graph(load_registry(server.interfaces))
    RosApi(graph)
    # There is no arm to control, so no client needs the lease.
    listener = Listener(graph, server, access=Access(access.model_copy(update={"control": "shared"})))
    player = RecordingPlayer(graph, recording)
    ending, _hurry = stop_signals()
    on_hangup(listener.reload_certificate, ending.set)
    try:
        await listener.bind()
        await listener.open()
        log.info("%s", f"replaying {recording} on {listener.url} (rosbridge)")
        await unless_ended(ending, player.play(), cancel_timeout_s=None)
    finally:
        await listener.close()
    log.info("replay ended: %d messages published, %d could not be read", player.published, player.unreadable)


def _next_messages(recorded: Iterator[RecordedMessage]) -> list[RecordedMessage]:
    read, size_bytes = [], 0
    for message in itertools.islice(recorded, MESSAGES_AT_A_TIME):
        read.append(message)
        size_bytes += len(message.octets)
        if size_bytes >= BYTES_AT_A_TIME:
            break
    return read


class RecordingPlayer:
    """Publishes a recording on a graph, with the recorded timing; a topic begins with its first message."""

    def __init__(self, graph: Graph, recording: Path) -> None:
        self._recording = recording
        self._node = graph.node("replay")
        # False for a topic that is left out, by topic and type.
        self._offered: dict[tuple[str, str], bool] = {}
        self._unreadable_topics = LogLimiter()
        self.published = 0
        self.unreadable = 0

    async def play(self) -> None:
        """Publish every message at its time."""
        loop = asyncio.get_running_loop()
        started_s, first_ns = loop.time(), None
        recorded = messages(self._recording)
        while read := await asyncio.to_thread(_next_messages, recorded):
            for message in read:
                first_ns = message.log_time_ns if first_ns is None else first_ns
                due_s = started_s + (message.log_time_ns - first_ns) / 1e9
                # Also when it is late already: clients are served between two messages.
                await asyncio.sleep(max(0.0, due_s - loop.time()))
                self._publish(message)

    def _offer(self, message: RecordedMessage) -> bool:
        """Advertise the topic of a message; a topic that cannot be advertised is logged."""
        others = self._node.publishers(message.topic)
        if any(not other.remote for other in others if other is not self._node):
            log.info("%s is left out: the replaying server has its own", message.topic)
            return False
        try:
            self._node.advertise(message.topic, message.type_name, latch=message.latched)
        except GraphError as error:
            log.warning("%s is left out: it cannot be offered: %s", message.topic, error)
            return False
        return True

    def _publish(self, message: RecordedMessage) -> None:
        topic = message.topic, message.type_name
        if topic not in self._offered:
            self._offered[topic] = self._offer(message)
        if not self._offered[topic]:
            return
        try:
            values = cdr.deserialize(self._node.message_types.registry, message.type_name, message.octets)
            self._node.publish(message.topic, values)
        except (ProtocolError, GraphError) as error:
            self.unreadable += 1
            line = f"{message.topic}: a message of {message.type_name} cannot be read: {error}"
            self._unreadable_topics.write(log, logging.WARNING, line, message.topic)
        else:
            self.published += 1
