"""Cameras: devices and video files by OpenCV, a test pattern, and the client that publishes their newest images."""

import asyncio
import base64
import contextlib
import importlib
import io
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from websockets.asyncio.client import ClientConnection

from server.errors import ServerError
from server.rosbridge_clients import PublishedTopic, PublishingClient
from server.timers import call_in_loop

TEST_DEVICE = "test"
TEST_WIDTH, TEST_HEIGHT = 640, 480

# Colour bars of SMPTE's pattern, left to right, as red, green and blue.
_BARS = np.array(
    [(235, 235, 235), (235, 235, 16), (16, 235, 235), (16, 235, 16), (235, 16, 235), (235, 16, 16), (16, 16, 235)],
    dtype=np.uint8,
)

# Number of images in which the square crosses the picture.
_SQUARE_STEPS = 60
_SQUARE_SHARE = 8

# A driver gives the image that it is asked for within a period, or has lost the device.
CLOSE_TIMEOUT_S = 2.0

Pixels = NDArray[np.uint8]


class CameraError(ServerError):
    """A camera that cannot be used; the text is one sentence."""


class ImageSource(ABC):
    """Source of images, ``paced`` if it gives them at its own rate, ``finite`` if it ends of itself."""

    paced = False
    finite = False

    @abstractmethod
    def read(self) -> Pixels | None:
        """Return the next image, shape (height, width, 3); None after the last one."""

    def close(self) -> None:  # noqa: B027 - not every source has a device
        """Give the device back."""


class TestPattern(ImageSource):
    """Colour bars with a white square that moves."""

    __test__ = False

    def __init__(self, width: int | None) -> None:
        self._width = width or TEST_WIDTH
        self._height = even(self._width * TEST_HEIGHT // TEST_WIDTH)
        columns = np.arange(self._width) * len(_BARS) // self._width
        self._bars = np.broadcast_to(_BARS[columns], (self._height, self._width, 3))
        self._number = 0

    def read(self) -> Pixels | None:
        image = self._bars.copy()
        side = max(2, self._height // _SQUARE_SHARE)
        left = (self._width - side) * (self._number % _SQUARE_STEPS) // _SQUARE_STEPS
        top = (self._height - side) // 2
        image[top : top + side, left : left + side] = 255
        self._number += 1
        return image


class OpenCvSource(ImageSource):
    """Camera or video file that OpenCV reads, or CameraError."""

    def __init__(self, device: str, width: int | None) -> None:
        try:
            # An extra, without which mypy does not know it either.
            self._cv2: Any = importlib.import_module("cv2")
        except ImportError as error:
            raise CameraError("a camera needs OpenCV: pip install 'armbridge[camera]'") from error
        self.finite = Path(device).is_file()
        self.paced = not self.finite
        self._capture = self._cv2.VideoCapture(int(device) if device.isdecimal() else device)
        if not self._capture.isOpened():
            raise CameraError(f"{device}: OpenCV cannot open it; is it a camera or a video, and free?")
        if self.paced:
            # The newest image, not the oldest of four; not every driver does it.
            self._capture.set(self._cv2.CAP_PROP_BUFFERSIZE, 1)
            if width is not None:
                self._capture.set(self._cv2.CAP_PROP_FRAME_WIDTH, width)

    def read(self) -> Pixels | None:
        """Return the next image; None at the end of a file, or when the camera is gone."""
        read, image = self._capture.read()
        if not read:
            return None
        pixels: Pixels = self._cv2.cvtColor(image, self._cv2.COLOR_BGR2RGB)
        return pixels

    def close(self) -> None:
        self._capture.release()


def open_source(device: str, width: int | None) -> ImageSource:
    return TestPattern(width) if device == TEST_DEVICE else OpenCvSource(device, width)


def even(pixels: int) -> int:
    """Return the even number below: H.264 in yuv420p, as datasets have it, knows no others."""
    return pixels // 2 * 2


def to_jpeg(pixels: Pixels, width: int | None, quality: int) -> bytes:
    """Return an image of shape (height, width, 3) as JPEG of a quality from 1 to 95, with even width and height."""
    image = Image.fromarray(pixels)
    if width is not None and width != image.width:
        image = image.resize((width, max(2, round(image.height * width / image.width))))
    if (image.width % 2, image.height % 2) != (0, 0):
        image = image.crop((0, 0, even(image.width), even(image.height)))
    packed = io.BytesIO()
    image.save(packed, "JPEG", quality=quality)
    return packed.getvalue()


class NewestImage:
    """Thread that reads a camera and keeps its newest image alone, and calls ``arrived`` after each and at the end."""

    def __init__(
        self,
        source: ImageSource,
        period_s: float,
        arrived: Callable[[], None],
        wall_clock_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.captured = 0
        self._source = source
        self._period_s = period_s
        self._arrived = arrived
        self._wall_clock_ns = wall_clock_ns
        self._newest: tuple[int, Pixels] | None = None
        self._ending = threading.Event()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)

    @property
    def ended(self) -> bool:
        return self._ended.is_set()

    def start(self) -> None:
        self._thread.start()

    def take(self) -> tuple[int, Pixels] | None:
        """Return stamp [ns] and pixels of the newest image, once; None while there is no new one."""
        newest, self._newest = self._newest, None
        return newest

    def close(self) -> None:
        """Stop reading; a driver that does not come back is left to the end of the process."""
        self._ending.set()
        self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        due_s = time.monotonic()
        try:
            while not self._ending.is_set() and (pixels := self._source.read()) is not None:
                self._newest = self._wall_clock_ns(), pixels
                self.captured += 1
                self._arrived()
                if not self._source.paced:
                    due_s = max(due_s + self._period_s, time.monotonic())
                    self._ending.wait(due_s - time.monotonic())
        finally:
            self._source.close()
            self._ended.set()
            self._arrived()


IMAGE_TYPE = "sensor_msgs/CompressedImage"

# A server that does not take an image within this time has left without a word.
TAKEN_TIMEOUT_S = 10.0

# Interval of looking at a silent camera again [s].
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
        self, target: PublishedTopic, options: CameraOptions, source: ImageSource, report: Callable[[str], None]
    ) -> None:
        super().__init__(target, IMAGE_TYPE, report)
        self.finite = source.finite
        self._options = options
        self._arrived = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self.images = NewestImage(source, 1.0 / options.fps, self._note_image)

    @property
    def ended(self) -> bool:
        return self.images.ended

    async def run(self) -> None:
        """Publish the images of the camera; comes back when they end."""
        self._loop = asyncio.get_running_loop()
        self.images.start()
        try:
            await super().run()
        finally:
            await asyncio.to_thread(self.images.close)

    async def publish(self, connection: ClientConnection) -> None:
        options, loop = self._options, asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            await asyncio.sleep(due_s - loop.time())
            self._arrived.clear()
            # In this order: the last image comes before the end.
            ended, newest = self.ended, self.images.take()
            if newest is None:
                if ended:
                    return
                # Not wait_for: Python 3.11's loses a cancellation that comes together with what it waits for.
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(LOOK_PERIOD_S):
                        await self._arrived.wait()
                continue
            due_s = max(due_s + 1.0 / options.fps, loop.time())
            stamp_ns, pixels = newest
            sec, nanosec = divmod(stamp_ns, 1_000_000_000)
            header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": options.frame_id}
            jpeg = await asyncio.to_thread(to_jpeg, pixels, options.width, options.quality)
            message = {"header": header, "format": "jpeg", "data": base64.b64encode(jpeg).decode()}
            async with asyncio.timeout(TAKEN_TIMEOUT_S):
                await self.send(connection, message)
                await (await connection.ping())
            self.published += 1

    def _note_image(self) -> None:
        if self._loop is not None:
            call_in_loop(self._loop, self._arrived.set)
