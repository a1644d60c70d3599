"""The whole path, from a client's frame to the servos and back, on the command that ``make run`` starts."""

import asyncio
import http.client
import itertools
import signal
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest
import pytest_asyncio
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from harness.clients import FrameClient, frame_client, goal_is
from harness.server import RunningServer, read_write_log
from harness.waiting import TIMEOUT_S
from server.errors import RecordingError
from server.gateway.http import HOW_TO_BUILD_PAGE, page_is_built
from server.installation import PAGE_DIRECTORY
from server.recording.replay import RecordingFile
from tests.helpers.robots import nominal_calibration, so101

# What the Unreal client sends, to the letter.
SUBSCRIBE = '{"op":"subscribe","topic":"/joint_states","type":"sensor_msgs/JointState"}'
ADVERTISE = [
    '{"op":"advertise","topic":"/moveit_goal_named","type":"std_msgs/String"}',
    '{"op":"advertise","topic":"/moveit_goal_joints","type":"sensor_msgs/JointState"}',
    '{"op":"advertise","topic":"/moveit_goal_pose","type":"geometry_msgs/PoseStamped"}',
]
NAMED = '{"op":"publish","topic":"/moveit_goal_named","msg":{"data":"ready"}}'
JOINTS = (
    '{"op":"publish","topic":"/moveit_goal_joints","msg":{"header":{"stamp":{"sec":0,"nanosec":0},"frame_id":""},'
    '"name":["shoulder_pan","shoulder_lift","elbow_flex","wrist_flex","wrist_roll"],'
    '"position":[0.3,-0.5,0.5,0.2,0.0],"velocity":[],"effort":[]}}'
)
POSE = (
    '{"op":"publish","topic":"/moveit_goal_pose","msg":{"header":{"stamp":{"sec":0,"nanosec":0},'
    '"frame_id":"base_link"},"pose":{"position":{"x":0.3,"y":0.1,"z":0.2},'
    '"orientation":{"x":0.0,"y":0.0,"z":0.0,"w":1.0}}}}'
)
RESULT = "/moveit_goal_result"

# Backlash, droop and one tick of rounding.
ARRIVED_RAD = 0.06


@pytest.fixture(scope="module")
def write_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("emulator") / "writes.jsonl"


@pytest.fixture(scope="module")
def server(write_log: Path) -> Iterator[RunningServer]:
    with RunningServer(settings={"ARMBRIDGE_EMULATOR__WRITE_LOG": str(write_log)}) as running:
        yield running


@pytest.fixture
async def client(server: RunningServer) -> AsyncIterator[FrameClient]:
    async with frame_client(server.url) as connected:
        await connected.open_goals()
        yield connected


async def goal_named(client: FrameClient, name: str) -> dict[str, Any]:
    return await client.reach("/moveit_goal_named", {"data": name})


async def test_the_unreal_client_moves_the_arm(server: RunningServer, write_log: Path) -> None:
    async with frame_client(server.url) as client:
        await client.send(SUBSCRIBE)
        for frame in ADVERTISE:
            await client.send(frame)
        await client.subscribe(RESULT, "moveit_msgs/MoveItErrorCodes")
        for count, frame in enumerate((NAMED, JOINTS, POSE), start=1):
            await client.send(frame)
            results = await client.until(RESULT, lambda all_, count=count: len(all_) == count)
            assert (results[-1]["val"], results[-1]["message"]) == (1, "the arm is there")
            if frame is JOINTS:
                await assert_arrived(client, write_log, [0.3, -0.5, 0.5, 0.2, 0.0])
    assert_no_goal_jumped(write_log)


async def assert_arrived(client: FrameClient, write_log: Path, position_rad: list[float]) -> None:
    """The servos stand where the goal was, and /joint_states says what the servos say."""
    seen = len(client.messages("/joint_states"))
    states = await client.until("/joint_states", lambda all_: len(all_) > seen + 2)
    latest = dict(zip(states[-1]["name"], states[-1]["position"], strict=True))
    present = read_write_log(write_log)[-1]["present"]
    for joint, goal_rad in zip(nominal_calibration().joints[:5], position_rad, strict=True):
        servo_rad = joint.rad_from_ticks(present[str(joint.servo_id)])
        assert servo_rad == pytest.approx(goal_rad, abs=ARRIVED_RAD)
        assert latest[joint.joint] == pytest.approx(servo_rad, abs=0.01)


def assert_no_goal_jumped(write_log: Path) -> None:
    """Torque comes on at the goal, and no goal then moves faster than its joint may."""
    robot = so101()
    goals = [entry for entry in read_write_log(write_log) if entry["address"] == 41]
    for joint in nominal_calibration().joints:
        servo = str(joint.servo_id)
        writes = [entry for entry in goals if servo in entry["data"]]
        first = next(entry for entry in writes if entry["torque"][servo] == 1)
        assert abs(goal_ticks(first, servo) - first["present"][servo]) <= 30
        # One tick of 10 ms at the limit, half as much again for a late tick, and rounding.
        step_ticks = joint.ticks_s_from_rad_s(robot.joints[joint.joint].max_velocity) * 0.01
        for before, after in itertools.pairwise(writes):
            gap_s = after["t"] - before["t"]
            bound = step_ticks * max(1.5, gap_s / 0.01) + 2
            assert abs(goal_ticks(after, servo) - goal_ticks(before, servo)) <= bound


def assert_comes_to_rest(write_log: Path) -> None:
    """The last goals of the shoulder pan stay where they are."""
    goals = [entry for entry in read_write_log(write_log) if entry["address"] == 41]
    pan = [goal_ticks(entry, "1") for entry in goals if "1" in entry["data"]]
    assert max(abs(after - before) for before, after in itertools.pairwise(pan[-3:])) <= 2


def goal_ticks(entry: dict[str, Any], servo: str) -> int:
    low, high = entry["data"][servo][1:3]
    return int(low | high << 8)


async def test_stop_ends_the_motion_along_its_path_and_empties_the_queue(client: FrameClient) -> None:
    assert (await goal_named(client, "home"))["val"] == 1
    await client.send(SUBSCRIBE)
    seen = len(client.messages(RESULT))
    far = {"name": ["shoulder_pan"], "position": [1.5]}
    await client.publish("/moveit_goal_joints", far)
    for _ in range(3):
        await client.publish("/moveit_goal_named", {"data": "ready"})
    await client.until("/joint_states", lambda all_: all_[-1]["position"][0] > 0.2)
    await client.publish("/stop", {})
    results = (await client.until(RESULT, lambda all_: len(all_) == seen + 4))[seen:]
    assert [result["val"] for result in results] == [-7] * 4
    await asyncio.sleep(0.3)
    stopped = client.messages("/joint_states")[-1]
    assert 0.2 < stopped["position"][0] < 1.2
    assert stopped["velocity"] == pytest.approx([0.0] * 6, abs=0.05)
    assert stopped["position"][1:5] == pytest.approx([0.0] * 4, abs=ARRIVED_RAD)


def test_the_page_is_on_the_same_port_or_how_to_get_it(server: RunningServer) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=TIMEOUT_S)
    connection.request("GET", "/")
    response = connection.getresponse()
    text = response.read().decode()
    connection.close()
    if page_is_built(PAGE_DIRECTORY):
        assert (response.status, "<script" in text) == (200, True)
        assert server.has_logged(f"http://127.0.0.1:{server.port}/ (page)")
    else:
        assert (response.status, HOW_TO_BUILD_PAGE in text) == (404, True)
        assert server.has_logged(HOW_TO_BUILD_PAGE)
    assert not any("rejected" in line or "HTTP" in line for line in server.lines)


# A server that takes so long to end hangs.
HUNG_S = 30.0


@dataclass(frozen=True)
class Ended:
    """A server that a signal ended while its arm moved to its second goal, and which of its processes outlived it."""

    code: int
    seconds: float
    results: list[dict[str, Any]]
    alive: list[psutil.Process]
    write_log: Path
    recording: Path


@pytest_asyncio.fixture(
    scope="module", loop_scope="module", params=[signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"]
)
async def ended(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Ended:
    folder = tmp_path_factory.mktemp("ended")
    log, recording = folder / "writes.jsonl", folder / "run.mcap"
    with RunningServer(f"--port 0 --record {recording}", {"ARMBRIDGE_EMULATOR__WRITE_LOG": str(log)}) as server:
        children = psutil.Process(server.process.pid).children(recursive=True)
        async with frame_client(server.url) as client:
            await client.open_goals()
            await goal_named(client, "ready")
            await client.publish("/moveit_goal_joints", {"name": ["shoulder_pan"], "position": [1.5]})
            await client.until("/moveit_goal_status", goal_is("executing"))
            code, seconds = await asyncio.to_thread(server.end, request.param)
            results = client.messages(RESULT)
    _, alive = psutil.wait_procs(children, timeout=TIMEOUT_S)
    return Ended(code, seconds, results, alive, log, recording)


def test_a_signal_stops_the_moving_arm_and_ends_with_0(ended: Ended) -> None:
    assert [result["val"] for result in ended.results] == [1, -7]
    assert ended.code == 0
    # On a busy machine as well: the limits of what it waits for are tested with the parts, in time of their own.
    assert ended.seconds < HUNG_S
    assert not ended.alive
    assert_no_goal_jumped(ended.write_log)
    assert_comes_to_rest(ended.write_log)


def decoded(path: Path, topic: str) -> list[Any]:
    """The messages of a topic, as the MCAP project's own reader has them."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [one.decoded_message for one in reader.iter_decoded_messages(topics=[topic])]


def test_a_goal_its_answer_and_the_motion_are_in_the_recording(ended: Ended) -> None:
    assert [goal.data for goal in decoded(ended.recording, "/moveit_goal_named")] == ["ready"]
    assert [answer.val for answer in decoded(ended.recording, "/moveit_goal_result")] == [1, -7]
    assert "<robot" in decoded(ended.recording, "/robot_description")[0].data
    states = decoded(ended.recording, "/joint_states")
    assert states[0].name[0] == "shoulder_pan"
    assert states[0].position != states[-1].position


def has_joint_states(recording: Path) -> bool:
    """Whether a recording, ended or not, has joint states."""
    try:
        return "/joint_states" in {each.topic for each in RecordingFile(recording).summary().topics}
    except RecordingError:
        return False


async def test_a_killed_server_leaves_an_arm_at_rest_no_process_behind_and_its_recording(tmp_path: Path) -> None:
    log, recording = tmp_path / "writes.jsonl", tmp_path / "run.mcap"
    with RunningServer(f"--port 0 --record {recording}", {"ARMBRIDGE_EMULATOR__WRITE_LOG": str(log)}) as server:
        children = psutil.Process(server.process.pid).children(recursive=True)
        async with frame_client(server.url) as client:
            await client.open_goals()
            # Messages reach the file once a second: a quick start takes less, and on a busy machine what is latched
            # comes long before the first state.
            async with asyncio.timeout(TIMEOUT_S):
                while not has_joint_states(recording):
                    await asyncio.sleep(0.1)
            await client.publish("/moveit_goal_joints", {"name": ["shoulder_pan"], "position": [1.5]})
            await client.until("/moveit_goal_status", goal_is("executing"))
            await asyncio.to_thread(server.end, signal.SIGKILL)
    _, alive = psutil.wait_procs(children, timeout=TIMEOUT_S)
    assert not alive
    assert_comes_to_rest(log)
    assert has_joint_states(recording)


async def test_a_serial_port_that_does_not_exist_leaves_a_server_that_says_so() -> None:
    with RunningServer("--port 0 --serial /dev/does-not-exist") as server:
        assert server.has_logged("/dev/does-not-exist does not exist")
        async with frame_client(server.url) as client:
            await client.open_goals()
            result = await goal_named(client, "ready")
    assert result["val"] == -25
    assert "/dev/does-not-exist does not exist" in result["message"]
