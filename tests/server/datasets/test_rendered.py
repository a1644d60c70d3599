"""Rendered cameras, and the client that renders them elsewhere."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from harness.waiting import given_up, until
from robot.description.camera import Camera
from robot.physics import renderer
from robot.physics.bodies import Body, BodyShape
from server import publishing_client
from server.datasets.rendered import LoadCameras, PublishedCamera, RenderedCameras, SeenScene
from server.datasets.rendering_client import RenderingClient
from server.datasets.rendering_process import serve as serve_images
from server.publishing_client import PublishedTopic
from tests.helpers.rendering import needs_egl, red_pixels
from tests.helpers.robots import so101
from tests.server.datasets.test_camera import opened

LEVEL = (0.0, 0.0, 0.0, 1.0)
HERE = (0.0, 0.0, 0.0)
BETWEEN_FINGERS = (0.0, 0.0, -0.12)
VIEW = (0.6, -0.4, 0.4, 0.15, 0.0, 0.05)
CAMERA = PublishedCamera(Camera(frame="base_link", view=VIEW, depth=True), "/front/image/compressed")
AT = (0.3, 0.15, 0.02)


def box(link: str = "") -> tuple[Body, str]:
    shape = BodyShape("box", (0.02, 0.02, 0.02), HERE, LEVEL)
    return Body("box", (shape,), BETWEEN_FINGERS if link else AT, LEVEL), link


def red_of(image: dict[str, Any]) -> NDArray[np.int64]:
    """Return the red pixels of a sensor_msgs/CompressedImage, shape (n, 2)."""
    return red_pixels(np.asarray(opened(base64.b64decode(image["data"]))))


@needs_egl
def test_an_object_moves_with_the_link_that_holds_it_and_a_plane_hides_no_other_object() -> None:
    cameras = RenderedCameras(so101(), [CAMERA])
    ground = Body("ground", (BodyShape("plane", (), (0.0, 0.0, -0.1), LEVEL),), HERE, LEVEL), ""
    seen = []
    for angle_rad in (0.0, 0.5):
        each = SeenScene(0, {"shoulder_pan": angle_rad}, [ground, box("gripper_link")], {"box": (1.0, 0.0, 0.0, 1.0)})
        seen.append(red_of(cameras.messages(each, [CAMERA.topic])[0][1]))
    assert all(len(pixels) > 20 for pixels in seen)
    assert abs(seen[0].mean(axis=0) - seen[1].mean(axis=0)).max() > 10


@needs_egl
def test_image_info_and_depth_have_the_stamp_of_the_scene_and_the_optical_frame() -> None:
    seen = SeenScene(5_000_000_007, {}, [box()], {"box": (1.0, 0.0, 0.0, 1.0)})
    messages = dict(RenderedCameras(so101(), [CAMERA]).messages(seen, CAMERA.topics))
    topics = {"/front/image/compressed", "/front/camera_info", "/front/depth/image"}
    assert set(messages) == topics == set(CAMERA.topics)
    for message in messages.values():
        assert message["header"] == {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "front_optical_frame"}
    image, info, depth = messages.values()
    red = red_of(image)
    # The box is where K of the camera's info has it, at the distance that the depth image has there.
    transform = np.linalg.inv(CAMERA.camera.transform_optical_to_frame)
    in_camera_m = (transform @ (*AT, 1.0))[:3]
    pixel = np.reshape(info["k"], (3, 3)) @ in_camera_m / in_camera_m[2]
    assert red.mean(axis=0) == pytest.approx(pixel[:2], abs=1.0)
    assert np.reshape(info["p"], (3, 4))[:, :3] == pytest.approx(np.reshape(info["k"], (3, 3)))
    assert (info["width"], info["height"], info["distortion_model"], len(info["d"])) == (320, 240, "plumb_bob", 5)
    depth_mm = np.frombuffer(base64.b64decode(depth["data"]), "<u2").reshape(depth["height"], depth["width"])
    column, row = pixel[:2].round().astype(int)
    assert depth_mm[row, column] == pytest.approx(1000 * in_camera_m[2], abs=30)
    assert (depth["encoding"], depth["step"]) == ("16UC1", 640)
    assert depth_mm[0, 0] == 0, "the sky has no distance"


def test_without_depth_no_depth_is_published() -> None:
    plain = PublishedCamera(CAMERA.camera.model_copy(update={"depth": False}), "/camera/image/compressed")
    assert list(plain.topics) == ["/camera/image/compressed", "/camera/camera_info"]


# The process that renders.


class FakeChannel:
    """The process's end of its channel, which ends after one message."""

    def __init__(self, first: object) -> None:
        self.sent: list[Any] = []
        self.closed = first is None
        self._first = first

    def receive(self, _timeout_s: float | None) -> list[object]:
        self.closed = True
        return [self._first]

    def send(self, message: object) -> None:
        self.sent.append(message)


def test_the_process_reports_why_it_cannot_render() -> None:
    nowhere = PublishedCamera(CAMERA.camera.model_copy(update={"frame": "hand"}), CAMERA.topic)
    reason = "camera '/front/image/compressed' is on the link 'hand', which the arm does not have"
    for first, reasons in ((LoadCameras(so101(), [nowhere]), [reason]), (None, [])):
        channel = FakeChannel(first)
        serve_images(cast(Any, channel))
        assert [each.reason for each in channel.sent] == reasons


@contextlib.asynccontextmanager
async def client_of(
    answer: Callable[[ServerConnection], Awaitable[None]], told: list[str]
) -> AsyncIterator[RenderingClient]:
    """A client that runs at a server."""
    async with serve(answer, "127.0.0.1", 0) as server:
        target = PublishedTopic(f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}", CAMERA.topic, None)
        client = RenderingClient(target, so101(), CAMERA, told.append)
        running = asyncio.create_task(client.run())
        yield client
        await given_up(running)


@needs_egl
async def test_an_image_shows_the_state_whose_stamp_it_has_not_the_goals_nor_the_time_of_sending() -> None:
    images: list[dict[str, Any]] = []
    goals = {"header": {"stamp": {"sec": 9, "nanosec": 0}}, "name": ["shoulder_pan"], "position": [0.0]}
    around = {"robot_state": {"joint_state": goals, "attached_collision_objects": []}, "object_colors": []}
    values = {"scene": {**around, "world": {"collision_objects": []}}}
    calls = 0

    async def answer(connection: ServerConnection) -> None:
        nonlocal calls
        async for frame in connection:
            operation = json.loads(frame)
            if operation["op"] == "publish" and operation["topic"] == CAMERA.topic:
                images.append(operation["msg"])
            elif operation["op"] == "call_service":
                calls += 1
                # A state that comes once is one image.
                if calls in (2, 4):
                    header = {"stamp": {"sec": calls, "nanosec": 7}}
                    state = {"header": header, "name": ["shoulder_pan"], "position": [0.25 * calls]}
                    await connection.send(json.dumps({"op": "publish", "topic": "/joint_states", "msg": state}))
                response = {"op": "service_response", "id": "camera", "result": True, "values": values}
                await connection.send(json.dumps(response))

    async with client_of(answer, []) as client:
        await until(lambda: calls > 5)
    assert client.published == 2
    assert [image["header"]["stamp"] for image in images] == [{"sec": sec, "nanosec": 7} for sec in (2, 4)]
    cameras = RenderedCameras(so101(), [CAMERA])
    for image, angle_rad in zip(images, (0.5, 1.0), strict=True):
        expected = cameras.messages(SeenScene(0, {"shoulder_pan": angle_rad}, [], {}), [CAMERA.topic])[0][1]["data"]
        assert image["data"] == expected


@pytest.mark.parametrize(
    ("result", "values", "sentence"),
    [(False, "no", "the planning scene is refused: no"), (True, {}, "the server's answer cannot be read: ")],
)
async def test_a_refused_camera_leaves_the_server_before_it_tries_again(
    monkeypatch: pytest.MonkeyPatch, result: bool, values: Any, sentence: str
) -> None:
    here: set[ServerConnection] = set()
    told: list[str] = []
    others: list[int] = []

    async def refuse(connection: ServerConnection) -> None:
        others.append(len(here))
        here.add(connection)
        with contextlib.suppress(ConnectionClosed):
            async for frame in connection:
                if json.loads(frame)["op"] == "call_service":
                    refusal = {"op": "service_response", "id": "camera", "result": result, "values": values}
                    await connection.send(json.dumps({"op": "status", "level": "error", "msg": "not you"}))
                    await connection.send(json.dumps(refusal))
        here.remove(connection)

    monkeypatch.setattr(renderer, "ArmRenderer", lambda *_: None)
    monkeypatch.setattr(publishing_client, "FIRST_DELAY_S", 0.01)
    async with client_of(refuse, told):
        await until(lambda: len(others) == 3)
    assert others == [0, 0, 0]
    assert sum(each.endswith(": not you") for each in told) == 1
    assert any(sentence in each and "; trying again in" in each for each in told)
