"""Cameras, and the client that publishes them."""

import asyncio
import base64
import importlib.util
import io
import json
import signal
import subprocess
import sys
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from websockets.asyncio.server import ServerConnection, serve

from harness.clients import arm_client
from harness.server import ROOT, ServerOnBus, free_port
from harness.waiting import TIMEOUT_S, until, wait_until
from server import rosbridge_clients
from server.cli import main
from server.datasets import camera
from server.datasets.camera import (
    CameraClient,
    CameraError,
    CameraOptions,
    ImageSource,
    NewestImage,
    OpenCvSource,
    Pixels,
    TestPattern,
    open_source,
    to_jpeg,
)
from server.rosbridge_clients import PublishedTopic
from tests.helpers.held_connection import HeldConnection


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


def test_a_source_is_read_to_its_end_or_without_a_pace_once_a_period() -> None:
    source, ended_at = Scripted(count=2), []
    images = NewestImage(source, 0.0, lambda: ended_at.append(images.ended))
    images.start()
    source.allowed.release(3)
    wait_until(lambda: images.ended and len(ended_at) == 3)
    assert (ended_at, source.closed) == ([False, False, True], True)
    images.close()
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


TOPIC = "/camera/image/compressed"


def client_of(
    source: ImageSource,
    tell: Callable[[str], None] = lambda _: None,
    url: str = "ws://nowhere",
    token: str | None = None,
) -> CameraClient:
    return CameraClient(PublishedTopic(url, TOPIC, token), CameraOptions(1000.0, None, 80, "wrist"), source, tell)


def numbers(connection: HeldConnection) -> list[int]:
    """Return the value of the pixels of each image that was sent."""
    images = [opened(base64.b64decode(message["data"])) for message in connection.messages]
    return [int(image.getpixel((0, 0))[0]) for image in images]  # type: ignore[index]


class Publishing:
    """A client that publishes what a scripted source takes, on a connection whose pongs the test gives."""

    def __init__(self, source: Scripted, token: str) -> None:
        self.source, self.connection = source, HeldConnection()
        self.client = client_of(source, token=token)
        self.images = NewestImage(source, 0.0, self.client._arrived.set, wall_clock_ns=lambda: 5_000_000_007)
        self.client.images = self.images
        self.images.start()
        self.task = asyncio.create_task(self._publish())

    async def _publish(self) -> None:
        await self.client.announce(self.connection)
        await self.client.publish(self.connection)

    async def pong(self, number: int) -> None:
        """Answer a ping, once it has come."""
        await until(lambda: len(self.connection.pings) > number)
        self.connection.pings[number].set_result(0.0)


async def test_no_image_leaves_before_the_server_has_taken_the_last_and_then_the_newest_does() -> None:
    publishing = Publishing(Scripted(count=40), token="secret")
    connection = publishing.connection
    publishing.source.allowed.release()
    await until(lambda: connection.pings)
    authorized, level, advertised, image = connection.sent
    assert (authorized["op"], image["op"], image["msg"]["format"]) == ("auth", "publish", "jpeg")
    assert level == {"op": "set_level", "level": "error"}
    assert advertised == {"op": "advertise", "topic": TOPIC, "type": "sensor_msgs/CompressedImage"}
    assert image["msg"]["header"] == {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "wrist"}
    publishing.source.allowed.release(20)
    await until(lambda: publishing.images.captured == 21)
    assert (numbers(connection), publishing.client.published) == ([1], 0)
    await publishing.pong(0)
    await until(lambda: len(connection.pings) == 2)
    assert numbers(connection) == [1, 21]
    publishing.source.allowed.release(20)
    await until(lambda: publishing.images.ended)
    await publishing.pong(1)
    await publishing.pong(2)
    await until(publishing.task.done)
    assert (numbers(connection), publishing.client.published) == ([1, 21, 40], 3)


@pytest.mark.parametrize("turns", range(4))
async def test_an_end_that_comes_together_with_an_image_is_not_lost(turns: int) -> None:
    client = client_of(Scripted())
    publishing = asyncio.create_task(client.publish(HeldConnection()))
    for _ in range(10):
        await asyncio.sleep(0)
    client._arrived.set()
    for _ in range(turns):
        await asyncio.sleep(0)
    publishing.cancel()
    await asyncio.wait([publishing], timeout=TIMEOUT_S)
    assert publishing.cancelled()


@asynccontextmanager
async def running(client: CameraClient) -> AsyncIterator[None]:
    """Run a client as long as the block lasts."""
    task = asyncio.create_task(client.run())
    yield
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


async def test_it_connects_again_and_tells_complaints_once(monkeypatch: Any) -> None:
    monkeypatch.setattr(rosbridge_clients, "FIRST_DELAY_S", 0.01)
    told: list[str] = []
    connections: list[int] = []

    async def talk(websocket: ServerConnection) -> None:
        connections.append(0)
        async for frame in websocket:
            if json.loads(frame)["op"] == "publish":
                connections[-1] += 1
                await websocket.send(json.dumps({"op": "status", "level": "error", "msg": "not so"}))
            if connections[-1] == 3:
                return

    async with serve(talk, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        client = client_of(TestPattern(32), told.append, f"ws://127.0.0.1:{port}")
        async with running(client):
            await until(lambda: len(connections) >= 3)
    assert sum("not so" in sentence for sentence in told) == 1
    assert any("trying again in 0.01 s" in sentence for sentence in told)


async def test_a_client_that_is_ended_closes_its_connection_in_good_order() -> None:
    begun, codes = asyncio.Event(), list[int | None]()

    async def listen(websocket: ServerConnection) -> None:
        try:
            async for _ in websocket:
                begun.set()
        finally:
            codes.append(websocket.close_code)

    async with serve(listen, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        async with running(client_of(TestPattern(32), url=f"ws://127.0.0.1:{port}")):
            await asyncio.wait_for(begun.wait(), TIMEOUT_S)
        await until(lambda: codes)
    assert codes == [1000]


async def test_it_waits_longer_each_time_for_a_server_that_is_not_there(monkeypatch: Any) -> None:
    monkeypatch.setattr(rosbridge_clients, "FIRST_DELAY_S", 0.01)
    monkeypatch.setattr(rosbridge_clients, "LAST_DELAY_S", 0.04)
    told: list[str] = []
    client = client_of(TestPattern(32), told.append, f"ws://127.0.0.1:{free_port()}")
    async with running(client):
        await until(lambda: len(told) >= 4)
    assert [sentence.rpartition(" in ")[2] for sentence in told[:4]] == ["0.01 s", "0.02 s", "0.04 s", "0.04 s"]


async def test_the_command_publishes_the_test_pattern_until_sigint(served: ServerOnBus) -> None:
    arguments = ["camera", "test", "--connect", served.server.url, "--width", "64", "--fps", "30"]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "server.cli", *arguments, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        async with arm_client(served.server.url) as client:
            await client.say("subscribe", topic=TOPIC, type="sensor_msgs/CompressedImage")
            images = await client.until(TOPIC, lambda all_: len(all_) >= 3)
        process.send_signal(signal.SIGINT)
        out, err = await asyncio.wait_for(process.communicate(), TIMEOUT_S)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode == 0, err
    assert out.decode().endswith(f"images published on {TOPIC}\n")
    assert opened(base64.b64decode(images[0]["data"])).size == (64, 48)
    assert images[0]["header"]["frame_id"] == "test"
