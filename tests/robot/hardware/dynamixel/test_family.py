import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from dynamixel_sdk import COMM_SUCCESS, INST_PING, INST_READ, INST_REBOOT, INST_WRITE, PacketHandler
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import RAD_PER_TICK
from robot.emulator.dynamixel import DYNAMIXEL, REBOOT_S
from robot.emulator.servo_bus import Instruction, InstructionParser
from robot.errors import NoReply, StartupError
from robot.faults import FaultCode, ServoAlert
from robot.hardware.dynamixel.family import (
    STUFFED,
    WATCHDOG,
    Bus,
    Dynamixel,
    StatusFrame,
    instruction_packet,
    packet,
    parse_status_frames,
    status_bytes,
)
from robot.hardware.dynamixel.registers import FULL_PWM, TICKS_S_PER_VELOCITY_UNIT, OperatingMode, Register, status_of
from robot.hardware.interface import StatusFlag, run_to_end
from robot.hardware.port import LOCAL_LATENCY_S
from robot.hardware.servos.bus import write_verified
from robot.hardware.servos.family import ServoFound, ServoMap
from robot.hardware.servos.hardware import CYCLES_BETWEEN, TELEMETRY_EVERY
from robot.hardware.servos.survey import survey
from robot.hardware.servos.torque import TORQUE_ON_WITHIN_TICKS
from robot.messages import Mode, Order
from tests.helpers.dynamixel import (
    BOUNDS,
    CALIBRATION,
    METAL,
    DynamixelRig,
    DynamixelsInUse,
    SteppedDynamixels,
    unread_hardware,
)
from tests.robot.hardware.feetech.test_bus import ScriptedPort

FAMILY = Dynamixel()
SERVOS = ServoMap(FAMILY, CALIBRATION, BOUNDS)

# By its weight and its gear's friction a joint sinks less than this (0.5 deg).
DROOP_TICKS = 6


@pytest.fixture
def dynamixels() -> SteppedDynamixels:
    return SteppedDynamixels(start_rad={"elbow_flex": 1.1})


def surveyed(dynamixels: SteppedDynamixels) -> dict[int, ServoFound]:
    return run_to_end(survey(FAMILY, dynamixels.open_bus(), SERVOS))


@pytest.mark.parametrize(
    ("servo", "register", "value", "words"),
    [
        (3, Register.MODEL_NUMBER, 1060, r"elbow_flex \(id 3\) is model 1060, not xl330-m288 \(1200\)"),
        *(
            (servo, Register.OPERATING_MODE, mode, rf"operating mode {mode}.*OPERATING_MODE \(11\) to 4")
            for servo, mode in ((1, 1), (1, 5), (3, 0), (3, 16))
        ),
        # Without its offset of -1700 ticks the joint's zero would be 150 deg wrong.
        (3, Register.OPERATING_MODE, OperatingMode.POSITION, "ignores its homing offset of -1700 ticks"),
        *((3, Register.DRIVE_MODE, mode, rf"drive mode {mode}.*DRIVE_MODE \(10\) to 0") for mode in (1, 4, 8)),
    ],
)
def test_a_servo_of_another_model_or_mode_is_refused(
    dynamixels: SteppedDynamixels, servo: int, register: Register, value: int, words: str
) -> None:
    dynamixels.servo(servo).set(register, value)
    with pytest.raises(StartupError, match=words):
        surveyed(dynamixels)
    joint = CALIBRATION.joints[0]
    with pytest.raises(StartupError, match=r"is a 'ax-12' in the arm's robot\.toml; known are xl430-w250, xl330-m288"):
        FAMILY.check_model(replace(joint, servo=replace(joint.servo, model="ax-12")), 12)


def test_a_firmware_without_watchdog_is_a_warning_and_driven_without(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(1).set(Register.FIRMWARE_VERSION, 37)
    found = surveyed(dynamixels)
    assert not FAMILY.has_watchdog(CALIBRATION.joints[0], found[1].values)
    assert FAMILY.has_watchdog(CALIBRATION.joints[2], found[3].values)
    (warning,) = found[1].warnings
    assert warning.alert is ServoAlert.NO_WATCHDOG
    assert "37 has no bus watchdog" in warning.sentence
    servos = DynamixelsInUse(dynamixels)
    servos.enable()
    assert dynamixels.registers(Register.BUS_WATCHDOG) == [0] + [WATCHDOG] * 5
    assert [servos.hardware.check(0.0) for _ in range(12 * CYCLES_BETWEEN)] == [None] * 12 * CYCLES_BETWEEN


def test_limits_are_the_servos_in_position_mode_or_end_before_ambiguous_turns(dynamixels: SteppedDynamixels) -> None:
    wide = replace(BOUNDS, lower_rad=np.full(6, -7.0), upper_rad=np.full(6, 7.0))
    bounds = run_to_end(unread_hardware(dynamixels, bounds=wide).survey()).bounds
    assert max(bounds.upper_rad[:5]) < math.pi - 0.3
    assert min(bounds.lower_rad[:5]) > -math.pi + 0.3
    certain = SERVOS.certain_ticks(2)
    assert FAMILY.goal_limits_ticks(surveyed(dynamixels)[2].values, certain) == certain
    dynamixels.servo(2).set(Register.OPERATING_MODE, OperatingMode.POSITION)
    assert FAMILY.goal_limits_ticks(surveyed(dynamixels)[2].values, certain) == (1300, 2790)


def positions(dynamixels: SteppedDynamixels) -> list[float]:
    return [servo.plant.position_ticks for servo in dynamixels.servo_bus.servos]


def test_a_servo_that_counts_turns_holds_and_goes_to_goals_in_its_turns(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3)._turns_ticks += 2 * 4096
    before = positions(dynamixels)
    servos = DynamixelsInUse(dynamixels)
    assert servos.enable()[2] == pytest.approx(1.1, abs=RAD_PER_TICK)
    dynamixels.run(0.5)
    assert positions(dynamixels) == pytest.approx(before, abs=DROOP_TICKS)
    servos.hardware.write_goals(np.array([0.0, 0.0, 1.2, 0.0, 0.0, 0.0]))
    assert servos.read(0.4).position_rad[2] == pytest.approx(1.2, abs=0.01)


def test_servos_that_hold_have_watchdog_profile_and_limits(dynamixels: SteppedDynamixels) -> None:
    for servo, register, value in ((3, Register.PWM_LIMIT, 500), (3, Register.GOAL_PWM, 500)):
        dynamixels.servo(servo).write(register, register.encode(value))
    DynamixelsInUse(dynamixels).enable()
    modes = dynamixels.registers(Register.OPERATING_MODE)
    assert modes == [OperatingMode.EXTENDED_POSITION] * 5 + [OperatingMode.CURRENT_BASED_POSITION]
    full = round(0.8 * FULL_PWM)
    assert dynamixels.registers(Register.GOAL_PWM) == [full, full, 500, full, full, FULL_PWM]
    assert dynamixels.servo(6).value(Register.GOAL_CURRENT) == 735
    assert dynamixels.registers(Register.BUS_WATCHDOG) == [WATCHDOG] * 6
    assert min(dynamixels.registers(Register.PROFILE_ACCELERATION)) > 0
    for servo, velocity in enumerate(dynamixels.registers(Register.PROFILE_VELOCITY), 1):
        assert velocity == math.ceil(SERVOS.speed_ticks_s[servo] / TICKS_S_PER_VELOCITY_UNIT)
    weak = SteppedDynamixels()
    weak.servo(6).write(Register.CURRENT_LIMIT, Register.CURRENT_LIMIT.encode(600))
    DynamixelsInUse(weak).enable()
    assert weak.servo(6).value(Register.GOAL_CURRENT) == 600


def test_a_servo_stopped_by_its_watchdog_stays_there(dynamixels: SteppedDynamixels) -> None:
    DynamixelsInUse(dynamixels).enable()
    servo = dynamixels.servo(5)
    servo.write(Register.PROFILE_VELOCITY, Register.PROFILE_VELOCITY.encode(10))
    goal = servo.value(Register.GOAL_POSITION) - 1500
    servo.write(Register.GOAL_POSITION, Register.GOAL_POSITION.encode(goal))
    dynamixels.run(1.0)
    assert servo.value(Register.BUS_WATCHDOG) == -1
    stopped = servo.plant.position_ticks
    assert abs(servo.present_ticks - goal) > 1000
    goal_rad = DynamixelsInUse(dynamixels).enable()[4]
    dynamixels.run(0.3)
    assert servo.plant.position_ticks == pytest.approx(stopped, abs=TORQUE_ON_WITHIN_TICKS)
    at_rad = CALIBRATION.joints[4].rad_from_ticks(servo.present_ticks)
    assert goal_rad == pytest.approx(at_rad, abs=TORQUE_ON_WITHIN_TICKS * RAD_PER_TICK)
    assert servo.value(Register.BUS_WATCHDOG) == WATCHDOG


@pytest.fixture
def servos(dynamixels: SteppedDynamixels) -> DynamixelsInUse:
    return DynamixelsInUse(dynamixels)


def test_supply_and_temperature_are_read_less_often_and_an_assumed_calibration_has_no_homing_offsets(
    dynamixels: SteppedDynamixels,
) -> None:
    servos = DynamixelsInUse(dynamixels, replace(METAL, calibration=replace(CALIBRATION, offsets_known=False)))
    dynamixels.servo(3).voltage_v = 5.6
    readings = [servos.read().voltage_v[2] for _ in range(2 * TELEMETRY_EVERY)]
    assert (readings[0], readings[-1]) == pytest.approx((5.0, 5.6))
    dynamixels.servo(3).set(Register.HOMING_OFFSET, -1690)
    run_to_end(servos.hardware.survey())
    with pytest.raises(StartupError, match=r"-1690 instead of -1700 ticks"):
        servos.enable()


def test_an_uncalibrated_arm_that_is_found_holding_goes_on_holding(dynamixels: SteppedDynamixels) -> None:
    for servo in dynamixels.servo_bus.servos:
        servo.hold()
    before = positions(dynamixels)
    rig = DynamixelRig(dynamixels, hardware=replace(METAL, calibration=replace(CALIBRATION, measured=False)))
    rig.until_mode(Mode.FAULT)
    rig.run(1.0)
    assert rig.fault_code == FaultCode.STARTUP_REFUSED.value
    assert rig.torque() == [1] * 6
    assert positions(dynamixels) == pytest.approx(before, abs=DROOP_TICKS)


@pytest.mark.parametrize(
    ("bits", "code"),
    [(0x20, FaultCode.OVERLOAD), (0x04, FaultCode.OVERHEATED), (0x08, FaultCode.ENCODER_ERROR)],
)
def test_a_servo_that_protected_itself_is_reset(dynamixels: SteppedDynamixels, bits: int, code: FaultCode) -> None:
    rig = DynamixelRig(dynamixels).started()
    rig.run(1.0)
    dynamixels.servo(3).fail(bits)
    rig.until_mode(Mode.FAULT)
    assert rig.fault_code == code.value
    # The rest of the arm is relaxed by itself, except after an error of an encoder.
    rig.run(3.0)
    answer = rig.order(Order.RESET_FAULT)
    assert answer.done, answer.message
    assert rig.order(Order.ENABLE).done
    rig.run(0.5)
    assert rig.mode is Mode.HOLDING
    assert rig.torque() == [1] * 6
    assert dynamixels.registers(Register.BUS_WATCHDOG) == [WATCHDOG] * 6
    assert dynamixels.servo(3).value(Register.GOAL_PWM) == round(0.8 * FULL_PWM)


def test_servos_stop_by_themselves_when_the_host_dies_but_not_while_it_reads_or_writes(servos: DynamixelsInUse) -> None:
    servos.hardware.close()
    assert servos.emulator.writes() == 0
    servos.enable()
    servos.hold_for(2.0)
    assert -1 not in servos.emulator.registers(Register.BUS_WATCHDOG)
    servos.hardware.write_goals(np.array([1.5, 0.0, 1.1, 0.0, 0.0, 0.0]))
    servos.emulator.run(0.6)
    stopped_rad = servos.read().position_rad[0]
    servos.emulator.run(2.0)
    assert servos.emulator.registers(Register.BUS_WATCHDOG) == [-1] * 6
    assert servos.read().position_rad[0] == pytest.approx(stopped_rad, abs=0.05)
    assert stopped_rad < 1.4
    # Closing leaves them holding without a watchdog.
    servos.hardware.close()
    assert servos.emulator.registers(Register.TORQUE_ENABLE) == [1] * 6
    assert servos.emulator.registers(Register.BUS_WATCHDOG) == [0] * 6
    # A lost port is no error.
    servos.emulator.port.unplug()
    servos.hardware.close()


def test_a_servo_that_was_stopped_alone_is_a_fault_that_can_be_reset(dynamixels: SteppedDynamixels) -> None:
    rig = DynamixelRig(dynamixels).started()
    rig.run(1.0)
    dynamixels.servo(2).set(Register.BUS_WATCHDOG, -1)
    rig.until_mode(Mode.FAULT)
    assert rig.fault_code == FaultCode.SERVO_SILENT.value
    assert rig.order(Order.RESET_FAULT).done
    rig.run(3.0)
    assert rig.mode is Mode.HOLDING
    assert -1 not in dynamixels.registers(Register.BUS_WATCHDOG)


@pytest.fixture
def bus(dynamixels: SteppedDynamixels) -> Bus:
    return dynamixels.open_bus()


def test_a_rebooted_servo_is_silent_for_a_while_and_forgets(bus: Bus, dynamixels: SteppedDynamixels) -> None:
    bus.write(3, Register.BUS_WATCHDOG, 25)
    bus.ask(3, instruction_packet(3, INST_REBOOT))
    with pytest.raises(NoReply):
        bus.ping(3, attempts=1)
    dynamixels.run(REBOOT_S + 0.01)
    assert bus.read(3, Register.BUS_WATCHDOG) == 0


def test_replies_left_on_the_line_or_late_are_not_taken_for_others(bus: Bus, dynamixels: SteppedDynamixels) -> None:
    dynamixels.port.writePort(packet(3, INST_READ, bytes([Register.ID, 0, 1, 0])))
    assert bus.read(3, Register.TORQUE_ENABLE) == 0
    assert bus.counters.discarded_bytes == len(DYNAMIXEL.status_packet(3, 0, bytes([1])))
    late, soon = (DYNAMIXEL.status_packet(3, 0, bytes([value])) for value in (1, 0))
    replies = iter([[(1.6 * LOCAL_LATENCY_S, late)], [(0.2 * LOCAL_LATENCY_S, soon)]])
    line = ScriptedPort(lambda _instruction: next(replies), DYNAMIXEL)
    bus = Bus(line, line.clock)
    with pytest.raises(NoReply):
        bus.read(3, Register.LED, attempts=1)
    assert bus.read(3, Register.TORQUE_ENABLE) == 0


def test_a_stuffed_byte_is_no_noise_and_a_hardware_error_none_of_it(bus: Bus, dynamixels: SteppedDynamixels) -> None:
    # FF FF FD FF little endian needs one.
    dynamixels.servo(3).write(Register.GOAL_POSITION, Register.GOAL_POSITION.encode(-131073))
    assert bus.read(3, Register.GOAL_POSITION) == -131073
    assert bus.counters.discarded_bytes == 0
    assert Register.PRESENT_POSITION.decode(b"\x00\xf0\xff\xff") == -4096
    bus.write(3, Register.TORQUE_ENABLE, 1)
    with pytest.raises(StartupError, match=r"servo 3 does not take 3 in register OPERATING_MODE \(11\).*error 7"):
        run_to_end(write_verified(bus, 3, Register.OPERATING_MODE, 3))
    dynamixels.servo(3).fail(0x01)
    assert bus.write(3, Register.LED, 1) == 0


def test_hardware_errors_are_the_controllers_status_flags() -> None:
    flags = {0x01: StatusFlag.VOLTAGE, 0x04: StatusFlag.TEMPERATURE, 0x08: StatusFlag.ENCODER, 0x10: StatusFlag.CURRENT}
    flags |= {0x00: StatusFlag(0), 0xC2: StatusFlag(0), 0x20: StatusFlag.OVERLOAD, 0x24: flags[4] | StatusFlag.OVERLOAD}
    assert {bits: status_of(bits) for bits in flags} == flags


# Examples of the e-manual, DYNAMIXEL Protocol 2.0: Ping, Read, Write, Sync Read and Reboot.
def test_packets_are_those_of_the_manual() -> None:
    for built, wire in (
        (packet(1, INST_PING), "fffffd00 01 0300 01 194e"),
        (packet(254, INST_PING), "fffffd00 fe 0300 01 3142"),
        (packet(1, INST_READ, bytes([132, 0, 4, 0])), "fffffd00 01 0700 02 84000400 1d15"),
        (packet(1, INST_WRITE, bytes([116, 0, 0, 2, 0, 0])), "fffffd00 01 0900 03 740000020000 ca89"),
        (packet(254, 0x82, bytes([132, 0, 4, 0, 1, 2])), "fffffd00 fe 0900 82 840004000102 cefa"),
        (packet(1, 0x08), "fffffd00 01 0300 08 2f4e"),
        (DYNAMIXEL.status_packet(1, 0, bytes([0x06, 0x04, 0x26])), "fffffd00 01 0700 55 00060426 655d"),
        (DYNAMIXEL.status_packet(2, 0, (2079).to_bytes(4, "little")), "fffffd00 02 0800 55 001f080000 babe"),
    ):
        assert built == bytes.fromhex(wire)


@given(st.integers(0, 252), st.sampled_from([1, 2, 3, 8, 0x82, 0x83]), st.binary(max_size=60))
def test_the_sdk_sends_what_is_built_here_unless_it_lacks_a_stuffed_byte_or_is_cut_off(
    servo_id: int, code: int, parameters: bytes
) -> None:
    if b"\xff\xff\xfd" not in parameters:
        line = ScriptedPort(lambda _instruction: [], DYNAMIXEL)
        assert PacketHandler(2.0).txPacket(line, instruction_packet(servo_id, code, parameters)) == COMM_SUCCESS
        (heard,) = InstructionParser(DYNAMIXEL).feed(packet(servo_id, code, parameters), 0.0)
        assert line.instructions == [heard] == [Instruction(servo_id, code, parameters)]
    for refused, words in (([116, 0, 0xFF, 0xFF, 0xFD, 0xFF], "FF FF FD"), ([0] * 1015, "1024")):
        with pytest.raises(ValueError, match=words):
            instruction_packet(1, INST_WRITE, refused)


# Bytes that have headers, and almost headers, among them.
HEADERS = st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x55, 0x12]), max_size=24).map(bytes)


@given(HEADERS, st.integers(0, 255))
def test_any_data_arrives_as_they_were_sent_and_have_no_header_but_the_packets(data: bytes, error: int) -> None:
    received = DYNAMIXEL.status_packet(3, error, data)
    assert parse_status_frames(received, (3,), len(data)) == {3: StatusFrame(3, error, data)}
    assert len(received) - received.count(STUFFED) == status_bytes(len(data))
    assert received.count(b"\xff\xff\xfd\x00") == 1


REPLIES = b"".join(DYNAMIXEL.status_packet(servo, 0, bytes([servo] * 4)) for servo in (1, 2, 3))


def test_a_damaged_byte_never_changes_a_reading_and_only_whole_replies_of_those_asked_are_believed() -> None:
    for at, flip in itertools.product(range(len(REPLIES)), (0x01, 0x80, 0xFF)):
        damaged = REPLIES[:at] + bytes([REPLIES[at] ^ flip]) + REPLIES[at + 1 :]
        frames = parse_status_frames(damaged, (1, 2, 3), 4)
        assert frames, (at, flip)
        assert all(frame == StatusFrame(servo, 0, bytes([servo] * 4)) for servo, frame in frames.items()), (at, flip)
    for name, (received, believed) in STREAMS.items():
        assert set(parse_status_frames(received, (1, 2), 2)) == believed, name


def reply(servo: int, data: bytes = b"ab") -> bytes:
    return DYNAMIXEL.status_packet(servo, 0, data)


STREAMS = {
    "noise between replies": (b"\xff\xff\x00" + reply(1) + b"\xfd\xff" + reply(2), {1, 2}),
    "another servo, and another length": (reply(5) + reply(1, b"abc") + reply(2), {2}),
    "a servo that contradicts itself": (reply(1) + reply(1, b"ac") + reply(2), {2}),
    "the host's own instruction": (packet(1, INST_WRITE, b"abc"), set()),
    **{f"cut off after {end} bytes": (reply(1)[:end], set()) for end in range(len(reply(1)))},
}
