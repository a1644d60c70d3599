import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.feetech import FACTORY_EPROM, MEMORY_BYTES, FeetechServo
from robot.emulator.plant import Plant
from robot.hardware.feetech.family import PHASE_MULTI_TURN
from robot.hardware.feetech.registers import Area, Register
from robot.hardware.interface import StatusFlag
from tests.helpers.emulated_family import FEETECH, run


def servo_at(ticks=2048.0, limits=(800, 3300), offset=0):
    eprom = {
        Register.ID: 4,
        Register.MIN_ANGLE_LIMIT: limits[0],
        Register.MAX_ANGLE_LIMIT: limits[1],
        Register.HOMING_OFFSET: offset,
    }
    return FeetechServo(Plant(ticks + offset, 0.0, 4095.0), eprom)


put, get = FEETECH.write, FEETECH.read


@pytest.mark.parametrize(("goal", "reached"), [(100, 800), (4000, 3300)])
def test_a_goal_beyond_the_angle_limits_ends_at_the_limit(goal, reached):
    servo = servo_at()
    put(servo, "GOAL_POSITION", goal)
    put(servo, "TORQUE_ENABLE", 1)
    run(servo, 2.0)
    assert servo.present_ticks == reached
    assert get(servo, "GOAL_POSITION") == goal
    assert get(servo, "GOAL_POSITION_ECHO") == reached


def holding_servo(**registers):
    servo = servo_at()
    for name, value in registers.items():
        put(servo, name, value)
    servo.hold()
    return servo


def test_a_joint_that_is_stuck_overloads_and_goes_weak_until_torque_is_off():
    servo = holding_servo()
    servo.plant.block(2060)
    put(servo, "GOAL_POSITION", 2600)
    run(servo, 1.9)
    assert servo.error == 0
    assert get(servo, "PRESENT_LOAD") == 1000
    run(servo, 0.3)
    assert servo.error == get(servo, "STATUS") == StatusFlag.OVERLOAD
    assert get(servo, "PRESENT_LOAD") == 200
    servo.plant.block(None)
    put(servo, "TORQUE_ENABLE", 0)
    servo.hold()
    run(servo, 0.1)
    assert servo.error == 0


@pytest.mark.parametrize(
    ("registers", "error"),
    [({"TORQUE_LIMIT": 500}, 0), ({"PROTECTION_CURRENT": 100, "OVERLOAD_TORQUE": 200}, StatusFlag.CURRENT)],
)
def test_a_stuck_joint_overloads_above_its_torque_and_is_cut_off_above_its_current(registers, error):
    servo = holding_servo(**registers)
    servo.plant.block(2060)
    put(servo, "GOAL_POSITION", 2600)
    run(servo, 5.0)
    assert servo.error == error
    assert (get(servo, "PRESENT_CURRENT") == 0) is (error != 0)


@pytest.mark.parametrize(("unloading", "reached"), [(44, 2048), (0, 2200)])
def test_a_hot_servo_lets_go_if_it_is_set_to_and_holds_again_when_cool(unloading, reached):
    servo = holding_servo(UNLOADING_CONDITION=unloading)
    servo.motor.temperature_c = 75.0
    run(servo, 0.05)
    assert servo.error == StatusFlag.TEMPERATURE
    put(servo, "GOAL_POSITION", 2200)
    run(servo, 0.3)
    assert servo.present_ticks == reached
    servo.motor.temperature_c = 50.0
    run(servo, 1.0)
    assert servo.present_ticks == 2200


def test_a_wrong_supply_takes_no_torque():
    servo = holding_servo()
    servo.voltage_v = 12.0
    put(servo, "GOAL_POSITION", 2200)
    run(servo, 1.0)
    assert (servo.error, servo.present_ticks) == (StatusFlag.VOLTAGE, 2200)


def test_a_servo_may_power_up_holding_where_it_is():
    servo = servo_at(2500.0, offset=-100)
    servo.powers_up_holding = True
    servo.power_up()
    run(servo, 1.0)
    assert get(servo, "TORQUE_ENABLE") == 1
    assert servo.present_ticks == get(servo, "GOAL_POSITION") == 2500


@pytest.mark.parametrize("value", [2, 3, 255])
def test_only_one_is_torque_on(value):
    servo = servo_at()
    put(servo, "TORQUE_ENABLE", value)
    run(servo, 0.5)
    assert servo.present_ticks == 2048


@given(st.integers(0, 255), st.binary(max_size=100))
def test_no_write_changes_what_is_read_only_or_adds_memory(address, data):
    servo = FeetechServo(Plant(2048.0, 0.0, 4095.0), {})
    read_only = [register for register in Register if register.area is Area.READ_ONLY]
    before = {register: servo.value(register) for register in read_only}
    servo.write(address, data)
    assert {register: servo.value(register) for register in read_only} == before
    assert servo.read(MEMORY_BYTES, 200) == bytes(200)


@pytest.mark.parametrize(("lock", "kept"), [(1, 32), (0, 16)])
def test_eprom_outlives_a_power_cut_only_when_written_unlocked(lock, kept):
    servo = servo_at()
    put(servo, "LOCK", lock)
    put(servo, "P_GAIN", 16)
    assert servo.value(Register.P_GAIN) == 16
    servo.power_up()
    assert servo.value(Register.P_GAIN) == kept


def test_without_a_backup_a_restore_brings_back_what_was_there_at_first_except_the_id():
    servo = servo_at()
    put(servo, "LOCK", 0)
    put(servo, "P_GAIN", 16)
    put(servo, "ID", 9)
    servo.restore()
    assert (servo.value(Register.P_GAIN), servo.value(Register.ID)) == (FACTORY_EPROM[Register.P_GAIN], 9)


def turning(position: float, offset: int = 0, phase: int = 12) -> FeetechServo:
    return FeetechServo(Plant(position, -4000.0, 8000.0), {Register.HOMING_OFFSET: offset, Register.PHASE: phase})


def test_the_position_begins_again_after_a_turn_unless_the_servo_counts_turns():
    places = ((4090.0, 0), (4100.0, 0), (-3.0, 0), (10.0, 100), (4090.0, -100))
    assert [turning(*place).present_ticks for place in places] == [4090, 4, 4093, 4006, 94]
    counting = [turning(*place, 12 | PHASE_MULTI_TURN).present_ticks for place in ((4100.0, 0), (10.0, 100))]
    assert counting == [4100, -90]


@pytest.mark.parametrize("goal", [4000, 20])
def test_a_goal_across_the_seam_is_approached_the_long_way_round(goal):
    servo = turning(4080.0)
    put(servo, "GOAL_POSITION", goal)
    put(servo, "TORQUE_ENABLE", 1)
    run(servo, 4.0)
    assert servo.plant.position_ticks == pytest.approx(goal, abs=1.0)


def test_a_joint_pushed_across_the_seam_runs_on_towards_its_goal_in_the_next_turn():
    servo = turning(4090.0)
    servo.hold()
    run(servo, 0.2)
    servo.plant.position_ticks = 4100.0
    run(servo, 5.0)
    assert servo.plant.position_ticks == servo.plant.upper_stop_ticks
