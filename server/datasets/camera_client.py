"""Rosbridge client that publishes the images of a camera: one in flight at most."""

from __future__ import annotations

import asyncio
import base64
import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from server.datasets.camera import Captured, ImageSource, NewestImage, to_jpeg
from server.publishing_client import Connection, PublishedTopic, PublishingClient, run_until_signal

IMAGE_TYPE = "sensor_msgs/CompressedImage"

# A server that does not take an image within this time has left without a word.
TAKEN_TIMEOUT_S = 10.0

# A camera that is silent is looked at again so often.
LOOK_PERIOD_S = 1.0


@dataclass(frozen=True)
class CameraOptions:
    """Rate, size and JPEG quality of a camera's images; None keeps the camera's width."""

    fps: float
    width: int | None
    quality: int
    frame_id: str = ""


class CameraClient(PublishingClient):
    """Client that publishes a camera's images, each when the server has taken the last: a slow network gets fewer."""

    def __init__(
        self, target: PublishedTopic, options: CameraOptions, source: ImageSource, tell: Callable[[str], None]
    ) -> None:
        super().__init__(target, IMAGE_TYPE, tell)
        self._options = options
        self._arrived = asyncio.Event()
        loop = asyncio.get_running_loop()
        self.images = NewestImage(source, 1.0 / options.fps, lambda: _wake(loop, self._arrived))

    @property
    def ended(self) -> bool:
        """True once the camera has no more images."""
        return self.images.ended

    async def run(self) -> None:
        """Publish the images of the camera; comes back when they end."""
        self.images.start()
        try:
            await self.keep_connected()
        finally:
            await asyncio.to_thread(self.images.close)

    async def publish(self, connection: Connection) -> None:
        """Publish images, one after the other."""
        options, loop = self._options, asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            await asyncio.sleep(due_s - loop.time())
            self._arrived.clear()
            # In this order: the last image comes before the end.
            ended, captured = self.ended, self.images.take()
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
            async with asyncio.timeout(TAKEN_TIMEOUT_S):
                await self.send(connection, _message(captured, jpeg, options.frame_id))
                await (await connection.ping())
            self.published += 1


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


async def publish_camera(
    target: PublishedTopic, options: CameraOptions, source: ImageSource, tell: Callable[[str], None]
) -> tuple[int, bool]:
    """Publish a camera's images until they end or a signal; return their number, and True for a signal."""
    client = CameraClient(target, options, source, tell)
    by_signal = await run_until_signal(client.run())
    return client.published, by_signal
