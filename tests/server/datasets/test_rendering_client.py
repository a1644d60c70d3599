"""The client that renders the arm and the scene of a server elsewhere."""

from __future__ import annotations

import contextlib
import itertools
import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from harness.waiting import wait_until
from robot.physics import renderer
from server.datasets import rendering_client
from server.datasets.camera import CameraError
from server.datasets.rendered import RenderedCameras, SeenScene
from server.datasets.rendering_client import RenderingClient, open_camera
from tests.helpers.rendering import needs_egl
from tests.helpers.robots import so101
from tests.server.datasets.test_rendered import CAMERA, VIEW


@pytest.mark.parametrize(
    ("settings", "refusal"),
    [
        ({"view": (0.0,) * 6}, "view: the camera must look at another point"),
        ({"view": VIEW, "width": 4096}, "width: must be less than or equal to 1280, not 4096"),
    ],
)
def test_a_camera_that_cannot_be_is_refused(settings: dict[str, object], refusal: str) -> None:
    with pytest.raises(CameraError, match=refusal):
        open_camera("so101", CAMERA.topic, 80, frame="", **settings)


def operations(connection: ServerConnection) -> Iterator[dict[str, Any]]:
    """The operations of a client until it has left, by a close frame that names its error."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            yield json.loads(connection.recv())


@contextlib.contextmanager
def ended_client(
    answer: Callable[[ServerConnection], None], last_wait: Callable[[], bool], told: list[str] | None = None
) -> Iterator[tuple[str, RenderingClient]]:
    """A client that has run up to one of its waits, at a server that goes on answering, and the URL of that."""

    def wait(_duration_s: float) -> None:
        if last_wait():
            raise KeyboardInterrupt

    with serve(answer, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        client = RenderingClient(url, None, so101(), CAMERA, ([] if told is None else told).append)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(rendering_client.time, "sleep", wait)
            with pytest.raises(KeyboardInterrupt):
                client.run()
        yield url, client


@needs_egl
def test_an_image_shows_the_state_whose_stamp_it_has_not_the_goals_nor_the_time_of_sending() -> None:
    images: list[dict[str, Any]] = []
    goals = {"header": {"stamp": {"sec": 9, "nanosec": 0}}, "name": ["shoulder_pan"], "position": [0.0]}
    around = {"robot_state": {"joint_state": goals, "attached_collision_objects": []}, "object_colors": []}
    values = {"scene": {**around, "world": {"collision_objects": []}}}
    calls = 0

    def answer(connection: ServerConnection) -> None:
        nonlocal calls
        for operation in operations(connection):
            if operation["op"] == "publish" and operation["topic"] == CAMERA.topic:
                images.append(operation["msg"])
            elif operation["op"] == "call_service":
                calls += 1
                # A state that comes once is one image.
                if calls in (2, 4):
                    header = {"stamp": {"sec": calls, "nanosec": 7}}
                    state = {"header": header, "name": ["shoulder_pan"], "position": [0.25 * calls]}
                    connection.send(json.dumps({"op": "publish", "topic": "/joint_states", "msg": state}))
                response = {"op": "service_response", "id": "camera", "result": True, "values": values}
                connection.send(json.dumps(response))

    with ended_client(answer, lambda: calls > 5) as (_, client):
        wait_until(lambda: len(images) == 2)
    assert client.published == 2
    assert [image["header"]["stamp"] for image in images] == [{"sec": sec, "nanosec": 7} for sec in (2, 4)]
    cameras = RenderedCameras(so101(), [CAMERA])
    for image, angle_rad in zip(images, (0.5, 1.0), strict=True):
        expected = cameras.messages(SeenScene(0, {"shoulder_pan": angle_rad}, [], {}), [CAMERA.topic])[0][1]["data"]
        assert image["data"] == expected


def test_a_refused_camera_leaves_the_server_before_it_tries_again(monkeypatch: pytest.MonkeyPatch) -> None:
    here: set[ServerConnection] = set()
    told: list[str] = []
    tries = itertools.count(1)

    def refuse(connection: ServerConnection) -> None:
        here.add(connection)
        for operation in operations(connection):
            if operation["op"] == "call_service":
                connection.send(json.dumps({"op": "status", "level": "error", "msg": "not you"}))
                connection.send(json.dumps({"op": "service_response", "id": "camera", "result": False, "values": "no"}))
        here.remove(connection)

    monkeypatch.setattr(renderer, "ArmRenderer", lambda *_: None)
    with ended_client(refuse, lambda: next(tries) == 3, told) as (url, _):
        wait_until(lambda: not here)
    assert f"{url}: not you" in told
