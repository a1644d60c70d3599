from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.emulator.process import UsbAdapter
from robot.errors import PortNotFound, StartupError
from robot.hardware.config import DynamixelConfig, FeetechConfig
from robot.hardware.interface import StatusFlag, run_to_end
from robot.hardware.servos.hardware import CYCLES_BETWEEN, SerialServos, ServoHardware
from robot.hardware.servos.tracker import MISSES_UNTIL_SILENT
from robot.messages import GuardLimits, Mode
from tests.helpers.servo_families import IDS, Family


@pytest.fixture
def servos(family: Family) -> Any:
    return family.in_use()


FULL = np.array([0.8] * 5 + [0.5])
PAN_A_LITTLE = np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_servos_that_hold_are_found_with_their_goals(family: Family, servos: Any) -> None:
    goal_rad = servos.enable()
    found = family.in_use(servos.emulator).found
    assert found.driven.all()
    assert found.goal_rad == pytest.approx(goal_rad)


def test_a_goal_that_a_servo_has_lost_is_written_again(family: Family, servos: Any) -> None:
    servos.enable()
    servos.hardware.write_goals(PAN_A_LITTLE)
    written = family.values(servos.emulator, "GOAL_POSITION")
    family.put(servos.emulator, 1, "GOAL_POSITION", 2000)
    servos.hardware.write_goals(PAN_A_LITTLE)
    assert family.values(servos.emulator, "GOAL_POSITION") == written


def test_a_changed_torque_limit_is_written_at_once_and_only_once(family: Family, servos: Any) -> None:
    servos.enable()
    for share in (0.5, 0.25):
        sent = servos.hardware.bus.counters.sent
        for _ in range(3):
            servos.hardware.write_torque_shares(FULL * [1, 1, 1, 1, 1, share])
        assert servos.hardware.bus.counters.sent - sent == 1
        assert family.limits(servos.emulator) == pytest.approx([0.8] * 5 + [0.5 * share], abs=0.001)


def test_relaxing_begins_with_the_torque_that_is_used(family: Family, servos: Any) -> None:
    servos.enable()
    steps = servos.hardware.relax(FULL * 0.5)
    next(steps)
    next(steps)
    assert max(family.limits(servos.emulator)) <= 0.4 + 0.001
    assert run_to_end(steps, servos.emulator.run) == []
    assert family.values(servos.emulator, "TORQUE_ENABLE") == [0] * 6


@pytest.mark.parametrize("hold", [True, False])
def test_an_overload_is_cleared_where_the_joint_is_and_it_holds_on_or_stays_relaxed(
    family: Family, servos: Any, hold: bool
) -> None:
    goal_rad = servos.enable() if hold else None
    family.fail(servos.emulator.servo_bus.servos[3])
    assert servos.read(0.1).status[3] == StatusFlag.OVERLOAD
    held_rad = run_to_end(servos.hardware.clear_overloads([3], hold=hold), servos.emulator.run)
    assert held_rad is None if goal_rad is None else held_rad == pytest.approx(goal_rad, abs=0.03)
    assert servos.read(0.1).status[3] == 0
    assert family.values(servos.emulator, "TORQUE_ENABLE") == [int(hold)] * 6


def test_a_silent_servo_is_not_waited_for_by_the_check(family: Family, servos: Any) -> None:
    servos.enable()
    servos.emulator.servo_bus.faults.offline = set(IDS)
    for _ in range(6 * MISSES_UNTIL_SILENT):
        servos.hardware.read()
    sent = servos.hardware.bus.counters.sent
    assert [servos.hardware.check(0.0) for _ in range(40)] == [None] * 40
    assert servos.hardware.bus.counters.sent == sent


def test_the_condition_has_torque_silence_and_the_surveys_warnings(family: Family) -> None:
    emulator = family.emulator()
    family.put(emulator, 2, family.lowest_limit, 1000)
    servos = family.in_use(emulator)
    assert servos.hardware.condition(1).torque_enabled is None
    servos.enable()
    for _ in range(6 * len(family.driver.read_back) * CYCLES_BETWEEN):
        servos.hardware.check(0.0)
    emulator.servo_bus.faults.offline = {2}
    servos.read()
    condition = servos.hardware.condition(1)
    assert (condition.hardware_id, condition.torque_enabled, condition.silent_cycles) == ("servo 2", True, 1)
    assert condition.age_s > 0.0
    (warning,) = condition.warnings
    assert "1000" in warning.sentence


def writes(emulator: Any) -> list[Any]:
    """Keep the writes that the servos get from now on, which do not take them."""
    written: list[Any] = []
    for servo in emulator.servo_bus.servos:
        servo.write = lambda *arguments: written.append(arguments)
    return written


@pytest.mark.parametrize(
    ("offline", "words"),
    [
        ({2, 5}, r"no answer from shoulder_lift \(id 2\), wrist_roll \(id 5\): check the cable"),
        (set(IDS), "no servo answers: is the arm powered"),
    ],
)
def test_missing_servos_are_named_by_a_survey_with_the_likely_cause(
    family: Family, offline: set[int], words: str
) -> None:
    emulator = family.emulator()
    written = writes(emulator)
    emulator.servo_bus.faults.offline = offline
    with pytest.raises(StartupError, match=words):
        run_to_end(family.unread(emulator).survey())
    emulator.servo_bus.faults.offline = set()
    assert list(run_to_end(family.unread(emulator).survey()).driven) == [False] * 6
    assert written == []


def test_a_relaxed_arm_is_read_and_nothing_is_written(family: Family) -> None:
    emulator = family.emulator()
    written = writes(emulator)
    rig = family.rig(emulator, start_enabled=False)
    rig.until_mode(Mode.RELAXED)
    before = rig.state.stamp_s
    rig.run(0.2)
    assert rig.state.stamp_s > before
    assert written == []


def test_a_cycle_is_one_block_read_and_one_goal_write_and_now_and_then_a_register_is_read_back(family: Family) -> None:
    rig = family.rig(family.emulator())
    rig.until_mode(Mode.HOLDING)
    arm = rig.supervisor.arm
    before = arm.hardware.counters.sent
    for _ in range(CYCLES_BETWEEN):
        arm.tick()
    assert arm.hardware.counters.sent - before == CYCLES_BETWEEN * 2 + 1


def test_changed_goals_are_written_at_once(family: Family, servos: Any) -> None:
    register = family.registers.Register.GOAL_POSITION
    for pan_rad in (0.1, 0.2):
        servos.hardware.write_goals(np.array([pan_rad, 0.0, 0.0, 0.0, 0.0, 0.0]))
        assert servos.hardware.bus.read(1, register) == family.calibration.joints[0].ticks_from_rad(pan_rad)


def surveyed(family: Family, emulator: Any, *, simulated: bool = False, **calibration: bool) -> Any:
    """Hardware with another kind of calibration."""
    hardware = ServoHardware(
        family.driver,
        emulator.open_bus(),
        replace(family.calibration, **calibration),
        family.bounds,
        GuardLimits(),
        emulator.clock,
        simulated=simulated,
    )
    run_to_end(hardware.survey())
    return hardware


def test_a_real_arm_whose_zero_nobody_has_measured_is_read_but_not_enabled(family: Family) -> None:
    emulator = family.emulator()
    hardware = surveyed(family, emulator, measured=False)
    written = writes(emulator)
    with pytest.raises(StartupError, match=r"no calibration says where the joints' zero is.*--calibration"):
        run_to_end(hardware.enable(range(6)), emulator.run)
    assert written == []
    assert hardware.read().position_rad.shape == (6,)


def test_an_emulated_arm_needs_no_calibration(family: Family) -> None:
    emulator = family.emulator()
    hardware = surveyed(family, emulator, simulated=True, measured=False)
    run_to_end(hardware.enable(range(6)), emulator.run)
    assert run_to_end(hardware.driven(), emulator.run).all()


def test_an_arm_whose_servos_have_another_calibration_is_not_enabled(family: Family) -> None:
    emulator = family.emulator()
    family.put(emulator, 3, "HOMING_OFFSET", family.calibration.joints[2].homing_offset + 10)
    hardware = surveyed(family, emulator, offsets_known=True)
    written = writes(emulator)
    with pytest.raises(StartupError, match="the zero has shifted since the calibration at elbow_flex"):
        run_to_end(hardware.enable(range(6)), emulator.run)
    assert written == []


class Adapter:
    """The one USB adapter that is plugged in, wherever that is."""

    device = "/dev/does-not-exist"

    @classmethod
    def comports(cls) -> list[ListPortInfo]:
        info = ListPortInfo(cls.device)
        info.vid, info.pid = 0x1A86, 0x55D3
        return [info]


@contextlib.contextmanager
def plugged_in() -> Iterator[UsbAdapter]:
    terminal = UsbAdapter()
    yield terminal
    terminal.unplug()


def test_an_adapter_is_looked_for_each_time_that_it_is_opened(monkeypatch: pytest.MonkeyPatch, family: Family) -> None:
    monkeypatch.setattr(list_ports, "comports", Adapter.comports)
    config = FeetechConfig(family.calibration, "auto")
    source = SerialServos(family.driver, config, family.bounds, GuardLimits(), lambda: 0.0)
    with pytest.raises(PortNotFound):
        source.open()
    with plugged_in() as terminal:
        monkeypatch.setattr(Adapter, "device", terminal.port)
        with contextlib.closing(source.open()) as hardware:
            assert hardware.joint_names == tuple(joint.joint for joint in family.calibration.joints)


def test_a_port_is_opened_with_the_baud_rate_of_its_configuration(family: Family) -> None:
    with plugged_in() as terminal:
        config = DynamixelConfig(family.calibration, terminal.port, 57_600)
        source = SerialServos(family.driver, config, family.bounds, GuardLimits(), lambda: 0.0)
        with contextlib.closing(source.open()) as hardware:
            assert isinstance(hardware, ServoHardware)
            assert hardware.bus._port.baudrate == 57_600
