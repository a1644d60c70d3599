"""A topic of compressed images as a camera of lerobot."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from lerobot.cameras import Camera
from lerobot.utils.decorators import check_if_already_connected
from lerobot.utils.errors import DeviceNotConnectedError
from numpy.typing import NDArray

from armbridge_client import Arm, connect
from armbridge_client.messages import CompressedImage
from lerobot_robot_armbridge.config_armbridge import ArmbridgeCameraConfig
from lerobot_robot_armbridge.link import FIRST_MESSAGE_TIMEOUT_S, Watch


class ArmbridgeCamera(Camera):
    """Images of a topic of sensor_msgs/CompressedImage, decoded to RGB."""

    def __init__(self, config: ArmbridgeCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self.width: int | None = config.width
        self.height: int | None = config.height
        self._arm: Arm | None = None
        self._images: Watch[CompressedImage] | None = None
        self._read = 0

    @property
    def is_connected(self) -> bool:
        """True from connect to disconnect."""
        return self._images is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return none: lerobot names no server to look at."""
        return []

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:  # noqa: ARG002 - lerobot's signature
        """Subscribe, and wait for the first image.

        Raises:
            DeadlineExceeded: no image came within 5 s.
            ValueError: the images have another size than the options name.
        """
        self._arm = connect(self.config.url)
        try:
            self._images = Watch(self._arm, self.config.topic, CompressedImage)
            height, width, _ = self._decode(self._images.latched()).shape
            self._check_size(width, height)
        except BaseException:
            self.disconnect()
            raise

    def read(self) -> NDArray[Any]:
        """Return the next image."""
        return self.async_read(timeout_ms=1000.0 * FIRST_MESSAGE_TIMEOUT_S)

    def async_read(self, timeout_ms: float = 200.0) -> NDArray[Any]:
        """Return the newest image that was not read yet.

        Raises:
            TimeoutError: no new image came in time.
        """
        newest = self._connected.after(self._read, timeout_ms / 1000.0)
        self._read = newest.number
        return self._decode(newest.message)

    def read_latest(self, max_age_ms: int = 500) -> NDArray[Any]:
        """Return the newest image.

        Raises:
            TimeoutError: it is older than ``max_age_ms``.
        """
        return self._decode(self._connected.newest(max_age_ms / 1000.0))

    def disconnect(self) -> None:
        """Close the connection."""
        if self._arm is not None:
            self._arm.close()
        self._arm = self._images = None

    def _check_size(self, width: int, height: int) -> None:
        if (self.width or width, self.height or height) != (width, height):
            raise ValueError(
                f"{self.config.topic}: its images have {width} x {height} pixels; width and height say "
                f"{self.width} x {self.height}"
            )
        self.width, self.height = width, height

    @property
    def _connected(self) -> Watch[CompressedImage]:
        if self._images is None:
            raise DeviceNotConnectedError(f"the camera on {self.config.topic} is not connected: call connect() first")
        return self._images

    def _decode(self, message: CompressedImage) -> NDArray[Any]:
        image = cv2.imdecode(np.frombuffer(bytes(message.data), dtype=np.uint8), cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError(f"{self.config.topic}: an image of format {message.format!r} cannot be decoded")
        return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
