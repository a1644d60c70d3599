"""Messages of rendered cameras, and the client that publishes them."""

from __future__ import annotations

import base64
import contextlib
import functools
import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from harness.waiting import wait_until
from robot.description.camera import Camera
from robot.physics import renderer
from robot.physics.bodies import Body, BodyShape
from server.datasets import rendered
from server.datasets.camera import CameraError
from server.datasets.rendered import PublishedCamera, RenderedCameras, RenderingClient, SeenScene, open_camera
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


def scene(*bodies: tuple[Body, str], stamp_ns: int = 5_000_000_007) -> SeenScene:
    return SeenScene(stamp_ns, {}, bodies, {"box": (1.0, 0.0, 0.0, 1.0)})


@needs_egl
def test_image_info_and_depth_have_the_stamp_of_the_scene_and_the_optical_frame() -> None:
    messages = dict(RenderedCameras(so101(), [CAMERA]).messages(scene(box()), [CAMERA.topic]))
    assert (
        set(messages) == {"/front/image/compressed", "/front/camera_info", "/front/depth/image"} == set(CAMERA.topics)
    )
    for message in messages.values():
        assert message["header"] == {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": "front_optical_frame"}
    image, info, depth = messages.values()
    red = red_pixels(np.asarray(opened(image["data"])))
    # The box is where K of the camera's info has it, at the distance that the depth image has there.
    transform = np.linalg.inv(CAMERA.camera.transform_optical_to_frame)
    in_camera_m = (transform @ (*AT, 1.0))[:3]
    pixel = np.reshape(info["k"], (3, 3)) @ in_camera_m / in_camera_m[2]
    assert red.mean(axis=0) == pytest.approx(pixel[:2], abs=1.0)
    assert np.reshape(info["p"], (3, 4))[:, :3] == pytest.approx(np.reshape(info["k"], (3, 3)))
    assert (info["width"], info["height"], info["distortion_model"], len(info["d"])) == (320, 240, "plumb_bob", 5)
    depth_mm = np.frombuffer(depth["data"], "<u2").reshape(depth["height"], depth["width"])
    column, row = pixel[:2].round().astype(int)
    assert depth_mm[row, column] == pytest.approx(1000 * in_camera_m[2], abs=30)
    assert (depth["encoding"], depth["step"]) == ("16UC1", 640)
    assert depth_mm[0, 0] == 0, "the sky has no distance"


@needs_egl
def test_an_object_moves_with_the_link_that_holds_it_and_a_plane_hides_no_other_object() -> None:
    cameras = RenderedCameras(so101(), [CAMERA])
    ground = Body("ground", (BodyShape("plane", (), (0.0, 0.0, -0.1), LEVEL),), HERE, LEVEL), ""
    seen = []
    for angle_rad in (0.0, 0.5):
        each = SeenScene(0, {"shoulder_pan": angle_rad}, [ground, box("gripper_link")], {"box": (1.0, 0.0, 0.0, 1.0)})
        seen.append(red_pixels(np.asarray(opened(cameras.messages(each, [CAMERA.topic])[0][1]["data"]))))
    assert all(len(pixels) > 20 for pixels in seen)
    assert abs(seen[0].mean(axis=0) - seen[1].mean(axis=0)).max() > 10


def test_without_depth_no_depth_is_published() -> None:
    plain = PublishedCamera(CAMERA.camera.model_copy(update={"depth": False}), "/camera/image/compressed")
    assert list(plain.topics) == ["/camera/image/compressed", "/camera/camera_info"]


@pytest.mark.parametrize(
    ("settings", "refusal"),
    [
        ({"view": (0.0,) * 6}, "view: Value error, the camera must look at another point"),
        ({"view": VIEW, "width": 4096}, "width: .*1280, not 4096"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(settings: dict[str, object], refusal: str) -> None:
    with pytest.raises(CameraError, match=refusal):
        open_camera("so101", CAMERA.topic, 80, frame="", **settings)


def received(connection: ServerConnection) -> str | bytes | None:
    """Return the next frame; None when the client has left, by a close frame that names its error."""
    with contextlib.suppress(ConnectionClosed):
        return connection.recv()
    return None


@contextlib.contextmanager
def serving(handler: Callable[[ServerConnection], None]) -> Iterator[str]:
    """Serve connections by a handler, at a URL."""
    with serve(handler, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"ws://127.0.0.1:{server.socket.getsockname()[1]}"


@needs_egl
def test_an_image_shows_the_state_whose_stamp_it_has_not_the_goals_nor_the_time_of_sending(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    images: list[dict[str, Any]] = []
    goals = {"header": {"stamp": {"sec": 9, "nanosec": 0}}, "name": ["shoulder_pan"], "position": [0.0]}
    around = {"robot_state": {"joint_state": goals, "attached_collision_objects": []}, "object_colors": []}
    calls = 0

    def answer(connection: ServerConnection) -> None:
        nonlocal calls
        for frame in iter(functools.partial(received, connection), None):
            operation = json.loads(frame)
            if operation["op"] == "publish" and operation["topic"] == CAMERA.topic:
                images.append(operation["msg"])
            elif operation["op"] == "call_service":
                calls += 1
                # A state that comes once is one image.
                if calls in (2, 4):
                    header = {"stamp": {"sec": calls, "nanosec": 7}}
                    state = {"header": header, "name": ["shoulder_pan"], "position": [0.25 * calls]}
                    connection.send(json.dumps({"op": "publish", "topic": "/joint_states", "msg": state}))
                values = {"scene": {**around, "world": {"collision_objects": []}}}
                connection.send(
                    json.dumps({"op": "service_response", "id": "camera", "result": True, "values": values})
                )

    def wait(_duration_s: float) -> None:
        if calls > 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(rendered.time, "sleep", wait)
    with serving(answer) as url:
        client = RenderingClient(url, None, so101(), CAMERA, lambda _: None)
        with pytest.raises(KeyboardInterrupt):
            client.run()
        monkeypatch.undo()
        wait_until(lambda: len(images) == 2)
    assert client.published == 2
    assert [image["header"]["stamp"] for image in images] == [{"sec": sec, "nanosec": 7} for sec in (2, 4)]
    cameras = RenderedCameras(so101(), [CAMERA])
    for image, angle_rad in zip(images, (0.5, 1.0), strict=True):
        expected = cameras.messages(SeenScene(0, {"shoulder_pan": angle_rad}, [], {}), [CAMERA.topic])[0][1]["data"]
        assert base64.b64decode(image["data"]) == expected


class NoRenderer:
    def __init__(self, *_: object) -> None:
        """Draw nothing."""


def test_a_refused_camera_leaves_the_server_before_it_tries_again(monkeypatch: pytest.MonkeyPatch) -> None:
    here: set[ServerConnection] = set()
    told: list[str] = []
    tries = 0

    def refuse(connection: ServerConnection) -> None:
        here.add(connection)
        for frame in iter(functools.partial(received, connection), None):
            if json.loads(frame)["op"] == "call_service":
                connection.send(json.dumps({"op": "status", "level": "error", "msg": "not you"}))
                connection.send(json.dumps({"op": "service_response", "id": "camera", "result": False, "values": "no"}))
        here.remove(connection)

    def wait(_duration_s: float) -> None:
        nonlocal tries
        tries += 1
        if tries == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr(renderer, "ArmRenderer", NoRenderer)
    monkeypatch.setattr(rendered.time, "sleep", wait)
    with serving(refuse) as url:
        client = RenderingClient(url, None, so101(), CAMERA, told.append)
        with pytest.raises(KeyboardInterrupt):
            client.run()
        monkeypatch.undo()
        wait_until(lambda: not here)
    assert f"{url}: not you" in told
