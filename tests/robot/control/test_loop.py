import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from robot.control import loop
from robot.control.loop import ArmLoop, hardware_opener
from robot.control.pacing import LoopClock, Scheduling
from robot.errors import PortError
from robot.hardware.config import EmulatedConfig, IdealConfig, SerialConfig
from robot.hardware.interface import HardwareInterface, Measured
from robot.messages import (
    ArmConfig,
    ArmHealth,
    ArmState,
    Command,
    CommandDone,
    Continuation,
    EndState,
    Execute,
    Heartbeat,
    Mode,
    MotionEnded,
    Order,
    Outcome,
    Shutdown,
)
from tests.helpers import dynamixel
from tests.helpers.arm_rig import CALIBRATION, NAMES, ROBOT
from tests.helpers.emulator import SteppedClock
from tests.helpers.motions import smooth_move
from tests.helpers.programs import run_python


def test_simulated_hardware_opens_and_can_be_read_at_once() -> None:
    koch = ArmConfig(dynamixel.ROBOT, EmulatedConfig(dynamixel.CALIBRATION, kind="dynamixel"))
    for config in (ArmConfig(ROBOT, EmulatedConfig(CALIBRATION)), ArmConfig(ROBOT, IdealConfig()), koch):
        opened = hardware_opener(config, SteppedClock())()
        assert opened.joint_names == NAMES
        assert opened.read().position_rad == pytest.approx([0.0] * 6, abs=0.002), config


def test_a_port_that_is_not_there_is_an_error_only_when_it_is_opened() -> None:
    koch = ArmConfig(dynamixel.ROBOT, SerialConfig(dynamixel.CALIBRATION, "/dev/none", "dynamixel"))
    so101s = (ArmConfig(ROBOT, SerialConfig(CALIBRATION, port)) for port in ("/dev/none", "usb:0000:0001"))
    for config in (koch, *so101s):
        open_hardware = hardware_opener(config, SteppedClock())
        with pytest.raises(PortError, match=r"/dev/none|0000:0001"):
            open_hardware()


class SteppedChannel:
    """The server's end of a loop in stepped time: each message comes at its time, and waiting passes the time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, config: ArmConfig, *messages: tuple[float, object]) -> None:
        self.now_s = 0.0
        self.looks = 0
        self.messages = list(messages)
        self.sent: list[tuple[float, Any]] = []
        self.dropped: defaultdict[type, set[bool]] = defaultdict(set)  # True: while the server does not read
        self.gone_at_s = math.inf
        monkeypatch.setattr(loop, "time", SimpleNamespace(monotonic=lambda: self.now_s, sleep=self.receive))
        self.loop = ArmLoop(self, config, Scheduling())  # type: ignore[arg-type]

    @property
    def closed(self) -> bool:
        return self.now_s >= self.gone_at_s

    def receive(self, timeout_s: float) -> list[object]:
        until_s = self.now_s + timeout_s
        if self.now_s < self.gone_at_s < until_s:
            until_s = self.gone_at_s
        if self.messages and self.messages[0][0] <= until_s:
            until_s = max(self.now_s, self.messages[0][0])
        self.now_s, self.looks = until_s, self.looks + 1
        if timeout_s < 0.0 or self.now_s > 60.0 or self.looks > 10_000:
            raise TimeoutError("the loop never ends, or waits for less than no time")
        due = [message for at_s, message in self.messages if at_s <= until_s]
        del self.messages[: len(due)]
        return due

    def send(self, message: object, *, droppable: bool = False) -> None:
        self.sent.append((self.now_s, message))
        self.dropped[type(message)].add(droppable)

    def kept(self, kind: type) -> list[tuple[float, Any]]:
        """All messages of a kind that were sent, with their times."""
        return [(at_s, message) for at_s, message in self.sent if isinstance(message, kind)]


IDEAL = ArmConfig(ROBOT, IdealConfig(driven=True))


def test_hardware_that_cannot_be_opened_is_tried_again_ever_later_and_at_once_after_it_was_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried_s: list[float] = []
    channel = SteppedChannel(monkeypatch, IDEAL, (12.0, Shutdown()))

    def opener(*_: object) -> Callable[[], HardwareInterface]:
        if not tried_s:
            tried_s.append(channel.now_s)
            raise OSError("the log is in use")
        return fail

    def fail() -> HardwareInterface:
        tried_s.append(channel.now_s)
        if len(tried_s) == 6:
            hardware = hardware_opener(IDEAL, SteppedClock())()
            hardware.read = fail  # type: ignore[assignment, method-assign]
            return hardware
        raise PortError("/dev/none", "is not there")

    monkeypatch.setattr(loop, "hardware_opener", opener)
    channel.loop.run()
    # The sixth is there, and lost in its first tick.
    assert tried_s == pytest.approx([0.0, 0.2, 0.6, 1.4, 3.0, 5.0, 5.01, 5.21, 5.61, 6.41, 8.01, 10.01], abs=1e-6)
    reasons = list(dict.fromkeys(state.reason for _, state in channel.kept(ArmState)))
    assert channel.dropped[ArmState] == {True}
    assert reasons == ["the emulated servos cannot be made: the log is in use", "serial port /dev/none is not there"]


def ticks_of(channel: SteppedChannel, monkeypatch: pytest.MonkeyPatch, tick_s: float = 0.0) -> np.ndarray:
    """Run the loop until its end, with ticks that take some time; returns when they came."""
    ticked_s: list[float] = []

    def opener(config: ArmConfig, clock: LoopClock) -> Callable[[], HardwareInterface]:
        hardware = hardware_opener(config, clock)()
        read = hardware.read

        def recorded() -> Measured | None:
            ticked_s.append(channel.now_s)
            channel.now_s += tick_s
            return read()

        hardware.read = recorded  # type: ignore[method-assign]
        return lambda: hardware

    monkeypatch.setattr(loop, "hardware_opener", opener)
    channel.loop.run()
    return np.array(ticked_s)


PAN = smooth_move({"shoulder_pan": (0.0, 1.0)}, 1.5)


@pytest.mark.parametrize(("asked_s", "first_s"), [(2.023, 2.024), (2.027, 2.027), (2.047, 2.047)])
def test_a_tick_is_every_hundredth_second_or_skipped_at_rest_and_4_ms_after_the_last_or_at_once_for_a_motion(
    monkeypatch: pytest.MonkeyPatch, asked_s: float, first_s: float
) -> None:
    messages = (0.1, Heartbeat(observed=False)), (asked_s, Execute(1, PAN)), (4.5, Shutdown())
    channel = SteppedChannel(monkeypatch, IDEAL, *messages)
    ticked_s = ticks_of(channel, monkeypatch)
    ((ended_s, ended),) = channel.kept(MotionEnded)
    assert (ended.outcome, ended_s - first_s) == (Outcome.REACHED, pytest.approx(1.52, abs=0.011))
    begun = int(np.searchsorted(ticked_s, first_s - 1e-6))
    over = int(np.searchsorted(ticked_s, ended_s - 1e-6))
    assert ticked_s[begun - 1 : begun + 1] == pytest.approx([2.02, first_s])
    assert np.diff(ticked_s[begun : over + 1]) == pytest.approx(0.01)
    # Every other tick, after half a second at rest every fifth.
    assert np.diff(ticked_s[over : over + 26]) == pytest.approx(0.02)
    assert np.diff(ticked_s[over + 26 :]) == pytest.approx(0.05)


@pytest.mark.parametrize(("leaves_s", "ticks_s"), [(2.0555, [2.058, 2.068]), (2.0595, [2.06, 2.064, 2.074])])
def test_a_tick_follows_soon_after_a_motion_has_left_the_path_of_another(
    monkeypatch: pytest.MonkeyPatch, leaves_s: float, ticks_s: list[float]
) -> None:
    spliced = Execute(2, PAN, continues=Continuation(1, 0.0, leaves_s))
    messages = (0.1, Heartbeat(observed=False)), (2.02, Execute(1, PAN)), (2.0505, spliced), (4.5, Shutdown())
    channel = SteppedChannel(monkeypatch, IDEAL, *messages)
    ticked_s = ticks_of(channel, monkeypatch)
    after = int(np.searchsorted(ticked_s, 2.0505))
    assert ticked_s[after : after + len(ticks_s)] == pytest.approx(ticks_s)
    assert [(end.motion_id, end.outcome) for _, end in channel.kept(MotionEnded)] == [
        (1, Outcome.STOPPED),
        (2, Outcome.REACHED),
    ]


def test_sequences_take_all_steps_between_two_ticks_that_there_is_time_for(monkeypatch: pytest.MonkeyPatch) -> None:
    channel = SteppedChannel(monkeypatch, ArmConfig(ROBOT, EmulatedConfig(CALIBRATION)), (2.0, Shutdown()))
    ticks_of(channel, monkeypatch)
    # With one step a tick it takes 1.7 s.
    assert min(at_s for at_s, state in channel.kept(ArmState) if state.mode is Mode.HOLDING) < 0.7


def test_when_every_tick_is_late_sequences_go_on_and_a_simulated_arm_is_slower(monkeypatch: pytest.MonkeyPatch) -> None:
    config = ArmConfig(ROBOT, EmulatedConfig(CALIBRATION), state_rate_hz=100.0)
    channel = SteppedChannel(monkeypatch, config, (20.0, Shutdown()))
    ticks_of(channel, monkeypatch, tick_s=0.0295)
    states = channel.kept(ArmState)
    assert any(state.mode is Mode.HOLDING for _, state in states)
    # No more than two periods pass in a tick.
    (first_s, first), (last_s, last) = states[0], states[-1]
    assert last.clock_s - first.clock_s == pytest.approx(0.02 / 0.0295 * (last_s - first_s))


def test_of_messages_that_come_together_an_emergency_stop_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    together = (1.0, Execute(1, PAN)), (1.0, Command(1, Order.EMERGENCY_STOP, epoch=1)), (1.0, Execute(2, PAN, epoch=1))
    channel = SteppedChannel(monkeypatch, IDEAL, *together, (2.0, Shutdown()))
    ticks_of(channel, monkeypatch)
    ends = [(ended.motion_id, ended.outcome) for _, ended in channel.kept(MotionEnded)]
    assert ends == [(1, Outcome.STOPPED), (2, Outcome.REFUSED)]
    # No answer is left out for a server that does not read; of states and reports another comes.
    assert channel.dropped == {ArmState: {True}, ArmHealth: {True}, MotionEnded: {False}, CommandDone: {False}}


@pytest.mark.parametrize("opens", [True, False])
def test_a_server_that_is_gone_ends_the_loop(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, opens: bool
) -> None:
    config = replace(IDEAL, on_server_lost=EndState.RELAX)
    if not opens:
        config = replace(config, hardware=SerialConfig(CALIBRATION, "/dev/none"))
    channel = SteppedChannel(monkeypatch, config, (1.0, Execute(1, PAN)))
    channel.gone_at_s = 1.5
    channel.loop.run()
    # Relaxing takes two seconds.
    assert 1.5 <= channel.now_s < 4.5
    assert "end state" not in caplog.text
    assert f"the server is gone: {'stopping' if opens else 'nothing moves'}" in caplog.text
    ((_, ended),) = channel.kept(MotionEnded)
    assert ended.outcome is (Outcome.STOPPED if opens else Outcome.BUS_LOST)


@pytest.mark.parametrize(
    ("hardware", "loaded"),
    [
        ("IdealConfig()", []),
        ("IdealConfig(physics=True)", ["mujoco"]),
        ("EmulatedConfig(calibration)", ["scservo_sdk", "serial"]),
        ("SerialConfig(calibration, '/dev/none')", ["scservo_sdk", "serial"]),
    ],
)
def test_each_kind_of_arm_loads_its_own_library_alone(hardware: str, loaded: list[str]) -> None:
    program = (
        "import sys; from robot.description.robot_folder import built_in; from robot.messages import ArmConfig\n"
        "from robot.hardware.config import EmulatedConfig, IdealConfig, SerialConfig\n"
        "from robot.errors import PortError; from robot.calibration import Calibration\n"
        "from robot.control.pacing import LoopClock; from robot.control.loop import hardware_opener\n"
        "so101 = built_in('so101'); calibration = Calibration.nominal(so101.hardware.servos)\n"
        f"try: hardware_opener(ArmConfig(so101.model, {hardware}), LoopClock())()\nexcept PortError: pass\n"
        "print(sorted({'serial', 'scservo_sdk', 'dynamixel_sdk', 'mujoco'} & set(sys.modules)))"
    )
    assert run_python(program).stdout.strip() == str(loaded)
