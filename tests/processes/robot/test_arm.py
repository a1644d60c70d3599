"""The server's handle on an arm process that is killed, hangs, starves, is started again or ends."""

import asyncio
import errno
import itertools
import signal
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from harness.server import read_write_log
from harness.waiting import TIMEOUT_S, until
from robot.arm import HEARTBEAT_S, RESTART_LINES, start_arm_process
from robot.control.supervisor import SIMULATED_WATCHDOG_S
from robot.faults import FaultCode
from robot.messages import (
    ArmState,
    ChangePace,
    EndState,
    Mode,
    MotionEnded,
    Order,
    Outcome,
    Pace,
    PauseSimulation,
)
from robot.processes import RestartDelay, StartedChild
from robot.stop_epochs import STOP_EPOCHS
from tests.helpers.arm_on_servos import ArmOnServos, to
from tests.helpers.arm_rig import CALIBRATION
from tests.helpers.resources import no_descriptors_left, runs


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[ArmOnServos]:
    made = ArmOnServos(tmp_path)
    await made.start()
    yield made
    await made.arm.close()


@pytest.fixture
async def restarted(tmp_path: Path) -> AsyncIterator[ArmOnServos]:
    """An arm whose process is started again almost at once."""
    made = ArmOnServos(tmp_path, RestartDelay(0.01, 0.02))
    await made.arm.start(TIMEOUT_S)
    yield made
    await made.arm.close()


async def replaced(rig: ArmOnServos) -> None:
    """Kill the process, and wait until another has taken its place."""
    killed = rig.arm.pid
    rig.kill()
    await until(lambda: rig.arm.pid != killed and rig.arm.state.mode is Mode.HOLDING)


async def begin_to_move(rig: ArmOnServos) -> asyncio.Future[MotionEnded]:
    """Begin a motion that never ends: the arm's time stands still on the way, however late the test looks."""
    motion = rig.arm.execute(to(1.0, duration_s=2.0))
    rig.arm.simulate(PauseSimulation(paused=True, ticks=80))
    await until(lambda: rig.pan_rad > 0.2)
    return motion


def be_patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take no silence of the arm process for a hang: a starved one may be silent for any time."""
    monkeypatch.setattr("robot.arm.SILENT_S", TIMEOUT_S)
    monkeypatch.setattr("robot.arm.SILENT_HEARTBEATS", round(TIMEOUT_S / HEARTBEAT_S))


@pytest.mark.parametrize("when", ["before", "unseen", "after"])
async def test_a_process_in_place_of_another_knows_the_last_stop(rig: ArmOnServos, when: str) -> None:
    before = STOP_EPOCHS.present
    assert not rig.arm.state.stopped
    if when == "unseen":
        rig.kill(signal.SIGSTOP)
    if when != "after":
        rig.arm.stop()
    if when == "before":
        await until(lambda: rig.arm.state.stopped)
    killed = rig.arm.pid
    rig.kill()
    if when == "after":
        await until(lambda: rig.arm.state.mode is Mode.DISCONNECTED)
        rig.arm.stop()
    await until(lambda: rig.arm.pid != killed and rig.arm.state.mode is Mode.HOLDING)
    assert rig.arm.state.stopped
    # Past the check of the handle itself.
    rig.arm.last_stop = 0
    assert (await asyncio.wait_for(rig.arm.execute(to(0.3), epoch=before), TIMEOUT_S)).outcome is Outcome.STOPPED


async def test_an_order_is_answered_when_the_process_dies(rig: ArmOnServos) -> None:
    rig.kill(signal.SIGSTOP)
    answer = rig.arm.order(Order.RELAX)
    rig.kill()
    assert "ended before it had answered" in (await asyncio.wait_for(answer, TIMEOUT_S)).message


@pytest.mark.parametrize("dead", [True, False])
async def test_an_emergency_stop_that_finds_no_process_or_a_dying_one_is_made_by_the_next(
    restarted: ArmOnServos, dead: bool
) -> None:
    await until(lambda: restarted.arm.state.mode is Mode.HOLDING)
    restarted.kill(signal.SIGKILL if dead else signal.SIGSTOP)
    if dead:
        await until(lambda: restarted.arm.state.mode is Mode.DISCONNECTED)
    answer = restarted.arm.order(Order.EMERGENCY_STOP)
    if not dead:
        restarted.kill()
    assert not (await asyncio.wait_for(answer, TIMEOUT_S)).done
    await until(lambda: restarted.arm.state.mode is Mode.FAULT)
    fault = restarted.arm.state.fault
    assert fault is not None
    assert fault.code is FaultCode.EMERGENCY_STOP
    assert not restarted.arm.state.torque_enabled


async def test_an_emergency_stop_before_the_process_has_its_configuration_is_made_as_soon_as_it_has(
    tmp_path: Path,
) -> None:
    early = ArmOnServos(tmp_path)
    await early.arm.launch()
    answer = await asyncio.wait_for(early.arm.order(Order.EMERGENCY_STOP), TIMEOUT_S)
    assert (answer.done, "is made as soon as it runs" in answer.message) == (False, True)
    await early.arm.start(TIMEOUT_S)
    await until(lambda: early.arm.state.mode is Mode.FAULT)
    assert not early.arm.state.torque_enabled
    await early.arm.close()


async def test_an_order_to_a_hanging_process_is_answered(rig: ArmOnServos, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot.arm.ORDER_TIMEOUT_S", 0.1)
    monkeypatch.setattr("robot.arm.SILENT_S", 0.3)
    rig.kill(signal.SIGSTOP)
    answer = await asyncio.wait_for(rig.arm.order(Order.RELAX), TIMEOUT_S)
    rig.kill(signal.SIGCONT)
    assert answer.message == "the arm process did not answer in 0.1 s"


async def test_a_server_that_hangs_is_noticed_and_the_arm_stopped(rig: ArmOnServos) -> None:
    motion = rig.arm.execute(to(1.5, duration_s=20.0))
    await until(lambda: rig.arm.state.mode is Mode.MOVING)
    # The hang itself: nothing of the server runs, so no heartbeat leaves. The arm's clock decides how long it
    # lasts, for on a busy machine it is behind the test's.
    until_s = rig.arm_clock_s() + SIMULATED_WATCHDOG_S + 0.6
    while rig.arm_clock_s() < until_s:
        time.sleep(0.1)  # noqa: ASYNC251 - it is to block the event loop
    assert (await asyncio.wait_for(motion, TIMEOUT_S)).outcome is Outcome.STOPPED
    await until(lambda: rig.arm.state.mode is Mode.HOLDING)
    # What was requested meanwhile, and is read late, moves nothing.
    late = await asyncio.wait_for(rig.arm.execute(to(rig.pan_rad, start_rad=rig.pan_rad)), TIMEOUT_S)
    assert late.message == rig.arm.state.halted
    assert late.message.startswith("nothing was heard of the server for 5.")


async def test_an_arm_whose_process_is_starved_goes_on_from_where_it_was(rig: ArmOnServos) -> None:
    motion = rig.arm.execute(to(0.6, duration_s=1.0))
    await until(lambda: rig.pan_rad > 0.1)
    for _ in range(3):
        rig.kill(signal.SIGSTOP)
        await asyncio.sleep(0.4)
        rig.kill(signal.SIGCONT)
        await asyncio.sleep(0.05)
    assert (await asyncio.wait_for(motion, TIMEOUT_S)).outcome is Outcome.REACHED
    assert all(state.fault is None for state in rig.states)
    goals = [data["1"][1] | data["1"][2] << 8 for data in rig.goal_writes() if "1" in data]
    # In 0.02 s, the longest that a tick may be, the trajectory covers 15 ticks of the servo at its fastest.
    assert max(abs(after - before) for before, after in itertools.pairwise(goals)) <= 16


async def test_time_limits_use_the_clock_of_a_starved_arm(rig: ArmOnServos, monkeypatch: pytest.MonkeyPatch) -> None:
    be_patient(monkeypatch)
    monkeypatch.setattr("robot.arm.ORDER_TIMEOUT_S", 0.5)
    rig.kill(signal.SIGSTOP)
    answer = rig.arm.order(Order.ENABLE)
    # The arm's time stands still while its process does.
    await asyncio.sleep(0.8)
    rig.kill(signal.SIGCONT)
    assert (await asyncio.wait_for(answer, TIMEOUT_S)).done


async def test_an_arm_process_that_dies_is_replaced_and_adopts_the_holding_arm(rig: ArmOnServos) -> None:
    motion = await begin_to_move(rig)
    rig.kill()
    assert (await asyncio.wait_for(motion, TIMEOUT_S)).outcome is Outcome.PROCESS_LOST
    before = len(rig.goal_writes())
    await until(lambda: rig.arm.state.mode is Mode.HOLDING)
    held_rad = rig.pan_rad
    assert (await rig.arm.execute(to(held_rad + 0.3, start_rad=held_rad))).outcome is Outcome.REACHED
    first = rig.goal_writes()[before]["1"]
    joint = CALIBRATION.joints[0]
    assert joint.rad_from_ticks(first[1] | first[2] << 8) == pytest.approx(held_rad, abs=0.1)


async def test_a_clock_that_is_faster_than_the_machines_goes_on_from_where_a_dead_process_left_it(
    tmp_path: Path,
) -> None:
    def ended(state: ArmState) -> bool:
        return state.reason == "the arm process ended and is starting again"

    rig = ArmOnServos(tmp_path, rate=10.0)
    await rig.start()
    rig.kill()
    await until(lambda: rig.arm.state.mode is Mode.HOLDING and any(map(ended, rig.states)))
    lost = next(number for number, state in enumerate(rig.states) if ended(state))
    assert rig.states[lost].clock_s < rig.states[lost + 1].clock_s < rig.states[lost].clock_s + 1.0
    await rig.arm.close()


async def test_an_arm_process_that_hangs_is_replaced(rig: ArmOnServos, monkeypatch: pytest.MonkeyPatch) -> None:
    hanging = rig.arm.pid
    motion = await begin_to_move(rig)
    rig.kill(signal.SIGSTOP)
    # Only for the hanging one: on a starved machine a sound process is silent for as long.
    with monkeypatch.context() as impatient:
        impatient.setattr("robot.arm.SILENT_HEARTBEATS", 4)
        assert (await asyncio.wait_for(motion, TIMEOUT_S)).outcome is Outcome.PROCESS_LOST
    await until(lambda: rig.arm.state.mode is Mode.HOLDING)
    assert rig.arm.pid != hanging
    assert {state.halted for state in rig.states} == {"", "the arm process was silent for 5 s"}


class FailingStarts:
    """Starts of arm processes, of which the first ones fail."""

    def __init__(self, *errors: Exception) -> None:
        self._errors = list(errors)
        self.failed = 0

    def __call__(self, name: str) -> StartedChild:
        if self.failed < len(self._errors):
            self.failed += 1
            raise self._errors[self.failed - 1]
        return start_arm_process(name)


async def test_an_arm_process_that_cannot_be_started_is_tried_again_until_it_can_and_does_not_fill_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    rig = ArmOnServos(tmp_path, RestartDelay(0.0, 0.0))
    await rig.arm.start(TIMEOUT_S)
    no_files = OSError(errno.EMFILE, "Too many open files")
    others = OSError(errno.EAGAIN, "Resource temporarily unavailable"), MemoryError(), RuntimeError("no new thread")
    starts = FailingStarts(*others, *[no_files] * (10 * RESTART_LINES))
    monkeypatch.setattr("robot.arm.start_arm_process", starts)
    await replaced(rig)
    assert starts.failed == len(others) + 10 * RESTART_LINES
    for reason in ("temporarily unavailable", "MemoryError", "no new thread", "Too many open files"):
        assert any("cannot be started" in state.reason and reason in state.reason for state in rig.states)
        assert reason in caplog.text
    assert caplog.text.count("Too many open files") == RESTART_LINES
    await rig.arm.close()


async def test_an_error_with_a_state_ends_no_restarts(restarted: ArmOnServos, monkeypatch: pytest.MonkeyPatch) -> None:
    first = restarted.arm.pid

    def fail(state: ArmState) -> None:
        if state.mode is Mode.DISCONNECTED:
            raise ValueError("a bug")
        restarted.states.append(state)

    monkeypatch.setattr(restarted.arm, "_on_state", fail)
    monkeypatch.setattr("robot.arm.start_arm_process", FailingStarts(OSError(errno.EMFILE, "Too many open files")))
    restarted.kill()
    await until(lambda: restarted.arm.pid != first and restarted.states[-1].mode is Mode.HOLDING)


async def test_an_arm_process_comes_back_where_clients_have_used_up_all_descriptors(restarted: ArmOnServos) -> None:
    with no_descriptors_left():
        for _ in range(3):
            killed = restarted.arm.pid
            restarted.kill()
            await until(lambda killed=killed: restarted.arm.pid != killed and restarted.arm.state.mode is Mode.HOLDING)


async def test_a_speed_factor_also_holds_for_an_arm_process_that_is_started_anew(rig: ArmOnServos) -> None:
    rig.arm.change_pace(ChangePace(speed_factor=0.5))
    await replaced(rig)
    assert rig.arm.state.pace == Pace()
    await rig.arm.execute(to(rig.pan_rad + 0.05, duration_s=0.2, start_rad=rig.pan_rad))
    assert rig.arm.state.pace == Pace(0.5)


async def test_who_asks_while_the_arm_is_being_started_waits_for_it_up_to_a_limit(tmp_path: Path) -> None:
    made = ArmOnServos(tmp_path)
    await asyncio.wait_for(made.arm.until_started(100.0 * TIMEOUT_S), TIMEOUT_S)
    await made.arm.launch()
    await asyncio.wait_for(made.arm.until_started(0.02), TIMEOUT_S)
    waiting = asyncio.create_task(made.arm.until_started(TIMEOUT_S))
    await asyncio.sleep(0)
    assert not waiting.done()
    await made.arm.start(TIMEOUT_S)
    await asyncio.wait_for(waiting, TIMEOUT_S)
    assert made.arm.state.mode is Mode.HOLDING
    await made.arm.close()


@pytest.fixture
async def relaxing(tmp_path: Path) -> ArmOnServos:
    """An arm that is relaxed when it is closed, as each test does in its way."""
    made = ArmOnServos(tmp_path, on_exit=EndState.RELAX)
    await made.start()
    return made


def is_relaxed(made: ArmOnServos) -> bool:
    return set(read_write_log(made.log)[-1]["torque"].values()) == {0}


async def test_an_arm_process_that_gets_no_time_is_waited_for_by_its_own_clock(
    relaxing: ArmOnServos, monkeypatch: pytest.MonkeyPatch
) -> None:
    be_patient(monkeypatch)
    # Relaxing takes less by the arm's clock, which stands still while its process does.
    monkeypatch.setattr("robot.arm.CLOSE_TIMEOUT_S", 3.0)
    relaxing.kill(signal.SIGSTOP)
    closing = asyncio.create_task(relaxing.arm.close())
    await asyncio.sleep(3.2)
    relaxing.kill(signal.SIGCONT)
    await asyncio.wait_for(closing, TIMEOUT_S)
    assert is_relaxed(relaxing)


async def test_an_arm_process_that_hangs_at_its_end_is_killed(
    relaxing: ArmOnServos, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pid = relaxing.arm.pid or 0
    relaxing.kill(signal.SIGSTOP)
    monkeypatch.setattr("robot.arm.SILENT_S", 0.3)
    await asyncio.wait_for(relaxing.arm.close(), TIMEOUT_S)
    assert not runs(pid)
    assert "has not ended in order (it still runs)" in caplog.text


async def test_an_arm_process_that_is_killed_at_its_end_is_reported(
    relaxing: ArmOnServos, caplog: pytest.LogCaptureFixture
) -> None:
    # It cannot be quicker than the test.
    relaxing.kill(signal.SIGSTOP)
    closing = asyncio.create_task(relaxing.arm.close())
    await asyncio.sleep(0.0)
    relaxing.kill(signal.SIGKILL)
    await asyncio.wait_for(closing, TIMEOUT_S)
    assert "has not ended in order (SIGKILL); torque may be on" in caplog.text


async def test_an_arm_process_that_is_not_waited_for_ends_by_itself_in_its_end_state(relaxing: ArmOnServos) -> None:
    pid = relaxing.arm.pid or 0
    relaxing.kill(signal.SIGSTOP)
    closing = asyncio.create_task(relaxing.arm.close())
    await asyncio.sleep(0.0)
    closing.cancel()
    await asyncio.wait([closing])
    assert runs(pid)
    relaxing.kill(signal.SIGCONT)
    await until(lambda: not runs(pid))
    assert is_relaxed(relaxing)
    await relaxing.arm.close()
