"""Rosbridge client that publishes the images of a camera: one in flight at most, and reconnecting."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any, Protocol

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException

from server.datasets.camera import Captured, ImageSource, NewestImage, to_jpeg
from server.lifecycle import stop_signals

IMAGE_TYPE = "sensor_msgs/CompressedImage"

OPEN_TIMEOUT_S = 10.0

# A server that does not take an image within this time has left without a word.
TAKEN_TIMEOUT_S = 10.0

# A camera that is silent is looked at again so often.
LOOK_PERIOD_S = 1.0

FIRST_DELAY_S, LAST_DELAY_S = 0.5, 10.0

# Answers of the server are complaints, each printed once.
MAX_COMPLAINTS = 20

# What a server answers to a client that only publishes is short.
MAX_ANSWER_BYTES = 1_000_000


@dataclass(frozen=True)
class CameraOptions:
    """Options of a camera's client.

    Attributes:
        token: of an operator; None where none is needed.
    """

    url: str
    topic: str
    token: str | None
    fps: float
    width: int | None
    quality: int
    frame_id: str = ""


class CameraConnection(Protocol):
    """Connection, as far as a client uses it."""

    async def send(self, message: str) -> None:
        """Send a frame."""

    async def ping(self) -> Awaitable[float]:
        """Send a ping; the returned future waits for its pong."""


class CameraClient:
    """Client of a server that publishes the images of a camera until they end.

    An image is published when the server has taken the last one: a ping follows each, and its pong says that the server
    has read everything before it (RFC 6455, section 5.5.2). On a slow network there are fewer images, and no old ones.

    Attributes:
        published: number of images that the server has taken.
    """

    def __init__(self, options: CameraOptions, tell: Callable[[str], None]) -> None:
        self.published = 0
        self._options = options
        self._tell = tell
        self._arrived = asyncio.Event()
        self._complaints: set[str] = set()

    async def run(self, source: ImageSource) -> None:
        """Publish the images of a camera; comes back when they end."""
        loop = asyncio.get_running_loop()
        images = NewestImage(source, 1.0 / self._options.fps, lambda: _wake(loop, self._arrived))
        images.start()
        try:
            await self._keep_connected(images)
        finally:
            await asyncio.to_thread(images.close)

    async def _keep_connected(self, images: NewestImage) -> None:
        url, delay_s = self._options.url, FIRST_DELAY_S
        while not images.ended:
            before = self.published
            try:
                async with connect(url, open_timeout=OPEN_TIMEOUT_S, max_size=MAX_ANSWER_BYTES) as websocket:
                    self._tell(f"connected to {url}")
                    await self._converse(websocket, images)
            except (OSError, WebSocketException, TimeoutError) as error:
                if self.published > before:
                    delay_s = FIRST_DELAY_S
                self._tell(f"{url}: {str(error) or type(error).__name__}; trying again in {delay_s:g} s")
                await asyncio.sleep(delay_s)
                delay_s = min(2.0 * delay_s, LAST_DELAY_S)

    async def _converse(self, websocket: ClientConnection, images: NewestImage) -> None:
        listening = asyncio.create_task(self._listen(websocket))
        try:
            await self.publish(websocket, images)
        finally:
            listening.cancel()
            await asyncio.gather(listening, return_exceptions=True)

    async def publish(self, connection: CameraConnection, images: NewestImage) -> None:
        """Publish images on a connection until they end.

        Raises:
            WebSocketException: the connection has ended.
            TimeoutError: the server does not take an image.
        """
        options, loop = self._options, asyncio.get_running_loop()
        if options.token is not None:
            await connection.send(json.dumps({"op": "auth", "token": options.token}))
        await connection.send(json.dumps({"op": "advertise", "topic": options.topic, "type": IMAGE_TYPE}))
        due_s = loop.time()
        while True:
            await asyncio.sleep(due_s - loop.time())
            self._arrived.clear()
            # In this order: the last image comes before the end.
            ended, captured = images.ended, images.take()
            if captured is None:
                if ended:
                    return
                # Not wait_for: Python 3.11's loses a cancellation that comes together with what it waits for.
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_PERIOD_S):
                        await self._arrived.wait()
                continue
            due_s = max(due_s + 1.0 / options.fps, loop.time())
            jpeg = await asyncio.to_thread(to_jpeg, captured.pixels, options.width, options.quality)
            operation = {"op": "publish", "topic": options.topic, "msg": _message(captured, jpeg, options.frame_id)}
            async with asyncio.timeout(TAKEN_TIMEOUT_S):
                await connection.send(json.dumps(operation))
                await (await connection.ping())
            self.published += 1

    async def _listen(self, websocket: ClientConnection) -> None:
        """Tell what the server complains about, each sentence once."""
        async for frame in websocket:
            with contextlib.suppress(ValueError):
                complaint = _complaint(json.loads(frame))
                if complaint and complaint not in self._complaints and len(self._complaints) < MAX_COMPLAINTS:
                    self._complaints.add(complaint)
                    self._tell(f"{self._options.url}: {complaint}")


def _wake(loop: asyncio.AbstractEventLoop, event: asyncio.Event) -> None:
    """Set an event of a loop from another thread, unless the loop has ended."""
    with contextlib.suppress(RuntimeError):
        loop.call_soon_threadsafe(event.set)


def _message(captured: Captured, jpeg: bytes, frame_id: str) -> dict[str, Any]:
    sec, nanosec = divmod(captured.stamp_ns, 1_000_000_000)
    return {
        "header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": frame_id},
        "format": "jpeg",
        "data": base64.b64encode(jpeg).decode(),
    }


def _complaint(answer: Any) -> str:
    """Return the sentence of a status message with an error or a warning; empty for anything else."""
    if not isinstance(answer, dict) or answer.get("op") != "status" or answer.get("level") not in ("error", "warning"):
        return ""
    return str(answer.get("msg", ""))


async def publish_camera(options: CameraOptions, source: ImageSource, tell: Callable[[str], None]) -> tuple[int, bool]:
    """Publish a camera's images until they end, SIGINT or SIGTERM.

    Returns:
        Number of published images, and True if a signal has ended it.
    """
    ending, _hurry = stop_signals()
    client = CameraClient(options, tell)
    running, ended = asyncio.create_task(client.run(source)), asyncio.create_task(ending.wait())
    await asyncio.wait([running, ended], return_when=asyncio.FIRST_COMPLETED)
    for task in (running, ended):
        task.cancel()
    await asyncio.gather(ended, return_exceptions=True)
    with contextlib.suppress(asyncio.CancelledError):
        await running
    return client.published, ending.is_set()
