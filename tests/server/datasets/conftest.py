"""Recordings of an arm that moves evenly, as the server writes them."""

import base64
import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from server.recording.files import RecordedMessage
from tests.server.recordings import START_NS, entry, record

JOINTS = ("shoulder_pan", "gripper")


def stamp(at_s: float) -> dict[str, Any]:
    """A header with the stamp of ``at_s`` after the start of the recording."""
    at_ns = START_NS + round(at_s * 1e9)
    return {"stamp": {"sec": at_ns // 1_000_000_000, "nanosec": at_ns % 1_000_000_000}, "frame_id": ""}


def state(at_s: float, topic: str = "/joint_states", offset: float = 0.0, late_s: float = 0.0) -> RecordedMessage:
    """Joints that move by 0.1 rad/s, and a gripper at 0.5 rad."""
    positions = [0.1 * at_s + offset, 0.5]
    msg = {"header": stamp(at_s), "name": list(JOINTS), "position": positions}
    return entry(topic, "sensor_msgs/JointState", msg, at_s + late_s)


def states(until_s: float, start_s: float = 0.0, rate_hz: float = 50.0, **fields: Any) -> list[RecordedMessage]:
    return [state(start_s + n / rate_hz, **fields) for n in range(round((until_s - start_s) * rate_hz) + 1)]


def mark(text: str, at_s: float) -> RecordedMessage:
    return entry("/dataset/episode", "std_msgs/String", {"data": text}, at_s)


def jpeg(red: int, width: int = 32, height: int = 24) -> bytes:
    """A picture of one colour."""
    packed = io.BytesIO()
    pixels = np.zeros((height, width, 3), dtype=np.uint8)
    pixels[:, :, 0] = red
    Image.fromarray(pixels).save(packed, "JPEG", quality=95)
    return packed.getvalue()


def image(at_s: float, red: int, topic: str = "/camera/image/compressed", **size: int) -> RecordedMessage:
    msg = {"header": stamp(at_s), "format": "jpeg", "data": base64.b64encode(jpeg(red, **size)).decode()}
    return entry(topic, "sensor_msgs/CompressedImage", msg, at_s)


Record = Callable[[Iterable[RecordedMessage]], Path]


def in_order(entries: Iterable[RecordedMessage]) -> list[RecordedMessage]:
    """The messages in the order of their times."""
    return sorted(entries, key=lambda each: each.log_time_ns)


@pytest.fixture
def recorded(tmp_path: Path) -> Record:
    """Write messages, in the order of their times, as a recording."""
    numbers = iter(range(1000))
    return lambda entries: record(tmp_path / f"run_{next(numbers)}.mcap", in_order(entries))
