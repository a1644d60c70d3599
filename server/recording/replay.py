"""Replay of a recording: a player, and a server without an arm around it."""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import uvloop

from protocol.codecs import cdr
from protocol.errors import ProtocolError
from robot.logs import LogLimiter
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.errors import GraphError
from server.gateway.listener import Listener
from server.gateway.settings import ServerSettings
from server.graph.topics import Graph
from server.interfaces import load_registry
from server.lifecycle import on_hangup, stop_signals, unless_ended
from server.recording.files import RecordedMessage
from server.recording.reading import RecordedTopic, RecordingFile, Summary
from server.rosapi import RosApi

log = logging.getLogger("armbridge.recording")

# Messages that a thread reads for the event loop at once, fewer of raw images.
MESSAGES_AT_A_TIME = 500
BYTES_AT_A_TIME = 16_777_216

# Pause between end and beginning; without it a recording of one message would be a flood.
LOOP_PAUSE_S = 0.1


@dataclass(frozen=True)
class ReplayOptions:
    """Options of a replay: seconds of the recording per second, and time for clients to connect before [s]."""

    path: Path
    server: ServerSettings
    access: AccessSettings
    rate: float
    delay_s: float
    loop: bool


def replay(options: ReplayOptions) -> None:
    """Serve a recording to clients until its end, SIGINT or SIGTERM.

    Raises RecordingError for the file, ConfigurationError for certificate and tokens, or none where others could
    connect, and StartError for the port.
    """
    # Ahead of the event loop: a file without an index is read whole, which a signal ends at once here.
    uvloop.run(serve(options, RecordingFile(options.path).summary()))


async def serve(options: ReplayOptions, summary: Summary) -> None:
    """Start a server, play until the end or a signal, stop."""
    graph = Graph(load_registry(options.server.interfaces))
    RosApi(graph)
    # There is no arm to control, so no client needs the lease.
    access = Access(options.access.model_copy(update={"control": "shared"}))
    listener = Listener(graph, options.server, access=access)
    player = RecordingPlayer(graph, RecordingFile(options.path), options.rate)
    ending, _hurry = stop_signals()
    on_hangup(listener.reload_certificate, ending.set)
    try:
        await listener.bind()
        await listener.open()
        # After the listener: recorded topics are not mixed with its own.
        player.advertise(summary.topics)
        incomplete = (
            "" if summary.complete else "; the file was not ended in good order, what can be read of it is played"
        )
        log.info(
            "%s",
            f"replaying {options.path} on {listener.url} (rosbridge): "
            f"{len(summary.topics)} topics, {summary.messages} messages, {summary.duration_s:.1f} s{incomplete}",
        )
        await unless_ended(ending, _play(player, options), cancel_timeout_s=None)
    finally:
        await listener.close()
    log.info("replay ended: %d messages published, %d could not be read", player.published, player.unreadable)


async def _play(player: RecordingPlayer, options: ReplayOptions) -> None:
    await asyncio.sleep(options.delay_s)
    await player.play()
    while options.loop:
        await asyncio.sleep(LOOP_PAUSE_S)
        await player.play()


def _next_messages(recorded: Iterator[RecordedMessage]) -> list[RecordedMessage]:
    messages, size_bytes = [], 0
    for message in itertools.islice(recorded, MESSAGES_AT_A_TIME):
        messages.append(message)
        size_bytes += len(message.octets)
        if size_bytes >= BYTES_AT_A_TIME:
            break
    return messages


class RecordingPlayer:
    """Publishes a recording on a graph, with the recorded timing."""

    def __init__(self, graph: Graph, recording: RecordingFile, rate: float) -> None:
        self._recording = recording
        self._rate = rate
        self._node = graph.node("replay")
        self._topics: dict[str, RecordedTopic] = {}
        self._unreadable_topics = LogLimiter()
        self.published = 0
        self.unreadable = 0

    def advertise(self, topics: Iterable[RecordedTopic]) -> None:
        """Advertise the recorded topics; a topic that cannot be advertised is logged and left out."""
        for recorded in topics:
            others = self._node.publishers(recorded.topic)
            if any(not other.remote for other in others if other is not self._node):
                log.info("%s is left out: the replaying server has its own", recorded.topic)
            elif problem := recorded.problem or self._advertise(recorded):
                log.warning("%s is left out: it %s", recorded.topic, problem)
            else:
                self._topics.setdefault(recorded.topic, recorded)

    async def play(self) -> None:
        """Publish every message at its time, once through the file."""
        loop = asyncio.get_running_loop()
        started_s, first_ns = loop.time(), None
        recorded = self._recording.messages()
        while messages := await asyncio.to_thread(_next_messages, recorded):
            for message in messages:
                first_ns = message.log_time_ns if first_ns is None else first_ns
                due_s = started_s + (message.log_time_ns - first_ns) / 1e9 / self._rate
                # Also when it is late already: clients are served between two messages.
                await asyncio.sleep(max(0.0, due_s - loop.time()))
                self._publish(message)

    def _advertise(self, recorded: RecordedTopic) -> str:
        """Advertise a topic; return the problem, or an empty text."""
        try:
            self._node.advertise(recorded.topic, recorded.type_name, latch=recorded.latched)
        except GraphError as error:
            return f"cannot be offered: {error}"
        return ""

    def _publish(self, message: RecordedMessage) -> None:
        recorded = self._topics.get(message.topic)
        if recorded is None or recorded.type_name != message.type_name:
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
