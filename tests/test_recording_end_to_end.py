"""``armbridge serve --record``, as it is started and ended; read by the MCAP project's own reader."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from tests.helpers.client import frame_client
from tests.helpers.server import RunningServer


def decoded(path: Path, topic: str) -> list[Any]:
    """The messages of a topic, as a foreign reader has them."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [one.decoded_message for one in reader.iter_decoded_messages(topics=[topic])]


@pytest.mark.real_time
async def test_a_goal_its_answer_and_the_motion_are_in_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with RunningServer(f"--port 0 --record {path}") as server:
        async with frame_client(server.url) as client:
            await client.open_goals()
            assert (await client.goal("/moveit_goal_named", {"data": "ready"}))["val"] == 1
        await asyncio.to_thread(server.end, signal.SIGTERM)
    assert [goal.data for goal in decoded(path, "/moveit_goal_named")] == ["ready"]
    assert [answer.val for answer in decoded(path, "/moveit_goal_result")] == [1]
    assert "<robot" in decoded(path, "/robot_description")[0].data
    states = decoded(path, "/joint_states")
    assert states[0].name[0] == "shoulder_pan"
    assert states[0].position != states[-1].position
