"""From a running server with its arm, cameras and marked episodes to a dataset."""

import base64
import json
from pathlib import Path

import pytest

from harness.clients import arm_client
from harness.server import server_on_bus
from server.cli import main
from tests.helpers.rendering import needs_egl
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
