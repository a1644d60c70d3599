"""One server and its clients, from a client's frame to the servos and back."""

import asyncio
import itertools
import signal
from pathlib import Path
from typing import Any

import psutil
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from harness.clients import FrameClient, frame_client, goal_is
from harness.server import RunningServer, read_write_log
from harness.waiting import TIMEOUT_S, until
from server.errors import RecordingError
from server.gateway.http import HOW_TO_BUILD_PAGE, page_is_built
from server.installation import PAGE_DIRECTORY
from server.recording.reading import messages
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

ARGUMENTS = "--port 0 --record {folder}/run.mcap"
SETTINGS = {"ARMBRIDGE_EMULATOR__WRITE_LOG": "{folder}/writes.jsonl"}

# Backlash, droop and one tick of rounding.
ARRIVED_RAD = 0.06


async def test_the_unreal_client_moves_the_arm(server: RunningServer, folder: Path) -> None:
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
                await assert_arrived(client, folder, [0.3, -0.5, 0.5, 0.2, 0.0])
    assert_no_goal_jumped(folder)


def test_the_log_names_the_page_or_how_to_get_it(server: RunningServer) -> None:
    page = f"http://127.0.0.1:{server.port}/ (page)"
    assert server.has_logged(page if page_is_built(PAGE_DIRECTORY) else HOW_TO_BUILD_PAGE)


def writes(folder: Path) -> list[dict[str, Any]]:
    """The servos' log."""
    return read_write_log(folder / "writes.jsonl")


def goal_writes(folder: Path) -> list[dict[str, Any]]:
    return [entry for entry in writes(folder) if entry["address"] == 41]


async def assert_arrived(client: FrameClient, folder: Path, position_rad: list[float]) -> None:
    """The servos stand where the goal was, and /joint_states says what the servos say."""
    latest = await client.positions()
    present = writes(folder)[-1]["present"]
    for joint, goal_rad in zip(nominal_calibration().joints[:5], position_rad, strict=True):
        servo_rad = joint.rad_from_ticks(present[str(joint.servo_id)])
        assert servo_rad == pytest.approx(goal_rad, abs=ARRIVED_RAD)
        assert latest[joint.joint] == pytest.approx(servo_rad, abs=0.01)


def assert_no_goal_jumped(folder: Path) -> None:
    """Torque comes on at the goal, and no goal then moves faster than its joint may."""
    robot = so101()
    goals = goal_writes(folder)
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


def goal_ticks(entry: dict[str, Any], servo: str) -> int:
    low, high = entry["data"][servo][1:3]
    return int(low | high << 8)


async def test_stop_ends_the_motion_along_its_path_and_empties_the_queue(client: FrameClient) -> None:
    assert (await client.reach("/moveit_goal_named", {"data": "home"}))["val"] == 1
    seen = len(client.messages(RESULT))
    await client.set_speed(0.2)
    await client.publish("/moveit_goal_joints", {"name": ["shoulder_pan"], "position": [1.5]})
    for _ in range(3):
        await client.publish("/moveit_goal_named", {"data": "ready"})
    await client.until("/joint_states", lambda all_: all_[-1]["position"][0] > 0.2)
    await client.publish("/stop", {})
    await client.set_speed(1.0)
    results = (await client.until(RESULT, lambda all_: len(all_) == seen + 4))[seen:]
    assert [result["val"] for result in results] == [-7] * 4
    seen = len(client.messages("/joint_states"))
    at_rest = pytest.approx([0.0] * 6, abs=0.05)
    states = await client.until("/joint_states", lambda all_: len(all_) > seen and all_[-1]["velocity"] == at_rest)
    stopped = states[-1]
    assert 0.2 < stopped["position"][0] < 1.2
    assert stopped["position"][1:5] == pytest.approx([0.0] * 4, abs=ARRIVED_RAD)


async def ended(server: RunningServer, folder: Path, number: signal.Signals) -> tuple[int, list[dict[str, Any]]]:
    """End a server while its arm moves, with all its processes; returns its exit code and the results of the goals."""
    children = psutil.Process(server.process.pid).children(recursive=True)
    async with frame_client(server.url) as client:
        await client.open_goals()
        await client.reach("/moveit_goal_named", {"data": "ready"})
        await client.set_speed(0.2)
        await client.publish("/moveit_goal_joints", {"name": ["shoulder_pan"], "position": [1.5]})
        await client.until("/moveit_goal_status", goal_is("executing"))
        code, _ = await asyncio.to_thread(server.end, number)
        results = client.messages(RESULT)
    _, alive = psutil.wait_procs(children, timeout=TIMEOUT_S)
    assert not alive
    # The last goals of the shoulder pan stay where they are.
    pan = [goal_ticks(entry, "1") for entry in goal_writes(folder) if "1" in entry["data"]]
    assert max(abs(after - before) for before, after in itertools.pairwise(pan[-3:])) <= 2
    return code, results


def decoded(path: Path, topic: str) -> list[Any]:
    """The messages of a topic, as the MCAP project's own reader has them."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [one.decoded_message for one in reader.iter_decoded_messages(topics=[topic])]


def has_joint_states(recording: Path) -> bool:
    """Whether a recording, ended or not, has joint states."""
    try:
        return any(each.topic == "/joint_states" for each in messages(recording))
    except RecordingError:
        return False


async def test_a_signal_stops_the_moving_arm_and_all_is_in_the_recording(server: RunningServer, folder: Path) -> None:
    code, results = await ended(server, folder, signal.SIGINT)
    assert (code, [result["val"] for result in results]) == (0, [1, -7])
    assert_no_goal_jumped(folder)
    recording = folder / "run.mcap"
    assert decoded(recording, "/moveit_goal_named")[-1].data == "ready"
    assert [answer.val for answer in decoded(recording, RESULT)][-2:] == [1, -7]
    assert "<robot" in decoded(recording, "/robot_description")[0].data
    states = decoded(recording, "/joint_states")
    assert states[0].name[0] == "shoulder_pan"
    assert states[0].position != states[-1].position


async def test_a_killed_server_leaves_an_arm_at_rest_no_process_behind_and_its_recording(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    settings = {"ARMBRIDGE_EMULATOR__WRITE_LOG": str(tmp_path / "writes.jsonl")}
    with RunningServer(f"--port 0 --record {recording}", settings) as server:
        # Messages reach the file once a second: a quick start takes less, and on a busy machine what is latched
        # comes long before the first state.
        await until(lambda: has_joint_states(recording))
        await ended(server, tmp_path, signal.SIGKILL)
    assert has_joint_states(recording)
