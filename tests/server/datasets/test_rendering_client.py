"""The client that renders the arm and the scene of a server elsewhere."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed

from harness.waiting import given_up, until
from robot.physics import renderer
from server import publishing_client
from server.datasets.rendered import RenderedCameras, SeenScene
from server.datasets.rendering_client import RenderingClient
from server.publishing_client import PublishedTopic
from tests.helpers.rendering import needs_egl
from tests.helpers.robots import so101
from tests.server.datasets.test_rendered import CAMERA


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
