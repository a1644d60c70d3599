"""The log ring and the files that are written after a fault."""

import asyncio
import json
import logging
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from harness.clients import arm_client, values_of
from harness.server import ServerOnBus, server_on_bus
from robot import logs
from robot.faults import Fault, FaultCode, ServoAlert, ServoWarning
from robot.logs import MAX_LINE_CHARACTERS, LogLine
from robot.messages import ArmState, Mode
from server.graph.topics import Graph
from server.monitoring.fault_files import LEAST_INTERVAL_S, MAX_STATES, FaultFiles
from server.monitoring.log_ring import MAX_CHARACTERS, MAX_LINES, SERVICE, LogRing, shown
from tests.helpers.graph import answered
from tests.helpers.messages import REGISTRY
from tests.server.monitoring.watched_parts import JOINTS, arm_health

LOG = logging.getLogger("armbridge.test")


@pytest.fixture
def ring() -> Iterator[LogRing]:
    made = LogRing()
    yield made
    made.close()


def line(text: str, at_s: float = 0.0) -> LogLine:
    return LogLine(at_s, logging.INFO, "armbridge.arm", "robot.control.loop", text, at_s)


def texts(ring: LogRing) -> list[str]:
    return [each.text for each in ring.since(0.0)]


def test_lines_of_the_server_and_of_its_children_are_kept_as_they_come(ring: LogRing) -> None:
    LOG.warning("too %s", "hot")
    logs.pass_on(line("the arm holds"))
    assert texts(ring) == ["too hot", "the arm holds"]
    assert [each.process for each in ring.since(0.0)] == ["server", "robot.control.loop"]
    ring.close()
    LOG.warning("too late")
    logs.pass_on(line("too late"))
    assert texts(ring) == ["too hot", "the arm holds"]


def test_a_token_is_not_kept(ring: LogRing) -> None:
    LOG.warning("refused: %s", "/?token=s3cret")
    try:
        int("ws://host/?token=s3cret")
    except ValueError:
        LOG.exception("a bug")
    assert "s3cret" not in "".join(texts(ring))
    assert "ws://host/?token=***" in texts(ring)[1]


def test_lines_without_end_and_long_ones_do_not_fill_the_memory(ring: LogRing) -> None:
    for number in range(MAX_LINES + 10):
        ring.take(line(str(number)))
    assert (len(texts(ring)), texts(ring)[0]) == (MAX_LINES, "10")
    LOG.warning("x" * 10 * MAX_LINE_CHARACTERS)
    assert len(texts(ring)[-1]) == MAX_LINE_CHARACTERS
    for _ in range(MAX_LINES):
        ring.take(line("x" * MAX_LINE_CHARACTERS))
    assert MAX_CHARACTERS - MAX_LINE_CHARACTERS < sum(map(len, texts(ring))) <= MAX_CHARACTERS


def test_a_burst_does_not_push_everything_else_out(ring: LogRing) -> None:
    LOG.warning("before the burst")
    for number in range(2 * MAX_LINES):
        LOG.warning("%d", number)
    assert texts(ring)[0] == "before the burst"


async def test_the_service_tells_the_lines_with_time_level_and_process(ring: LogRing) -> None:
    graph = Graph(REGISTRY)
    ring.offer(graph)
    ring.take(line("the arm holds", 1.5))
    told = "1970-01-01T00:00:01.500+00:00 INFO    robot.control.loop armbridge.arm: the arm holds"
    assert answered(graph, SERVICE).values == {"success": True, "message": told}
    assert shown(line("the arm holds", 1.5)) == told


START_S = 1_000_000.0
STALLED = Fault(FaultCode.STALLED, "joint gripper is stalled", "gripper", START_S)
HOT = Fault(FaultCode.OVERHEATED, "joint gripper is at 66 degC", "gripper", START_S)


def state(at_s: float = 0.0, value: float = 0.0, **fields: Any) -> ArmState:
    """A state some time after the start, all of whose figures are one."""
    arrays = dict.fromkeys(("position_rad", "goal_rad", "load", "current_a"), np.full(len(JOINTS), value))
    stamps = {"stamp_s": START_S + at_s, "clock_s": at_s}
    return ArmState(**{**stamps, "mode": Mode.HOLDING, "joint_names": JOINTS, **arrays, **fields})


class World:
    """Files about faults in a folder, and a clock that stands until a test moves it."""

    def __init__(self, folder: Path, ring: LogRing, keep: int = 20) -> None:
        self.now_s = 0.0
        self.folder = folder / "faults"
        self.files = FaultFiles(self.folder, keep, ring, "so101", lambda: self.now_s)

    async def latch(self, at_s: float = 0.0, fault: Fault | None = STALLED, **fields: Any) -> None:
        self.files.take_state(state(at_s, mode=Mode.FAULT, fault=fault, **fields))
        await self.files.close()

    async def latch_often(self, count: int, interval_s: float) -> None:
        for number in range(count):
            self.now_s += interval_s
            await self.latch(at_s=number, fault=replace(STALLED, stamp_s=float(number)))
            self.files.take_state(state(number + 0.5))

    def names(self) -> list[str]:
        return sorted(path.name for path in self.folder.glob("*.jsonl"))

    def lines(self, kind: str) -> list[dict[str, Any]]:
        assert self.files.latest is not None
        lines = [json.loads(line) for line in self.files.latest.read_text().splitlines()]
        return [line for line in lines if line["kind"] == kind]


@pytest.fixture
async def world(tmp_path: Path, ring: LogRing) -> World:
    return World(tmp_path, ring)


async def test_a_fault_leaves_a_file_by_time_and_code_with_its_remedy_the_log_and_the_servos_before_it(
    world: World, ring: LogRing
) -> None:
    world.files.take_state(state())
    LOG.warning("the gripper is warm")
    health = arm_health()
    warm = replace(health.joints[0], warnings=(ServoWarning(ServoAlert.WARM, "warm: 56 degC"),))
    world.files.take_health(replace(health, joints=(warm, *health.joints[1:])))
    world.now_s = ring.since(0.0)[-1].monotonic_s
    await world.latch()
    assert world.names() == ["fault-19700112T134640.000000Z-stalled.jsonl"]
    (head,) = world.lines("fault")
    assert (head["code"], head["joint"], head["remedy"]) == ("stalled", "gripper", STALLED.remedy)
    assert head["joints"] == list(JOINTS)
    assert [line["text"] for line in world.lines("log")] == ["the gripper is warm"]
    assert [[joint["joint"] for joint in line["joints"]] for line in world.lines("health")] == [list(JOINTS)]
    assert world.lines("health")[0]["joints"][0]["warnings"] == [["warm", "warm: 56 degC", ""]]


async def test_the_file_has_the_last_minute_of_the_log(world: World, ring: LogRing) -> None:
    for at_s in (29.0, 30.0, 90.0):
        logs.pass_on(line(f"{at_s:g}", at_s))
    world.now_s = 90.0
    await world.latch()
    assert [(each["text"], each["time_s"]) for each in world.lines("log")] == [("30", -60.0), ("90", 0.0)]


# Many more states than a file has, and few; that the wall clock is set for the last second changes nothing.
@pytest.mark.parametrize(("rate_hz", "jump_s"), [(50, 0.0), (1, 0.0), (1, 6.3e8), (1, -6.3e8)])
async def test_the_file_has_the_last_states_of_the_minute(world: World, rate_hz: int, jump_s: float) -> None:
    for number in range(90 * rate_hz):
        at_s = number / rate_hz
        world.files.take_state(state(at_s, number, stamp_s=START_S + at_s + jump_s * (at_s >= 89.0)))
    await world.latch(90.0, stamp_s=START_S + jump_s + 90.0)
    states, count = world.lines("state"), min(MAX_STATES, 60 * rate_hz + 1)
    assert [each["time_s"] for each in states] == pytest.approx(np.arange(1 - count, 1) / rate_hz, abs=0.001)
    for name in ("position_rad", "goal_rad", "load", "current_a"):
        assert states[-2][name] == [90.0 * rate_hz - 1.0] * 2


async def test_states_of_an_earlier_arm_process_are_left_out_and_figures_that_are_not_measured_null(
    world: World,
) -> None:
    world.files.take_state(state(at_s=1000.0))
    world.files.take_state(state(current_a=np.array([np.nan, 0.5]), goal_rad=None))
    await world.latch(at_s=0.1)
    states = world.lines("state")
    assert [each["time_s"] for each in states] == [-0.1, 0.0]
    assert (states[0]["current_a"], states[0]["goal_rad"]) == ([None, 0.5], [None, None])


async def test_one_fault_leaves_one_file_and_the_next_one_another(world: World) -> None:
    for at_s, fault in ((0.0, STALLED), (1.0, STALLED), (2.0, HOT)):
        world.now_s += LEAST_INTERVAL_S
        await world.latch(at_s, fault)
    assert [name.rpartition("-")[2] for name in world.names()] == ["stalled.jsonl", "overheated.jsonl"]


async def test_faults_without_end_do_not_wear_the_disk_out(world: World) -> None:
    await world.latch_often(100, LEAST_INTERVAL_S / 20.0)
    assert 1 < len(world.names()) <= 5


async def test_the_oldest_files_make_room(tmp_path: Path, ring: LogRing) -> None:
    world = World(tmp_path, ring, keep=3)
    await world.latch_often(5, LEAST_INTERVAL_S)
    assert [name[19:21] for name in world.names()] == ["42", "43", "44"]


async def test_a_lost_arm_leaves_a_file_and_one_that_was_never_there_none(world: World) -> None:
    lost = ArmState(START_S, Mode.DISCONNECTED, JOINTS, reason="the port is gone")
    for states, names in (((lost, lost), 0), ((state(), lost), 1)):
        for each in states:
            world.files.take_state(each)
        await world.files.close()
        assert len(world.names()) == names
    assert world.lines("fault")[0]["message"] == "the port is gone"


async def test_files_can_be_switched_off(tmp_path: Path, ring: LogRing) -> None:
    world = World(tmp_path, ring, keep=0)
    await world.latch()
    assert (world.files.latest, world.folder.exists()) == (None, False)


async def test_an_unwritable_directory_is_told_and_nothing_else(world: World, caplog: pytest.LogCaptureFixture) -> None:
    world.folder.write_text("a file")
    await world.latch()
    assert "cannot be written" in caplog.text
    assert world.files.latest is None


@pytest.fixture
def own_server() -> Iterator[ServerOnBus]:
    """A server without a fault before: a shared one may have written its file before it had a health to keep."""
    with server_on_bus() as running:
        yield running


async def test_a_running_server_names_the_file_in_its_log_and_diagnostics(own_server: ServerOnBus) -> None:
    async with arm_client(own_server.server.url) as client:
        # The health comes once a second; a server that has just begun has none to keep.
        await client.until("/diagnostics", lambda arrays: len(arrays[-1]["status"]) > 1)
        await client.call("/arm/emergency_stop")
        arrays = await client.until("/diagnostics", lambda arrays: "fault_file" in values_of(arrays[-1]["status"][0]))
    path = Path(values_of(arrays[-1]["status"][0])["fault_file"])
    assert own_server.server.has_logged(str(path))
    text = await asyncio.to_thread(path.read_text)
    kinds = [json.loads(line)["kind"] for line in text.splitlines()]
    assert (kinds[0], set(kinds)) == ("fault", {"fault", "health", "log", "state"})
