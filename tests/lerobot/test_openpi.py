"""``armbridge-policy`` with a policy server that speaks openpi's documented protocol."""

import json
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import pytest

from armbridge_client import Arm
from armbridge_client.messages import ActionChunkAnswer
from harness.server import RunningServer, free_port
from harness.waiting import TIMEOUT_S, running, wait_until
from server.chunks.action_chunks import PAUSE_S
from tests.helpers.frame_proxy import Operation, frame_proxy
from tests.helpers.programs import run
from tests.helpers.resources import is_open
from tests.lerobot.test_robot import ANSWERS, BIN, OFFLINE, arm, camera, pytestmark, robot, server

__all__ = ["arm", "pytestmark", "server"]

STUB = Path(__file__).with_name("openpi_scenario.py")
# Folded at rest, the links nearly touch: measured positions are in contact at times.
UPRIGHT = dict.fromkeys(("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"), 0.0)


class Stub:
    """Server of a policy, and what it has received."""

    def __init__(self, port: int, lines: Path) -> None:
        self.url = f"ws://127.0.0.1:{port}"
        self._lines = lines

    @property
    def observations(self) -> list[dict[str, list[float] | str]]:
        return [json.loads(line) for line in self._lines.read_text().splitlines()]


@contextmanager
def policy_server(folder: Path, kind: str) -> Iterator[Stub]:
    port, lines = free_port(), folder / "observations"
    with lines.open("w") as out, running([BIN / "python", STUB, str(port), kind], cwd=folder, stdout=out) as process:
        stub = Stub(port, lines)
        wait_until(lambda: process.poll() is not None or is_open(port))
        yield stub


def followed(arm: Arm) -> Iterator[ActionChunkAnswer]:
    """Yield the answers to chunks that the arm follows; on a starved machine some come too late."""
    answers = arm.messages(ANSWERS, ActionChunkAnswer, length=100, timeout_s=240)
    return (answer for answer in answers if answer.error_code.val == 1)


def options(stub: Stub, server: RunningServer, *more: str, with_camera: bool = False) -> list[str | Path]:
    robot_options = robot(server.port, with_camera=with_camera)
    return [BIN / "armbridge-policy", *robot_options, f"--openpi.url={stub.url}", "--openpi.radians=true", *more]


@contextmanager
def logged_policy(folder: Path, server: RunningServer) -> Iterator[tuple[Stub, Path]]:
    """A policy that moves the arm, its server, and the file of its log."""
    log = folder / "policy.log"
    with (
        policy_server(folder, "ramp") as stub,
        log.open("w") as out,
        running(options(stub, server, "--fps=30"), env=OFFLINE, cwd=folder, stderr=out),
    ):
        yield stub, log


def ended(stub: Stub, server: RunningServer, folder: Path, *more: str) -> str:
    """Run a policy to its end, and return its last line."""
    done = run(*options(stub, server, *more), timeout_s=240, env=OFFLINE, cwd=folder)
    assert done.returncode != 0
    return done.stderr.strip().splitlines()[-1]


def test_chunks_of_an_openpi_server_move_the_arm_and_its_observations_are_as_asked(
    server: RunningServer, arm: Arm, tmp_path: Path
) -> None:
    arm.move_joints(UPRIGHT)
    arm.release_control()
    begins_rad = arm.state().position_rad["shoulder_pan"]
    more = "--task=pick", "--fps=30", "--openpi.image_keys={front: observation/image}", "--openpi.image_size=64"
    with (
        camera(server.port),
        policy_server(tmp_path, "ramp") as stub,
        running(options(stub, server, *more, with_camera=True), env=OFFLINE, cwd=tmp_path) as client,
    ):
        assert len(list(islice(followed(arm), 6))) == 6
        arm.stop()
        assert client.wait(TIMEOUT_S) != 0
        ended_s = time.monotonic()
        first, last = stub.observations[0], stub.observations[-1]
    assert sorted(first) == ["observation/image", "observation/state", "prompt"]
    assert first["prompt"] == "pick"
    assert first["observation/image"] == ["|u1", 64, 64, 3]
    assert first["observation/state"][0] == pytest.approx(begins_rad, abs=0.02)
    # Each chunk goes on from where the arm was observed.
    assert last["observation/state"][0] > begins_rad + 0.05
    # The next test's chunks are refused until the policy that was stopped has been silent.
    wait_until(lambda: time.monotonic() - ended_s > PAUSE_S, 2.0 * PAUSE_S)


def test_the_state_is_split_into_keys_in_the_robots_units(server: RunningServer, arm: Arm, tmp_path: Path) -> None:
    arm.release_control()
    body = "shoulder_pan, shoulder_lift, elbow_flex, wrist_flex, wrist_roll"
    keys = f"--openpi.state_keys={{observation/joint_position: [{body}], observation/gripper_position: [gripper]}}"
    with policy_server(tmp_path, "dies") as stub:
        last = ended(stub, server, tmp_path, keys, "--openpi.radians=false")
        first = stub.observations[0]
    pan_rad = arm.state().position_rad["shoulder_pan"]
    assert sorted(first) == ["observation/gripper_position", "observation/joint_position", "prompt"]
    assert first["observation/joint_position"][0] == pytest.approx(math.degrees(pan_rad), abs=3.0)
    assert 0.0 <= first["observation/gripper_position"][0] <= 100.0
    # The server has died in the middle of a chunk: the arm brakes to its last target.
    assert f"the policy ends: openpi.url: {stub.url}" in last


def test_a_first_action_far_away_is_reached_by_a_planned_motion(
    server: RunningServer, arm: Arm, tmp_path: Path
) -> None:
    arm.move_joints(UPRIGHT)
    arm.release_control()
    with (
        policy_server(tmp_path, "far") as stub,
        running(options(stub, server), env=OFFLINE, cwd=tmp_path),
    ):
        assert next(followed(arm))
        assert arm.state().position_rad["shoulder_pan"] == pytest.approx(0.9, abs=0.05)


def test_a_stop_while_a_chunk_is_computed_or_on_its_way_ends_the_policy_though_no_chunk_came_for_long(
    server: RunningServer, arm: Arm, tmp_path: Path
) -> None:
    arm.move_joints(UPRIGHT)
    arm.release_control()
    position_rad = arm.state().position_rad

    def stop(operation: Operation) -> None:
        if operation["op"] == "publish" and operation["topic"] == "/arm/chunks":
            arm.stop()

    with policy_server(tmp_path, "ramp") as stub, frame_proxy(server.port, stop) as port:
        command = [BIN / "armbridge-policy", *robot(port, with_camera=False), f"--openpi.url={stub.url}"]
        done = run(*command, "--openpi.radians=true", timeout_s=240, env=OFFLINE, cwd=tmp_path)
    assert "the policy ends: the arm was stopped" in done.stderr
    assert len(stub.observations) == 1
    assert arm.state().position_rad == pytest.approx(position_rad, abs=0.02)


def test_a_stop_while_another_client_has_the_control_ends_the_policy(
    server: RunningServer, arm: Arm, tmp_path: Path
) -> None:
    arm.move_joints(UPRIGHT)
    position_rad = arm.state().position_rad
    with logged_policy(tmp_path, server) as (_, log):
        wait_until(lambda: "the policy waits: " in log.read_text())
        arm.stop()
        arm.release_control()
        wait_until(lambda: "the policy ends: the arm was stopped" in log.read_text())
    assert arm.state().position_rad == pytest.approx(position_rad, abs=0.02)


def test_a_stop_just_after_a_policy_is_resumed_ends_it(server: RunningServer, arm: Arm, tmp_path: Path) -> None:
    arm.move_joints(UPRIGHT)
    arm.release_control()
    with logged_policy(tmp_path, server) as (stub, log):
        assert next(followed(arm))
        assert arm.chunks().pause() == "the policy is paused"
        wait_until(lambda: "the policy waits: " in log.read_text())
        # Until its next chunk belongs to no stream that the stop has ended.
        paused_s, seen = time.monotonic(), len(stub.observations)
        wait_until(lambda: time.monotonic() - paused_s > PAUSE_S, 2.0 * PAUSE_S)
        assert arm.chunks().resume() == "the next chunk is followed"
        arm.stop()
        wait_until(lambda: "the policy ends: the arm was stopped" in log.read_text())
        # It looks once more, and its chunk is refused.
        assert len(stub.observations) <= seen + 1


def test_a_person_pauses_the_policy_steers_and_gives_back(server: RunningServer, arm: Arm, tmp_path: Path) -> None:
    arm.move_joints(UPRIGHT)
    arm.release_control()
    with logged_policy(tmp_path, server) as (stub, log):
        assert next(followed(arm))
        # The policy's client has control; whoever sees the arm may pause it.
        assert arm.chunks().pause() == "the policy is paused"
        with arm.jog() as jog:
            begins_rad = arm.state().position_rad["shoulder_pan"]
            wait_until(lambda: jog.joints({"shoulder_pan": -0.4}) and pan_rad(arm) < begins_rad - 0.1)
        stands_rad = pan_rad(arm)
        wait_until(lambda: "the policy waits: " in log.read_text())
        seen = len(stub.observations)
        assert arm.chunks().resume() == "the next chunk is followed"
        wait_until(lambda: pan_rad(arm) > stands_rad + 0.1)
        # The policy did not look while the person steered, and goes on from where the person left the arm.
        assert stub.observations[seen]["observation/state"][0] == pytest.approx(stands_rad, abs=0.05)
        arm.chunks().stop()
    assert "the policy goes on" in log.read_text()


def pan_rad(arm: Arm) -> float:
    return arm.state().position_rad["shoulder_pan"]


@pytest.mark.parametrize(
    ("kind", "more", "sentence"),
    [
        ("trace", (), "the policy failed on its server: KeyError: 'observation/state'"),
        ("narrow", (), "actions: must have the shape (n, 6), for shoulder_pan, "),
        ("nan", (), "actions: must be finite numbers"),
        ("syntax", (), "cannot be read: '(' was never closed"),
        ("objects", (), "cannot be read: an array has the type '|O', which is no number"),
        ("cut", (), "cannot be read: "),
        ("no map", (), "must answer with a map, not list"),
        ("ramp", ("--openpi.actions_key=action",), "openpi.actions_key: the answer has no 'action', but ['actions'"),
        ("ramp", ("--openpi.state_keys={state: [hand]}",), "openpi.state_keys: state has hand, not one of "),
        ("ramp", ("--openpi.url=ws://127.0.0.1:9",), "openpi.url: no policy server answers at ws://127.0.0.1:9"),
        ("ramp", ("--policy=somewhere",), "must be given, not policy and openpi.url"),
        ("ramp", ("--actions_per_chunk=501",), "actions_per_chunk must be 1 to 500, not 501"),
    ],
)
def test_a_bad_answer_or_option_ends_the_policy_with_a_sentence_and_nothing_moves(
    server: RunningServer, arm: Arm, tmp_path: Path, kind: str, more: tuple[str, ...], sentence: str
) -> None:
    arm.move_joints(UPRIGHT)
    arm.release_control()
    before = arm.state().position_rad
    with policy_server(tmp_path, kind) as stub:
        assert sentence in ended(stub, server, tmp_path, *more)
    assert arm.state().position_rad == pytest.approx(before, abs=0.01)
