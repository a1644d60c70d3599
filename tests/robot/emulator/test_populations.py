import pytest

from robot.emulator.arm import weight_of
from robot.emulator.feetech import FeetechServo, build_servos
from robot.emulator.populations import FACTORY, KIT, POPULATIONS, ROS2_DRIVER
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.profiles import LEROBOT
from robot.hardware.feetech.registers import Register
from tests.helpers.emulated_family import FEETECH, run
from tests.helpers.robots import nominal_calibration, so101

JOINTS = [joint.joint for joint in nominal_calibration().joints]


@pytest.fixture
def kit(start_emulator):
    return start_emulator("--population", "kit")


def set_id(bus: Bus, present: int, wanted: int) -> None:
    bus.write(present, Register.LOCK, 0)
    # Raises NoReply unless the acknowledgement bears the old id, as lerobot's setup_motors expects it.
    bus.write(present, Register.ID, wanted)
    bus.write(wanted, Register.LOCK, 1)


def test_a_kit_gets_its_ids_one_servo_at_a_time_and_keeps_them(kit):
    bus = kit.open_bus()
    for number in range(6, 0, -1):
        assert kit.command(unplug=JOINTS, plug=[number]) == {"ok": True}
        set_id(bus, 1, number)
    kit.command(plug=JOINTS)
    assert list(bus.broadcast_ping()) == [1, 2, 3, 4, 5, 6]
    assert [servo.servo_id for servo in kit.servo_bus.servos] == [1, 2, 3, 4, 5, 6]


def test_a_servo_that_shares_its_id_leaves_the_others_understood(kit):
    assert kit.command(unplug=JOINTS) == kit.command(plug=["shoulder_pan", "wrist_roll", "gripper"]) == {"ok": True}
    bus = kit.open_bus()
    kit.command(unplug=["shoulder_pan", "wrist_roll"])
    set_id(bus, 1, 6)
    kit.command(plug=["shoulder_pan", "wrist_roll"])
    assert list(bus.broadcast_ping()) == [6]
    assert list(bus.sync_read([1, 6], 56, 15)) == [6]


NOMINAL = nominal_calibration()
ELBOW, WRIST_ROLL, GRIPPER = 2, 4, 5


def servos_of(population: str) -> list[FeetechServo]:
    return build_servos(NOMINAL, [0.0] * 6, POPULATIONS[population])


def test_lerobots_servos_have_its_registers_and_an_open_eprom():
    for servo, joint in zip(servos_of("lerobot"), NOMINAL.joints, strict=True):
        expected = LEROBOT.expected(gripper=joint.servo.gripper)
        assert {register: servo.value(register) for register in expected} == expected
        assert servo.value(Register.LOCK) == 0
        servo.power_up()
        assert servo.value(Register.LOCK) == 1


def test_another_drivers_offsets_shift_what_is_read_and_not_the_arm():
    for before, after in zip(servos_of("factory"), servos_of("ros2_driver"), strict=True):
        shift = after.value(Register.HOMING_OFFSET) - before.value(Register.HOMING_OFFSET)
        assert after.present_ticks == before.present_ticks - shift
        assert after.plant.position_ticks == before.plant.position_ticks
    shifts = [each.value(Register.HOMING_OFFSET) for each in servos_of("ros2_driver")]
    assert shifts == list(ROS2_DRIVER.offset_shift_ticks)


def test_servos_found_again_read_what_they_read_before():
    start_rad = [0.1, -0.5, 0.4, 0.2, 0.1, 0.3]
    shifted = build_servos(NOMINAL, start_rad, ROS2_DRIVER, as_read=True)
    true = build_servos(NOMINAL, start_rad, FACTORY)
    assert [servo.present_ticks for servo in shifted] == [servo.present_ticks for servo in true]


def test_clones_are_of_one_other_model_but_not_of_one_firmware():
    clones = servos_of("clone")
    assert {servo.value(Register.MODEL_NUMBER) for servo in clones} == {2825}
    assert len({servo.value(Register.FIRMWARE_MINOR) for servo in clones}) > 1
    for clone in clones:
        assert (clone.value(Register.TORQUE_ENABLE), clone.value(Register.LOCK)) == (1, 0)
        run(clone, 0.5)
        assert clone.error == 0


@pytest.mark.parametrize("population", ["lerobot", "ros2_driver", "clone"])
def test_the_wrist_stops_before_its_calibrated_range_ends(population):
    wrist = servos_of(population)[WRIST_ROLL]
    wrist.plant.hand_ticks = 5000.0
    run(wrist, 3.0)
    assert wrist.plant.position_ticks == 3981.0
    wrist.plant.hand_ticks = -5000.0
    run(wrist, 3.0)
    assert wrist.plant.position_ticks == 113.0


def test_a_hand_finds_a_position_behind_the_seam():
    wrist = build_servos(NOMINAL, [0.0] * 6, KIT)[WRIST_ROLL]
    assert wrist.plant.upper_stop_ticks > 4200
    wrist.plant.hand_ticks = wrist.encoder_ticks(50)
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
