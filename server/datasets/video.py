"""Videos of a dataset: images of a camera, encoded one after another as H.264 in MP4."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

CODEC, PIXEL_FORMAT = "h264", "yuv420p"

# A key frame every other frame, as lerobot does: training reads single frames at random.
ENCODER_OPTIONS = {"g": "2", "crf": "23", "preset": "veryfast"}

# Larger ones are damage, or no camera's.
MAX_SIDE_PIXELS = 8192


class VideoError(Exception):
    """Images that make no video; the text is one sentence."""


def decode(data: bytes) -> NDArray[np.uint8]:
    """Return a compressed image as its pixels, shape (height, width, 3), or raise VideoError."""
    try:
        with Image.open(io.BytesIO(data)) as image:
            if max(image.size) > MAX_SIDE_PIXELS:
                raise VideoError(f"an image must have at most {MAX_SIDE_PIXELS} pixels a side, not {max(image.size)}")
            return np.asarray(image.convert("RGB"))
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError) as error:
        raise VideoError(f"an image cannot be read: {error}") from error


class VideoWriter:
    """MP4 file that is being written; ``shape`` is (height, width), zeros before the first frame."""

    def __init__(self, path: Path, fps: int) -> None:
        # Imported when it is needed: an extra of those who export videos.
        import av

        self.shape = (0, 0)
        self.frames = 0
        self._fps = fps
        self._make_frame = av.VideoFrame.from_ndarray
        path.parent.mkdir(parents=True)
        self._container = av.open(str(path), "w")
        stream: Any = self._container.add_stream(CODEC, rate=fps, options=dict(ENCODER_OPTIONS))
        self._stream = stream
        self._stream.pix_fmt = PIXEL_FORMAT
        self._stream.time_base = Fraction(1, fps)

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None and self.frames:
            self._container.mux(self._stream.encode())
        self._container.close()

    def add(self, image: NDArray[np.uint8], times: int) -> None:
        """Append an image of shape (height, width, 3), or raise VideoError if its size does not fit."""
        height, width = image.shape[:2]
        if not self.frames:
            if height % 2 or width % 2:
                raise VideoError(f"images must have even width and height for {PIXEL_FORMAT}, not {width}x{height}")
            self.shape = height, width
            self._stream.width, self._stream.height = width, height
        if self.shape != (height, width):
            first = f"{self.shape[1]}x{self.shape[0]}"
            raise VideoError(f"all images must have the size of the first one, {first}, not {width}x{height}")
        for _ in range(times):
            frame = self._make_frame(image, format="rgb24")
            frame.pts = self.frames
            frame.time_base = Fraction(1, self._fps)
            self._container.mux(self._stream.encode(frame))
            self.frames += 1
