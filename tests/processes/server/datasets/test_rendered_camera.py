"""Rendered images of a running server's arm."""

from __future__ import annotations

import base64
import io
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from harness.clients import ArmClient, arm_client, call
from harness.server import RunningServer
from harness.waiting import until
from robot.description.camera import Camera
from server.datasets.camera import IMAGE_TYPE
from server.datasets.rendered import DEPTH_TYPE, INFO_TYPE
from tests.helpers.rendering import needs_egl, red_pixels

TOPIC, INFO, DEPTH = "/camera/image/compressed", "/camera/camera_info", "/camera/depth/image"
VIEW = (0.6, -0.4, 0.4, 0.15, 0.0, 0.05)
RED = {"r": 1.0, "g": 0.0, "b": 0.0, "a": 1.0}
AT = (0.3, 0.15, 0.02)

ARGUMENTS = "--port 0 --simulation physics"


def process_of_cameras(server: RunningServer) -> int | None:
    """Return the id of the process that renders a server's cameras."""
    pid = server.process.pid
    for child in map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split()):
        if b"rendering_process" in Path(f"/proc/{child}/cmdline").read_bytes():
            return child
    return None


async def of_one_image(client: ArmClient, *topics: str) -> list[dict[str, Any]]:
    """Return a message of each topic, all with the same header; a busy machine may drop some of them."""
    while True:
        for header in [each["header"] for each in client.messages(topics[0])]:
            found = [each for topic in topics for each in client.messages(topic) if each["header"] == header]
            if len(found) == len(topics):
                return found
        seen = len(client.messages(topics[0]))
        await client.until(topics[0], lambda all_, seen=seen: len(all_) > seen)


@needs_egl
async def test_the_arms_own_cameras_are_published_and_come_back_when_their_process_has_died(
    server: RunningServer,
) -> None:
    front, wrist = "/front/image/compressed", "/wrist/image/compressed"
    # The page asks for its tiles like this.
    assert {front, wrist} <= set(call(server.url, "/rosapi/topics_for_type", {"type": IMAGE_TYPE})["topics"])
    assert process_of_cameras(server) is None, "nobody watches"
    async with arm_client(server.url) as client:
        for topic in (front, wrist):
            await client.subscribe(topic, IMAGE_TYPE)
        await client.subscribe("/front/camera_info", INFO_TYPE)
        await client.until(wrist, bool)
        image, _ = await of_one_image(client, front, "/front/camera_info")
        assert image["header"]["frame_id"] == "front_optical_frame"
        died = process_of_cameras(server)
        assert died is not None
        os.kill(died, signal.SIGKILL)
        assert server.has_logged("the process of the cameras ended (SIGKILL); starting it again")
        before = len(client.messages(front))
        await client.until(front, lambda images: len(images) > before + 1)
        restarted = process_of_cameras(server)
        assert restarted not in (None, died)
        top = {"name": "top", "view": [0.2, 0.0, 0.6, 0.2, 0.0, 0.0], "width": 64, "height": 48}
        assert await client.call("/simulation/set_camera", **top)
        await client.subscribe("/top/image/compressed", IMAGE_TYPE)
        image = (await client.until("/top/image/compressed", bool))[0]
        assert Image.open(io.BytesIO(base64.b64decode(image["data"]))).size == (64, 48)
        assert process_of_cameras(server) == restarted


@needs_egl
async def test_a_red_box_is_where_the_info_of_the_camera_has_it(server: RunningServer) -> None:
    position = dict(zip("xyz", AT, strict=True))
    box = {"id": "box", "primitives": [{"type": 1, "dimensions": [0.04] * 3}], "pose": {"position": position}}
    scene = {"is_diff": True, "world": {"collision_objects": [box]}, "object_colors": [{"id": "box", "color": RED}]}
    assert call(server.url, "/apply_planning_scene", {"scene": scene})["success"]
    async with arm_client(server.url) as client:
        assert await client.call("/simulation/set_camera", name="camera", view=list(VIEW), depth=True)
        for topic, type_name in ((TOPIC, IMAGE_TYPE), (INFO, INFO_TYPE), (DEPTH, DEPTH_TYPE)):
            await client.subscribe(topic, type_name)
        depth, image, info = await of_one_image(client, DEPTH, TOPIC, INFO)
    assert image["header"]["stamp"]["sec"] > 0
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(image["data"]))))
    assert pixels.shape == (240, 320, 3)
    in_camera_m = np.linalg.inv(Camera(view=VIEW).transform_optical_to_frame) @ (*AT, 1.0)
    expected = (np.reshape(info["k"], (3, 3)) @ in_camera_m[:3] / in_camera_m[2])[:2]
    assert red_pixels(pixels).mean(axis=0) == pytest.approx(expected, abs=1.0)
    depth_mm = np.frombuffer(base64.b64decode(depth["data"]), "<u2").reshape(240, 320)
    column, row = expected.round().astype(int)
    assert depth_mm[row, column] == pytest.approx(1000 * in_camera_m[2], abs=30)


@needs_egl
async def test_a_server_that_ends_takes_its_cameras_along(server: RunningServer) -> None:
    async with arm_client(server.url) as client:
        await client.subscribe("/front/image/compressed", IMAGE_TYPE)
        await until(lambda: process_of_cameras(server) is not None)
        pid = process_of_cameras(server)
    server.end(signal.SIGTERM)
    await until(lambda: not Path(f"/proc/{pid}").exists())
