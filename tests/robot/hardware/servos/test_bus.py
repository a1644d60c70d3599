"""Transactions on the bus of servos, and the survey of an arm."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robot.errors import NoReply, StartupError
from robot.hardware.interface import run_to_end
from robot.hardware.servos.bus import STEP_ATTEMPTS, read, read_registers, write_verified
from robot.hardware.servos.family import ServoFound
from robot.hardware.servos.registers import RegisterTable
from robot.hardware.servos.survey import calibration_refusal, change_refusal, survey
from tests.helpers.servo_families import DYNAMIXEL, FEETECH, IDS, Family


def test_registers_and_blocks_are_written_and_read_and_a_servo_that_is_gone_is_named(family: Family) -> None:
    emulator = family.emulator()
    bus, registers = emulator.open_bus(), family.registers.Register
    goal, position = registers.GOAL_POSITION, registers.PRESENT_POSITION
    bus.write(3, goal, 700)
    assert [bus.read(servo, goal) for servo in (3, 4)] == [700, 0]
    sent = bus.counters.sent
    bus.sync_write(goal, {servo: goal.encode(100 * servo) for servo in IDS})
    assert bus.counters.sent - sent == 1
    assert [bus.read(servo, goal) for servo in IDS] == [100, 200, 300, 400, 500, 600]
    for data in ({}, {1: b"\x01", 2: b"\x01\x02"}):
        with pytest.raises(ValueError, match="one length"):
            bus.sync_write(goal, data)
    sent = bus.counters.sent
    frames = bus.sync_read(IDS, position, position.size)
    assert bus.counters.sent - sent == 1
    assert list(frames) == list(IDS)
    assert position.decode(frames[3].data) == bus.read(3, position)
    emulator.servo_bus.faults.offline = {3}
    with pytest.raises(NoReply, match="servo 3 ") as silent:
        bus.read(3, registers.TORQUE_ENABLE)
    assert isinstance(silent.value, TimeoutError)
    assert bus.counters.timeouts > 0
    assert sorted(bus.sync_read(IDS, position, position.size)) == [1, 2, 4, 5, 6]
    emulator.servo_bus.faults.offline = set()
    assert bus.read(3, registers.TORQUE_ENABLE) == 0


def test_a_sequence_asks_again_when_a_reply_is_lost_and_gives_up_after_some_attempts(family: Family) -> None:
    emulator = family.emulator()
    bus, table = emulator.open_bus(), family.driver.registers
    emulator.servo_bus.faults.drop = 0.4
    values = [run_to_end(read(bus, servo, family.registers.Register.MODEL_NUMBER), emulator.run) for servo in IDS]
    assert values == family.values(emulator, "MODEL_NUMBER")
    assert bus.counters.retries == bus.counters.timeouts > 0
    emulator.servo_bus.faults.offline = {3}
    for steps in (read(bus, 3, table.torque_enable), read_registers(bus, 3, table.block(table.goal_position))):
        sent = bus.counters.sent
        with pytest.raises(NoReply, match=f"{STEP_ATTEMPTS} instructions"):
            run_to_end(steps, emulator.run)
        assert bus.counters.sent - sent == STEP_ATTEMPTS


def test_a_write_is_verified_though_its_acknowledgement_is_lost(family: Family) -> None:
    emulator = family.emulator()
    bus, registers = emulator.open_bus(), family.registers.Register
    # Each step is one transaction.
    assert [bus.counters.sent for _ in write_verified(bus, 3, registers.GOAL_POSITION, 300)] == [0, 1]
    emulator.servo_bus.faults.drop = 0.3
    for servo in IDS:
        run_to_end(write_verified(bus, servo, registers.GOAL_POSITION, 300 + servo), emulator.run)
    assert family.values(emulator, "GOAL_POSITION") == [301, 302, 303, 304, 305, 306]
    with pytest.raises(StartupError, match=r"servo 1 does not take 5 in register PRESENT_TEMPERATURE \(\d+\)"):
        run_to_end(write_verified(bus, 1, registers.PRESENT_TEMPERATURE, 5), emulator.run)


Several = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def table(family: Family) -> RegisterTable:
    return family.driver.registers


@Several
@given(data=st.data())
def test_a_value_is_read_as_it_was_written_or_refused_by_name(table: RegisterTable, data: st.DataObject) -> None:
    register = data.draw(st.sampled_from(list(table.registers)))
    lowest, highest = register.value_range
    value = data.draw(st.integers(lowest, highest))
    written = register.encode(value)
    assert (len(written), register.decode(written)) == (register.size, value)
    value = data.draw(st.one_of(st.integers(min_value=highest + 1), st.integers(max_value=lowest - 1)))
    with pytest.raises(ValueError, match=f"{register.name} .* not {value}"):
        register.encode(value)


def test_no_two_registers_overlap_and_data_of_the_wrong_length_is_refused(family: Family, table: RegisterTable) -> None:
    ordered = sorted(family.registers.Register)
    assert ordered == list(table.registers)
    # Two at one address would be one, with two names.
    assert len(ordered) == len(family.registers.Register.__members__)
    assert all(first + first.size <= second for first, second in pairwise(ordered))
    size = table.goal_position.size
    with pytest.raises(ValueError, match=f"GOAL_POSITION has {size} bytes, not 1"):
        table.goal_position.decode(b"\x01")
    with pytest.raises(ValueError, match=f"GOAL_POSITION has {size} bytes, not 9"):
        table.block(table.goal_position).parse(bytes(9))


@Several
@given(data=st.data())
def test_a_block_has_the_registers_from_the_first_to_the_last(table: RegisterTable, data: st.DataObject) -> None:
    ordered = list(table.registers)
    first, last = sorted(data.draw(st.tuples(st.sampled_from(ordered), st.sampled_from(ordered))))
    block = table.block(first, last)
    values = {register: data.draw(st.integers(*register.value_range)) for register in block.registers}
    memory = bytearray(block.length)
    for register, value in values.items():
        at = register - block.address
        memory[at : at + register.size] = register.encode(value)
    assert (block.registers[0], block.registers[-1]) == (first, last)
    assert block.parse(bytes(memory)) == values


@pytest.fixture
def emulator(family: Family) -> Any:
    return family.emulator()


def surveyed(family: Family, emulator: Any, *, simulated: bool = False) -> dict[int, ServoFound]:
    return run_to_end(survey(family.driver, emulator.open_bus(), family.servo_map, simulated=simulated))


def test_servos_are_found_as_they_are(family: Family, emulator: Any) -> None:
    family.put(emulator, 3, "TORQUE_ENABLE", 1)
    found = surveyed(family, emulator)
    assert [each.values[family.registers.Register.TORQUE_ENABLE] for each in found.values()] == [0, 0, 1, 0, 0, 0]
    for joint in family.calibration.joints:
        servo = found[joint.servo_id]
        assert family.driver.position_limits_ticks(servo.values) == (joint.range_min, joint.range_max)
        assert servo.values[family.registers.Register.HOMING_OFFSET] == joint.homing_offset
        assert servo.warnings == ()


def test_servos_that_do_not_answer_are_named_with_the_likely_cause(family: Family, emulator: Any) -> None:
    for offline, simulated, sentence in (
        ({3}, True, r"^no answer from elbow_flex \(id 3\)$"),
        (set(IDS), True, "^no servo answers$"),
        ({2, 5}, False, r"no answer from shoulder_lift \(id 2\), wrist_roll \(id 5\): check the cable"),
        (set(IDS), False, "no servo answers: is the arm powered"),
    ):
        emulator.servo_bus.faults.offline = offline
        with pytest.raises(StartupError, match=sentence):
            surveyed(family, emulator, simulated=simulated)
    emulator.servo_bus.faults.offline = set()
    steps = survey(family.driver, emulator.open_bus(), family.servo_map)
    for _ in range(len(IDS) + 2):
        next(steps)
    emulator.servo_bus.faults.offline = set(IDS)
    with pytest.raises(NoReply):
        run_to_end(steps)


def test_a_homing_offset_that_another_program_wrote_is_refused_with_the_remedy(family: Family, emulator: Any) -> None:
    servos, before = family.servo_map, surveyed(family, emulator)
    servos.found = before
    assert calibration_refusal(family.driver, servos) == ""
    assert change_refusal(family.driver, servos, before, offsets_known=False) == ""
    calibrated = family.calibration.joints[2].homing_offset
    family.put(emulator, 3, "HOMING_OFFSET", calibrated - 85)
    servos.found = after = surveyed(family, emulator)
    reason = calibration_refusal(family.driver, servos)
    assert f"elbow_flex (id 3) by 7.5 deg ({calibrated - 85} instead of {calibrated} ticks)" in reason
    assert "calibrate the arm again" in reason
    assert family.driver.recalibrate_advice in reason
    # So is one that has changed since the start, but not the way back to the calibration in use.
    assert "elbow_flex (id 3) (offset" in change_refusal(family.driver, servos, before, offsets_known=False)
    servos.found = before
    assert change_refusal(family.driver, servos, after, offsets_known=True) == ""


@pytest.mark.parametrize(
    ("low", "high", "refused"),
    [
        *((ticks, ticks, True) for ticks in (-60, 60)),
        *((low, high, False) for low in (60, None) for high in (-60, None)),
        (60, 0, False),
    ],
)
def test_shifted_limits_are_refused_others_may_differ(low: int | None, high: int | None, refused: bool) -> None:
    emulator, joint = FEETECH.emulator(), FEETECH.calibration.joints[2]
    lowest = 0 if low is None else joint.range_min + low
    highest = 4095 if high is None else joint.range_max + high
    FEETECH.put(emulator, 3, "MIN_ANGLE_LIMIT", lowest)
    FEETECH.put(emulator, 3, "MAX_ANGLE_LIMIT", highest)
    servos = FEETECH.servo_map
    servos.found = surveyed(FEETECH, emulator)
    reason = calibration_refusal(FEETECH.driver, servos)
    assert (f"elbow_flex (id 3) {lowest} to {highest} instead of" in reason and "--write-back" in reason) is refused


def test_a_servo_that_was_turned_many_times_is_refused() -> None:
    emulator = DYNAMIXEL.emulator()
    emulator.servo(3)._turns_ticks += 32 * 4096
    with pytest.raises(StartupError, match=r"elbow_flex \(id 3\) is at -\d+ ticks, more than 16 turns away"):
        surveyed(DYNAMIXEL, emulator)
