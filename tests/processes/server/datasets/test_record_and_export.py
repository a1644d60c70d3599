"""Recording of datasets, with cameras that are rendered, and their export."""

from __future__ import annotations

import base64
import io
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from harness.clients import arm_client, call
from harness.server import RunningServer, server_on_bus
from harness.waiting import until
from robot.description.camera import Camera
from server.cli import main
from server.datasets.camera import IMAGE_TYPE
from server.datasets.rendered import DEPTH_TYPE, INFO_TYPE
from tests.helpers.rendering import needs_egl, red_pixels
from tests.processes.server.teaching.test_end_to_end import REPLAY, REPLAY_TYPE, lead, ready
from tests.server.conftest import FAST
from tests.server.datasets.conftest import jpeg

parquet = pytest.importorskip("pyarrow.parquet", reason="the extra [datasets] is not installed: no pyarrow")
av = pytest.importorskip("av", reason="the extra [datasets] is not installed: no av")

STATES = 40
CAMERAS = {f"observation.images.{name}": f"/{name}/image/compressed" for name in ("front", "wrist")}


async def test_what_a_server_records_of_arm_camera_and_marks_becomes_a_dataset(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "data"
    with server_on_bus(f"--port 0 --record {recording}") as running:
        async with arm_client(running.server.url) as client:
            await client.until_mode("holding")
            await client.say("advertise", topic="/camera/image/compressed", type="sensor_msgs/CompressedImage")
            picture = base64.b64encode(jpeg(100)).decode()
            for episode in range(2):
                answer = await client.call("/dataset/start_episode", task="rest")
                assert answer == {"success": True, "message": f"episode {episode + 1} has begun"}
                # An image with every fifth state, so that a busy machine has none without the other.
                for _ in range(STATES // 5):
                    msg = {"format": "jpeg", "data": picture}
                    await client.say("publish", topic="/camera/image/compressed", msg=msg)
                    seen = len(client.topics.get("/joint_states", ()))
                    await client.until("/joint_states", lambda states, least=seen + 5: len(states) >= least)
                assert (await client.call("/dataset/stop_episode"))["success"]
            assert (await client.call("/dataset/discard_episode"))["success"]
    # A busy machine leaves gaps between the images.
    options = ["--fps", "10", "--max-gap", "10", "--units", "lerobot"]
    assert main(["export", str(recording), "--output", str(output), *options]) == 0
    done = capsys.readouterr().out
    assert "actions: /arm_controller/controller_state and /gripper_controller/controller_state" in done
    told = json.loads((output / "meta/info.json").read_text())
    assert told["total_episodes"] == 1
    assert told["robot_type"] == "so101"
    assert told["features"]["observation.state"]["names"][-1] == "gripper.pos"
    rows = parquet.read_table(output / "data/chunk-000/file-000.parquet").to_pylist()
    assert len(rows) == told["total_frames"] >= 2
    assert all(0.0 <= row["observation.state"][-1] <= 100.0 for row in rows)
    assert (output / "videos/observation.images.camera/chunk-000/file-000.mp4").stat().st_size > 0


@needs_egl
async def test_a_taught_motion_that_two_cameras_of_the_physics_see_becomes_a_dataset(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording, output = tmp_path / "run.mcap", tmp_path / "data"
    with server_on_bus(f"--port 0 --simulation physics --record {recording}", **FAST) as running:
        async with arm_client(running.server.url) as client:
            await client.until_mode("holding")
            assert (await client.call("/arm/relax"))["success"]
            await client.until_mode("relaxed")
            await lead(client, running, {"shoulder_pan": 0.0})
            assert (await client.call("/teach/begin", name="turn", group=""))["success"]
            await lead(client, running, {"shoulder_pan": 0.5})
            assert (await client.call("/teach/end"))["success"]
            await ready(client, running)
            for topic in CAMERAS.values():
                await client.say("subscribe", topic=topic, type="sensor_msgs/CompressedImage")
                await client.until(topic, bool)
            assert (await client.call("/dataset/start_episode", task="turn"))["success"]
            done = await client.result(await client.send_goal(REPLAY, REPLAY_TYPE, {"name": "turn", "speed": 1.0}))
            assert done["values"]["error_code"]["val"] == 1, done
            assert (await client.call("/dataset/stop_episode"))["success"]
    assert main(["export", str(recording), "--output", str(output), "--fps", "10", "--max-gap", "10"]) == 0
    assert f"{', '.join(CAMERAS)}; actions: " in capsys.readouterr().out
    told = json.loads((output / "meta/info.json").read_text())
    assert [told["features"][name]["shape"] for name in CAMERAS] == [[240, 320, 3]] * 2
    rows = parquet.read_table(output / "data/chunk-000/file-000.parquet").to_pylist()
    turned_rad = [row["observation.state"][0] for row in rows]
    assert (min(turned_rad), turned_rad[-1]) == pytest.approx((0.0, 0.5), abs=0.1)
    for name in CAMERAS:
        video = output / f"videos/{name}/chunk-000/file-000.mp4"
        with av.open(str(video)) as opened:
            first, *others = [frame.to_ndarray(format="rgb24").astype(int) for frame in opened.decode(video=0)]
        assert max(abs(first - each).max() for each in others) > 50, f"{name} shows no motion"


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
        image = (await client.until(front, bool))[0]
        assert image["header"]["frame_id"] == "front_optical_frame"
        infos = await client.until("/front/camera_info", bool)
        assert image["header"] in [each["header"] for each in infos]
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
        depth = (await client.until(DEPTH, bool))[0]
        image, info = (
            next(each for each in client.messages(topic) if each["header"] == depth["header"])
            for topic in (TOPIC, INFO)
        )
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
