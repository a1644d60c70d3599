"""Rendered images of a running server's arm, by the command ``armbridge camera physics``."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import ctypes.util
import io
import os
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest
from PIL import Image

from harness.clients import call, frame_client
from harness.server import ROOT, RunningServer
from robot.physics.camera import Camera
from server.commands.publish import RENDERED

TOPIC = "/camera/image/compressed"
VIEW = (0.6, -0.4, 0.4, 0.15, 0.0, 0.05)
RED = {"r": 1.0, "g": 0.0, "b": 0.0, "a": 1.0}
AT = (0.3, 0.15, 0.02)


@pytest.fixture(scope="module")
def server() -> Iterator[RunningServer]:
    with RunningServer("--port 0 --simulation physics") as running:
        yield running


def camera_command(url: str, *options: str) -> list[str]:
    return [sys.executable, str(ROOT / "armbridge.py"), "camera", RENDERED, "--connect", url, *options]


def projected(camera: Camera, point_m: tuple[float, float, float]) -> tuple[float, float]:
    """Column and row of a point in the image."""
    x, y, z = camera.axes.T @ np.subtract(point_m, camera.position_m)
    return camera.width / 2 - camera.focal_px * x / z, camera.height / 2 + camera.focal_px * y / z


@pytest.mark.skipif(ctypes.util.find_library("EGL") is None, reason="no EGL: images are not rendered here")
async def test_a_red_box_is_where_a_pinhole_camera_sees_it(server: RunningServer) -> None:
    position = dict(zip("xyz", AT, strict=True))
    box = {"id": "box", "primitives": [{"type": 1, "dimensions": [0.04] * 3}], "pose": {"position": position}}
    scene = {"is_diff": True, "world": {"collision_objects": [box]}, "object_colors": [{"id": "box", "color": RED}]}
    assert call(server.url, "/apply_planning_scene", {"scene": scene})["success"]
    async with frame_client(server.url) as client:
        await client.subscribe(TOPIC, "sensor_msgs/CompressedImage")
        view = ",".join(map(str, VIEW))
        process = await asyncio.create_subprocess_exec(*camera_command(server.url, "--view", view))
        try:
            await client.until(TOPIC, lambda images: len(images) > 1, 60.0)
        finally:
            with contextlib.suppress(ProcessLookupError):
                process.terminate()
            await process.wait()
        image = client.messages(TOPIC)[-1]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(image["data"])))).astype(int)
    assert pixels.shape == (240, 320, 3)
    rows, columns = np.nonzero((pixels[:, :, 0] > 60) & (pixels[:, :, 1] < 30) & (pixels[:, :, 2] < 30))
    camera = Camera("base_link", VIEW[:3], VIEW[3:], 320, 240)
    assert (columns.mean(), rows.mean()) == pytest.approx(projected(camera, AT), abs=3.0)
    assert image["header"]["stamp"]["sec"] > 0


def test_a_machine_without_opengl_gets_one_sentence(server: RunningServer) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    done = subprocess.run(
        camera_command(server.url),
        env={**environment, "MUJOCO_GL": "glfw"},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert "images need OpenGL off screen: EGL (Debian: libegl1), or OSMesa" in done.stderr


@pytest.mark.parametrize("view", ["1,2,3", "a,b,c,d,e,f", "1,2,3,4,5,nan"])
def test_a_view_is_six_numbers(view: str) -> None:
    done = subprocess.run(
        camera_command("ws://localhost:1", "--view", view), capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 2
    assert f"must be six numbers with commas, not {view!r}" in done.stderr
