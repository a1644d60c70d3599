"""A server without an arm, which publishes a recording."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import uvloop

from protocol.registry import Registry
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.config import ServerSettings
from server.gateway.listener import Listener, ListenerSettings
from server.graph.topics import Graph
from server.hangup import on_hangup
from server.recording.player import Player
from server.recording.reader import Outline, Recording
from server.rosapi.api import RosApi

log = logging.getLogger("armbridge.replay")

# Between end and beginning; without it a recording of one message would be a flood.
LOOP_PAUSE_S = 0.1


@dataclass(frozen=True)
class ReplayOptions:
    """What to replay, and how.

    Attributes:
        path: the recording.
        server: where to listen, and how.
        access: who may connect.
        rate: how many seconds of the recording pass in a second.
        delay_s: how long clients have to connect before it begins [s].
        loop: begin again at the end.
    """

    path: Path
    server: ServerSettings
    access: AccessSettings
    rate: float
    delay_s: float
    loop: bool


def replay(options: ReplayOptions) -> None:
    """Offer a recording to clients until its end, SIGINT or SIGTERM.

    Raises:
        RecordingError: the file cannot be read.
        ConfigurationError: the certificate or the tokens cannot be used, or others could connect without any.
        StartError: the port cannot be taken.
    """
    uvloop.run(Replay(options).run())


class Replay:
    """The parts of the server.

    Args:
        options: what was asked for.
    """

    def __init__(self, options: ReplayOptions) -> None:
        self._options = options
        registry = Registry.load()
        self._graph = Graph(registry)
        self._rosapi = RosApi(self._graph, self._graph.services, self._graph.actions, registry, time.time)
        # Nobody drives an arm here, so nobody has to wait for the lease.
        access = Access(options.access.model_copy(update={"control": "shared"}))
        listener_settings = ListenerSettings.from_settings(options.server, options.access, access.tokens)
        place = options.server
        self._listener = Listener(self._graph, place.host, place.port, settings=listener_settings, access=access)
        self._recording = Recording(options.path)
        self._player = Player(self._graph, self._recording, options.rate)

    async def run(self) -> None:
        """Start, play until the end or a signal, stop."""
        ending = asyncio.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().add_signal_handler(number, ending.set)
        on_hangup(self._listener.reload_certificate, ending.set)
        outline = await asyncio.to_thread(self._recording.outline)
        try:
            self._rosapi.open()
            await self._listener.bind()
            await self._listener.open()
            # After the listener, whose own topics are not to be mixed with recorded ones.
            self._player.advertise(outline.tracks)
            log.info("%s", self._what_is_played(outline))
            await self._play_until(ending)
        finally:
            await self._listener.close()
        tally = self._player.tally
        log.info("replay ended: %d messages published, %d could not be read", tally.published, tally.unreadable)

    async def _play_until(self, ending: asyncio.Event) -> None:
        playing = asyncio.create_task(self._play())
        told = asyncio.create_task(ending.wait())
        try:
            await asyncio.wait([playing, told], return_when=asyncio.FIRST_COMPLETED)
        finally:
            told.cancel()
            playing.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await playing

    async def _play(self) -> None:
        await asyncio.sleep(self._options.delay_s)
        await self._player.play()
        while self._options.loop:
            await asyncio.sleep(LOOP_PAUSE_S)
            await self._player.play()

    def _what_is_played(self, outline: Outline) -> str:
        broken = "" if outline.whole else "; the file was not ended in good order, what can be read of it is played"
        return (
            f"armbridge replays {self._options.path}: {self._listener.url} (rosbridge), "
            f"{len(outline.tracks)} topics, {outline.messages} messages, {outline.duration_s:.1f} s{broken}"
        )
