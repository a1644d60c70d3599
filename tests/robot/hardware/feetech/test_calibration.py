from __future__ import annotations

import contextlib
import itertools
from dataclasses import replace

import pytest

from harness.server import read_write_log
from robot.calibration import Calibration
from robot.commissioning.scan import scan
from robot.errors import RobotError
from robot.hardware.feetech.family import differences, read_differences, write_to_servos
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import run_to_end
from tests.helpers.emulator import SteppedEmulator
from tests.helpers.robots import SO101_SERVOS, nominal_calibration

IDS = tuple(spec.servo_id for spec in SO101_SERVOS)


def test_what_the_bus_reads_differs_as_what_a_scan_has_read(bus):
    elbow = replace(nominal_calibration().joints[2], range_min=950, homing_offset=-12)
    wanted = Calibration((*nominal_calibration().joints[:2], elbow, *nominal_calibration().joints[3:]))
    found = run_to_end(read_differences(bus, wanted))
    assert found == differences(wanted, scan(bus, IDS).registers)
    assert [each.register for each in found] == [Register.MIN_ANGLE_LIMIT, Register.HOMING_OFFSET]


REGISTERS = (Register.HOMING_OFFSET, Register.MIN_ANGLE_LIMIT, Register.MAX_ANGLE_LIMIT)


# Two servos, so that one is done or not begun while the other is written.
CHANGED = (2, 3)


def recalibrated():
    """The calibration with another offset and range of two joints."""
    return Calibration(
        tuple(
            replace(joint, homing_offset=-25, range_min=joint.range_min + 40, range_max=joint.range_max + 30)
            if joint.servo_id in CHANGED
            else joint
            for joint in nominal_calibration().joints
        )
    )


def calibrated_registers_of(bus, servos=IDS):
    """Offset and limits of servos, by id."""
    return {servo: tuple(bus.read(servo, register) for register in REGISTERS) for servo in servos}


def lose_port(emulator):
    emulator.command(plugged=False)


def lose_all_replies(emulator):
    emulator.command(offline=list(IDS))


def interrupted(at_step, interrupt):
    """Servos whose writing was interrupted before a step; None when it had fewer steps."""
    emulator = SteppedEmulator(wire_time=False)
    bus = emulator.open_bus()
    before = calibrated_registers_of(bus)
    steps = write_to_servos(bus, run_to_end(read_differences(bus, recalibrated()), no_wait))
    try:
        for _ in range(at_step):
            next(steps)
    except StopIteration:
        return None
    interrupt(emulator)
    with contextlib.suppress(RobotError):
        if interrupt is not nothing:
            run_to_end(steps, no_wait)
    steps.close()
    emulator.command(online=list(IDS))
    emulator.command(plugged=True)
    return emulator.open_bus(), before


def nothing(_emulator):
    """Interrupt nothing: the sequence is given up where it is."""


def no_wait(_seconds):
    """Take the next step at once."""


@pytest.mark.parametrize("interrupt", [nothing, lose_all_replies, lose_port])
def test_a_write_that_is_interrupted_at_any_step_leaves_no_new_offset_with_old_limits(interrupt):
    wanted = {
        joint.servo_id: (joint.homing_offset, joint.range_min, joint.range_max) for joint in recalibrated().joints
    }
    for at_step in itertools.count(1):
        found = interrupted(at_step, interrupt)
        if found is None:
            break
        bus, before = found
        for servo, held in calibrated_registers_of(bus, CHANGED).items():
            assert held[0] == before[servo][0] or held == wanted[servo], (at_step, servo, held)
            if interrupt is nothing:
                assert held in (before[servo], wanted[servo]), (at_step, servo, held)
                assert bus.read(servo, Register.LOCK) == 1, (at_step, servo)
    assert at_step > len(CHANGED) * len(REGISTERS)


def test_only_what_differs_is_written_and_it_outlives_a_power_cut(start_emulator, write_log):
    emulator = start_emulator("--write-log", str(write_log))
    nominal = nominal_calibration()
    elbow = replace(nominal.joints[2], range_min=950, homing_offset=-12)
    wanted = Calibration((*nominal.joints[:2], elbow, *nominal.joints[3:]))
    bus = emulator.open_bus()
    run_to_end(write_to_servos(bus, differences(wanted, scan(bus, IDS).registers)), emulator.run)
    emulator.command(power_cycle=[3])
    assert differences(wanted, scan(bus, IDS).registers) == []
    written = [(entry["address"], *entry["data"]) for entry in read_write_log(write_log) if entry["data"]]
    assert set(written) <= {(Register.LOCK, "3"), (Register.HOMING_OFFSET, "3"), (Register.MIN_ANGLE_LIMIT, "3")} | {
        (Register.TORQUE_ENABLE, "3")
    }
    assert bus.read(3, Register.LOCK) == 1
    bus.close()
