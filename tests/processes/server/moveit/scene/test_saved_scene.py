"""The scene of a server that was ended or killed is there at its next start."""

import os
import signal
from pathlib import Path

import pytest

from harness.clients import arm_client
from harness.server import RunningServer
from harness.waiting import until
from tests.helpers.moveit import box, pose


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
async def test_a_killed_server_starts_with_its_scene_though_it_touches(tmp_path: Path, end: signal.Signals) -> None:
    settings = {"ARMBRIDGE_SCENE__FILE": str(tmp_path / "scene.json")}
    around = {"collision_objects": [box("around the arm", at=pose(z=0.1))]}
    scene = {"is_diff": True, "robot_state": {"is_diff": True}, "world": around}
    with RunningServer(settings=settings) as first:
        async with arm_client(first.url) as client:
            assert (await client.call("/apply_planning_scene", scene=scene))["success"]
        if end is signal.SIGKILL:
            await until((tmp_path / "scene.json").exists)
        first.end(end)
    with RunningServer(settings=settings) as second:
        assert second.has_logged("the planning scene is restored from")
        async with arm_client(second.url) as client:
            shown = (await client.call("/get_planning_scene"))["scene"]
        assert [each["id"] for each in shown["world"]["collision_objects"]] == ["around the arm"]


async def test_a_server_that_keeps_no_scene_writes_none(tmp_path: Path) -> None:
    settings = {"ARMBRIDGE_SCENE__FILE": str(tmp_path / "scene.json"), "ARMBRIDGE_SCENE__KEEP": "false"}
    scene = {"is_diff": True, "robot_state": {"is_diff": True}, "world": {"collision_objects": [box("wall")]}}
    with RunningServer(settings=settings) as server:
        async with arm_client(server.url) as client:
            assert (await client.call("/apply_planning_scene", scene=scene))["success"]
        server.end(signal.SIGTERM)
    assert os.listdir(tmp_path) == []  # noqa: PTH208
