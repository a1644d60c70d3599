"""The rendered camera's connection to its server."""

from __future__ import annotations

import json
import threading

import pytest
from websockets.sync.server import ServerConnection, serve

from harness.waiting import wait_until
from robot.physics import renderer
from robot.physics.camera import Camera
from server.datasets import rendered
from server.datasets.rendered import RenderedSource
from tests.helpers.robots import so101


class NoRenderer:
    def __init__(self, *_: object) -> None:
        """Draw nothing."""


def test_a_refused_camera_leaves_the_server_before_it_tries_again(monkeypatch: pytest.MonkeyPatch) -> None:
    here: set[ServerConnection] = set()
    tries = 0

    def refuse(connection: ServerConnection) -> None:
        here.add(connection)
        for _ in connection:
            connection.send(json.dumps({"op": "service_response", "id": "camera", "result": False, "values": "no"}))
        here.remove(connection)

    def wait(_duration_s: float) -> None:
        nonlocal tries
        tries += 1
        if tries == 3:
            raise KeyboardInterrupt

    # The source sets it where it is missing, which other tests of this process would see.
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(renderer, "ArmRenderer", NoRenderer)
    monkeypatch.setattr(rendered.time, "sleep", wait)
    with serve(refuse, "127.0.0.1", 0) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"ws://127.0.0.1:{server.socket.getsockname()[1]}"
        source = RenderedSource(url, None, so101(), Camera("base_link", (0.5, 0.0, 0.2), (0.0, 0.0, 0.2), 64, 48))
        with pytest.raises(KeyboardInterrupt):
            source.read()
        monkeypatch.undo()
        wait_until(lambda: not here)
