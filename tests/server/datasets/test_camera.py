import importlib.util
import io
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from harness.waiting import TIMEOUT_S, wait_until
from server.cli import main
from server.datasets import camera
from server.datasets.camera import CameraError, ImageSource, NewestImage, OpenCvSource, Pixels, open_source, to_jpeg


class Scripted(ImageSource):
    """A camera of which the test takes the images."""

    def __init__(self, *, paced: bool = True, count: int = 1_000_000) -> None:
        self.paced = paced
        self.finite = True
        self.closed = False
        self.allowed = threading.Semaphore(0)
        self.number = 0
        self._count = count

    def read(self) -> Pixels | None:
        self.allowed.acquire(timeout=TIMEOUT_S)
        if self.number >= self._count:
            return None
        self.number += 1
        return np.full((2, 2, 3), self.number, dtype=np.uint8)

    def close(self) -> None:
        self.closed = True


def opened(jpeg: bytes) -> Image.Image:
    return Image.open(io.BytesIO(jpeg))


@pytest.mark.parametrize(("width", "size"), [(None, (64, 48)), (32, (32, 24)), (31, (30, 22))])
def test_an_image_is_scaled_to_a_width_and_has_even_sides(width: int | None, size: tuple[int, int]) -> None:
    assert opened(to_jpeg(np.zeros((48, 64, 3), dtype=np.uint8), width, 80)).size == size


def test_only_the_newest_image_is_kept_and_given_once() -> None:
    source = Scripted()
    images = NewestImage(source, 1.0, lambda: None, wall_clock_ns=lambda: 7)
    images.start()
    source.allowed.release(3)
    wait_until(lambda: images.captured == 3)
    taken = images.take()
    assert taken is not None
    assert (taken[0], taken[1][0, 0, 0]) == (7, 3)
    assert images.take() is None
    source.allowed.release()
    images.close()
    wait_until(lambda: source.closed)


def test_the_end_of_a_file_is_told_after_its_last_image() -> None:
    source, ended_at = Scripted(count=2), []
    images = NewestImage(source, 0.0, lambda: ended_at.append(images.ended))
    images.start()
    source.allowed.release(3)
    wait_until(lambda: images.ended and len(ended_at) == 3)
    assert (ended_at, source.closed) == ([False, False, True], True)
    images.close()


def test_a_source_without_a_pace_is_read_once_a_period() -> None:
    source = Scripted(paced=False)
    source.allowed.release(1000)
    images = NewestImage(source, 1e6, lambda: None)
    images.start()
    wait_until(lambda: images.captured == 1)
    images.close()
    assert images.captured == 1


def test_without_opencv_its_extra_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(camera.importlib, "import_module", missing)
    assert main(["camera", "0"]) == 1
    assert capsys.readouterr().err == "armbridge: a camera needs OpenCV: pip install 'armbridge[camera]'\n"


@pytest.mark.skipif(importlib.util.find_spec("cv2") is None, reason="the extra [camera] is not installed: no OpenCV")
def test_a_video_file_is_read_to_its_end_and_a_device_that_cannot_be_opened_is_said(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match="OpenCV cannot open it; is it a camera or a video, and free"):
        OpenCvSource(str(tmp_path / "none.mp4"), None)
    pytest.importorskip("av", reason="the extra [datasets] is not installed: no av")
    from server.datasets.lerobot import VideoWriter

    path = tmp_path / "v.mp4"
    with VideoWriter(path, 10) as writer:
        for red in (50, 200):
            image = np.zeros((48, 64, 3), dtype=np.uint8)
            image[:, :, 0] = red
            writer.add(image, 1)
    source = open_source(str(path), None)
    assert (source.finite, source.paced) == (True, False)
    reds = []
    while (pixels := source.read()) is not None:
        reds.append(pixels[:, :, 0].mean())
    source.close()
    assert reds == pytest.approx([50, 200], abs=6)
