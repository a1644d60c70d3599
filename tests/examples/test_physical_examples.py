"""Examples whose arm touches things, on a server with physics: what they say of these is so."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet
import pytest
from websockets.sync.client import connect

from harness.clients import call_on
from harness.server import CLIENT_ENVIRONMENT, FAST, RunningServer
from harness.waiting import TIMEOUT_S
from server import cli
from tests.examples.conftest import EXAMPLE_TIMEOUT_S, EXAMPLES, RunExample
from tests.helpers.programs import run


@pytest.fixture(scope="module")
def with_physics() -> Iterator[RunningServer]:
    with RunningServer("--port 0 --simulation physics", FAST) as running:
        yield running


@pytest.fixture
def physical(with_physics: RunningServer) -> RunningServer:
    """The server with physics, without the objects of the test before."""
    with connect(with_physics.url) as other:
        removed = {"is_diff": True, "world": {"collision_objects": [{"operation": 1}]}}
        assert call_on(other, "/apply_planning_scene", {"scene": removed})["success"]
    return with_physics


@pytest.mark.parametrize(
    ("name", "told"),
    [
        (
            "pick_and_place.py",
            r"by the physics the block is (7\d|8\d|9\d|100) mm above the floor\n"
            r"the block stands at x 0\.1\d, y -0\.1\d m, (-1|0|1) mm above the floor\n",
        ),
        (
            "stack_three.py",
            "the middle cube is put down\nthe top cube is put down\nthe stack of three stands\n",
        ),
        (
            "push_a_block.py",
            r"(the block is \d+\.\d mm from the mark\n)*the block is [0-2]\.\d mm from the mark\n",
        ),
    ],
)
def test_an_example_moves_what_it_touches(
    name: str, told: str, run_example: RunExample, physical: RunningServer
) -> None:
    done = run_example(name, "--url", physical.url)
    assert done.returncode == 0, done.stderr
    assert re.fullmatch(told, done.stdout)


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        (
            "import stack_three as it; it.put = lambda *_: None",
            "the stack fell: the middle cube is 0 mm above the floor\n",
        ),
        (
            "import pick_and_place as it; it.CLOSED_RAD = it.OPEN_RAD",
            "the fingers did not lift the block\n",
        ),
    ],
)
def test_an_example_that_fails_by_the_physics_ends_with_1(fault: str, told: str, physical: RunningServer) -> None:
    command = [sys.executable, "-c", f"{fault}; it.main()", "--url", physical.url]
    done = run(*command, cwd=EXAMPLES, env=CLIENT_ENVIRONMENT, timeout_s=EXAMPLE_TIMEOUT_S)
    assert (done.returncode, done.stderr) == (1, told)


def test_a_taught_push_becomes_episodes(run_example: RunExample, tmp_path: Path) -> None:
    with RunningServer(f"--port 0 --simulation physics --record {tmp_path / 'run.mcap'}", FAST) as recorded:
        # On a busy machine the first answer takes longer than the example waits, and an image longer than an episode.
        with connect(recorded.url, max_size=None) as other:
            assert call_on(other, "/teach/list")["names"] == []
            for topic in ("/front/image/compressed", "/wrist/image/compressed"):
                other.send(json.dumps({"op": "subscribe", "topic": topic, "type": "sensor_msgs/CompressedImage"}))
                while json.loads(other.recv(timeout=TIMEOUT_S)).get("topic") != topic:
                    pass
        done = run_example("record_episodes.py", "--url", recorded.url)
    assert done.returncode == 0, done.stderr
    taught, *episodes = done.stdout.splitlines()
    assert "it touches nothing" in taught
    assert len(episodes) == 6
    assert all(re.fullmatch(r"the block stands at x 0\.(19|20), y -0\.08 m", each) for each in episodes[1::2])
    export = ["export", str(tmp_path / "run.mcap"), "--output", str(tmp_path / "pushes"), "--fps", "15"]
    # A busy machine renders fewer images.
    assert cli.main([*export, "--max-gap", "60"]) == 0
    frames = pyarrow.parquet.read_table(tmp_path / "pushes" / "data" / "chunk-000" / "file-000.parquet")
    assert set(frames["episode_index"].to_pylist()) == {0, 1, 2}
    videos = {each.parts[-3] for each in (tmp_path / "pushes" / "videos").rglob("*.mp4")}
    assert videos == {"observation.images.front", "observation.images.wrist"}
