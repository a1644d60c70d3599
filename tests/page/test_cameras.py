"""Cameras: pictures of any client as tiles, asked for only while they are seen."""

import base64
import io
import json
from typing import Any

from PIL import Image
from websockets.sync.client import connect

from harness.clients import call
from harness.page import OpenPage
from harness.server import RunningServer

TOPIC = "/camera/image/compressed"
TYPE = "sensor_msgs/CompressedImage"


def picture(width: int, kind: str) -> dict[str, Any]:
    """Return a CompressedImage of a width."""
    file = io.BytesIO()
    Image.new("RGB", (width, 40), (20, 120, 200)).save(file, kind)
    return {"format": kind, "data": base64.b64encode(file.getvalue()).decode()}


def subscribers(server: RunningServer) -> list[str]:
    return list(call(server.url, "/rosapi/subscribers", {"topic": TOPIC})["subscribers"])


def test_a_camera_is_a_tile_while_it_is_seen(page: OpenPage, server: RunningServer) -> None:
    page.open_panel("cameras")
    page.part("cameras-empty").wait_for()
    with connect(server.url) as camera:
        camera.send(json.dumps({"op": "advertise", "topic": TOPIC, "type": TYPE}))
        page.wait(lambda: TOPIC in call(server.url, "/rosapi/topics_for_type", {"type": TYPE})["topics"])
        page.part("cameras-look").click()
        tile = page.part(f"camera-{TOPIC}")
        tile.wait_for()

        def shows(width: int, kind: str) -> bool:
            camera.send(json.dumps({"op": "publish", "topic": TOPIC, "type": TYPE, "msg": picture(width, kind)}))
            return bool(tile.evaluate("img => img.naturalWidth") == width)

        page.wait(lambda: shows(60, "jpeg"))
        page.wait(lambda: shows(80, "png"))
        page.open_panel("log")
        # The next picture finds the tile out of sight.
        page.wait(lambda: [shows(20, "png")] and subscribers(server) == [])
