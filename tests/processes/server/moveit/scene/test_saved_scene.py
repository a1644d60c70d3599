"""The scene of a server that was ended or killed is there at its next start."""

import signal
from pathlib import Path

from harness.clients import arm_client
from harness.server import RunningServer
from harness.waiting import until
from tests.helpers.moveit import box, pose


async def objects_of(server: RunningServer) -> list[str]:
    async with arm_client(server.url) as client:
        shown = (await client.call("/get_planning_scene"))["scene"]["world"]["collision_objects"]
    return [each["id"] for each in shown]


async def test_a_server_starts_with_the_scene_of_the_one_before_which_was_killed_or_ended(tmp_path: Path) -> None:
    file = tmp_path / "scene.json"
    settings = {"ARMBRIDGE_SCENE__FILE": str(file)}
    with RunningServer(settings=settings) as first:
        async with arm_client(first.url) as client:
            # It touches the arm.
            await client.change_scene(box("around the arm", at=pose(z=0.1)))
        await until(file.exists)
        first.end(signal.SIGKILL)
    # The port of a server that was killed is free at once.
    with RunningServer(f"--port {first.port}", settings) as second:
        assert second.has_logged("the planning scene is restored from")
        assert await objects_of(second) == ["around the arm"]
        async with arm_client(second.url) as client:
            await client.change_scene(box("wall", at=pose(x=0.5)))
        second.end(signal.SIGTERM)
    kept = file.read_text()
    assert '"wall"' in kept
    with RunningServer(settings=settings | {"ARMBRIDGE_SCENE__KEEP": "false"}) as third:
        assert await objects_of(third) == []
        async with arm_client(third.url) as client:
            await client.change_scene(box("crate", at=pose(x=0.5)))
        third.end(signal.SIGTERM)
    assert file.read_text() == kept
