"""Feetech servos, and the settings that they come with."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.arm import weight_of
from robot.emulator.feetech import MEMORY_BYTES, FeetechServo, build_servos
from robot.emulator.plant import Plant
from robot.emulator.populations import FACTORY, KIT, POPULATIONS, ROS2_DRIVER
from robot.hardware.feetech.family import PHASE_MULTI_TURN
from robot.hardware.feetech.profiles import LEROBOT
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import StatusFlag
from robot.hardware.servos.registers import Area
from tests.helpers.robots import nominal_calibration, so101
from tests.helpers.servo_families import FEETECH, run


def servo_at(ticks=2048.0, limits=(800, 3300), offset=0):
    eprom = {
        Register.ID: 4,
        Register.MIN_ANGLE_LIMIT: limits[0],
        Register.MAX_ANGLE_LIMIT: limits[1],
        Register.HOMING_OFFSET: offset,
    }
    return FeetechServo(Plant(ticks + offset, 0.0, 4095.0), eprom)


put, get = FEETECH.write, FEETECH.read


def test_a_goal_beyond_the_angle_limits_ends_at_the_limit_and_a_servo_may_power_up_holding_where_it_is():
    for goal, reached in ((100, 800), (4000, 3300)):
        servo = servo_at()
        put(servo, "GOAL_POSITION", goal)
        put(servo, "TORQUE_ENABLE", 1)
        run(servo, 2.0)
        assert servo.present_ticks == reached
        assert get(servo, "GOAL_POSITION") == goal
        assert get(servo, "GOAL_POSITION_ECHO") == reached
    servo = servo_at(2500.0, offset=-100)
    servo.powers_up_holding = True
    servo.power_up()
    run(servo, 1.0)
    assert get(servo, "TORQUE_ENABLE") == 1
    assert servo.present_ticks == get(servo, "GOAL_POSITION") == 2500


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


def test_only_one_is_torque_on_and_a_wrong_supply_takes_none():
    servo = servo_at()
    for value, reached in ((2, 2048), (3, 2048), (255, 2048), (1, 2200)):
        put(servo, "TORQUE_ENABLE", value)
        put(servo, "GOAL_POSITION", 2200)
        servo.voltage_v = 12.0
        run(servo, 1.0)
        assert (servo.error, servo.present_ticks) == (StatusFlag.VOLTAGE, reached), value


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


def turning(position: float, offset: int = 0, phase: int = 12) -> FeetechServo:
    return FeetechServo(Plant(position, -4000.0, 8000.0), {Register.HOMING_OFFSET: offset, Register.PHASE: phase})


def test_the_position_begins_again_after_a_turn_unless_the_servo_counts_turns():
    places = ((4090.0, 0), (4100.0, 0), (-3.0, 0), (10.0, 100), (4090.0, -100))
    assert [turning(*place).present_ticks for place in places] == [4090, 4, 4093, 4006, 94]
    counting = [turning(*place, 12 | PHASE_MULTI_TURN).present_ticks for place in ((4100.0, 0), (10.0, 100))]
    assert counting == [4100, -90]


def test_a_goal_across_the_seam_is_approached_the_long_way_round_and_one_pushed_across_it_in_the_next_turn():
    for goal in (4000, 20):
        servo = turning(4080.0)
        put(servo, "GOAL_POSITION", goal)
        put(servo, "TORQUE_ENABLE", 1)
        run(servo, 4.0)
        assert servo.plant.position_ticks == pytest.approx(goal, abs=1.0)
    servo = turning(4090.0)
    servo.hold()
    run(servo, 0.2)
    servo.plant.position_ticks = 4100.0
    run(servo, 5.0)
    assert servo.plant.position_ticks == servo.plant.upper_stop_ticks


JOINTS = [joint.joint for joint in nominal_calibration().joints]


def test_a_servo_that_shares_its_id_leaves_the_others_understood(start_emulator):
    kit = start_emulator("--population", "kit")
    assert kit.command(unplug=JOINTS) == kit.command(plug=["gripper"]) == {"ok": True}
    bus = kit.open_bus()
    bus.write(1, Register.LOCK, 0)
    # Raises NoReply unless the acknowledgement bears the old id, as lerobot's setup_motors expects it.
    bus.write(1, Register.ID, 6)
    kit.command(plug=["shoulder_pan", "wrist_roll"])
    assert list(bus.broadcast_ping()) == [6]
    assert list(bus.sync_read([1, 6], 56, 15)) == [6]


NOMINAL = nominal_calibration()
ELBOW, WRIST_ROLL = 2, 4


def servos_of(population: str) -> list[FeetechServo]:
    return build_servos(NOMINAL, [0.0] * 6, POPULATIONS[population])


def test_lerobots_servos_have_its_registers_and_an_open_eprom_and_clones_another_model():
    for servo, joint in zip(servos_of("lerobot"), NOMINAL.joints, strict=True):
        expected = LEROBOT.expected(gripper=joint.servo.gripper)
        assert {register: servo.value(register) for register in expected} == expected
        assert servo.value(Register.LOCK) == 0
        servo.power_up()
        assert servo.value(Register.LOCK) == 1
    clones = servos_of("clone")
    assert {servo.value(Register.MODEL_NUMBER) for servo in clones} == {2825}
    assert len({servo.value(Register.FIRMWARE_MINOR) for servo in clones}) > 1
    for clone in clones:
        assert (clone.value(Register.TORQUE_ENABLE), clone.value(Register.LOCK)) == (1, 0)
        run(clone, 0.5)
        assert clone.error == 0


def test_another_drivers_offsets_shift_what_is_read_and_not_the_arm_unless_the_servos_are_found_again():
    for before, after in zip(servos_of("factory"), servos_of("ros2_driver"), strict=True):
        shift = after.value(Register.HOMING_OFFSET) - before.value(Register.HOMING_OFFSET)
        assert after.present_ticks == before.present_ticks - shift
        assert after.plant.position_ticks == before.plant.position_ticks
    shifts = [each.value(Register.HOMING_OFFSET) for each in servos_of("ros2_driver")]
    assert shifts == list(ROS2_DRIVER.offset_shift_ticks)
    start_rad = [0.1, -0.5, 0.4, 0.2, 0.1, 0.3]
    again, true = build_servos(NOMINAL, start_rad, ROS2_DRIVER, as_read=True), build_servos(NOMINAL, start_rad, FACTORY)
    assert [servo.present_ticks for servo in again] == [servo.present_ticks for servo in true]


def test_the_wrist_stops_before_its_calibrated_range_ends_and_a_hand_finds_a_position_behind_the_seam():
    for population in ("lerobot", "ros2_driver", "clone"):
        wrist = servos_of(population)[WRIST_ROLL]
        for hand, stop in ((5000.0, 3981.0), (-5000.0, 113.0)):
            wrist.plant.hand_ticks = hand
            run(wrist, 3.0)
            assert wrist.plant.position_ticks == stop, population
    wrist = build_servos(NOMINAL, [0.0] * 6, KIT)[WRIST_ROLL]
    assert wrist.plant.upper_stop_ticks > 4200
    wrist.plant.position_ticks = 4000.0
    wrist.plant.hand_ticks = wrist.encoder_ticks(50)
    run(wrist, 1.0)
    assert (wrist.plant.position_ticks, wrist.present_ticks) == (4146.0, 50)


def test_a_mirrored_horn_turns_the_weight_and_not_what_the_servo_says():
    servos = build_servos(NOMINAL, [0.3] * 6)
    weigh = weight_of(so101(), NOMINAL, servos)
    weigh()
    elbow = servos[ELBOW]
    registers, load = elbow.read(0, 40), elbow.plant.gravity_permille
    true_ticks = elbow.joint_ticks
    elbow.mirror()
    weigh()
    assert elbow.read(0, 40) == registers
    assert elbow.joint_ticks == pytest.approx(true_ticks)
    assert elbow.plant.gravity_permille == pytest.approx(-load)
    elbow.plant.position_ticks += 100.0
    weigh()
    assert elbow.joint_ticks == pytest.approx(true_ticks - 100.0)


def test_a_loaded_shoulder_droops_by_20_to_30_ticks_with_lerobots_gain():
    start_rad = [0.0, 1.3, -1.3, 0.0, 0.0, 0.0]
    droops = []
    for population in ("factory", "lerobot"):
        servos = build_servos(NOMINAL, start_rad, POPULATIONS[population])
        weight_of(so101(), NOMINAL, servos)()
        shoulder = servos[1]
        goal = shoulder.present_ticks
        # With a payload it is 1.5 kg at 10 cm.
        shoulder.plant.gravity_permille *= 1.47 * 130.0 / abs(shoulder.plant.gravity_permille)
        FEETECH.write(shoulder, "GOAL_POSITION", goal)
        FEETECH.write(shoulder, "TORQUE_ENABLE", 1)
        run(shoulder, 2.0)
        droops.append(abs(goal - shoulder.plant.position_ticks))
    assert 20.0 < droops[1] < 30.0
    assert droops[1] == pytest.approx(2.0 * droops[0], rel=0.02)
