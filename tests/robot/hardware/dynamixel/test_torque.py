from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import pytest

from robot.errors import NoReply, StartupError
from robot.hardware.dynamixel.registers import FULL_PWM, OperatingMode, Register, encode
from robot.hardware.dynamixel.survey import WATCHDOG
from robot.hardware.dynamixel.torque import (
    FIRST_TORQUE,
    LOWER_S,
    OUTSIDE_LIMIT_TICKS,
    RAISE_S,
    TORQUE_ON_WITHIN_TICKS,
    ServoTorque,
)
from robot.hardware.interface import run_to_end
from tests.helpers.dynamixel import CALIBRATION, DynamixelsInUse, SteppedDynamixels

# By its weight and its gear's friction a joint sinks less than this (0.5 deg).
DROOP_TICKS = 6

IDS = (1, 2, 3, 4, 5, 6)
START = {"shoulder_pan": 0.4, "shoulder_lift": -0.6, "elbow_flex": 1.1, "wrist_flex": -0.9, "wrist_roll": 2.0}


@pytest.fixture
def dynamixels() -> SteppedDynamixels:
    return SteppedDynamixels(start_rad=START)


def torque_of(dynamixels: SteppedDynamixels) -> ServoTorque:
    """The torque of servos that were surveyed."""
    return DynamixelsInUse(dynamixels).hardware._torque


@pytest.fixture
def torque(dynamixels: SteppedDynamixels) -> ServoTorque:
    return torque_of(dynamixels)


def positions(dynamixels: SteppedDynamixels) -> list[float]:
    return [servo.plant.position_ticks for servo in dynamixels.servo_bus.servos]


def enable(torque: ServoTorque, dynamixels: SteppedDynamixels) -> dict[int, int]:
    return run_to_end(torque.enable(IDS), dynamixels.run)


def test_torque_comes_on_without_a_jump(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    before = positions(dynamixels)
    farthest = 0.0
    steps = torque.enable(IDS)
    for wait_s in steps:
        dynamixels.run(wait_s + 0.002)
        farthest = max(farthest, *(abs(now - was) for now, was in zip(positions(dynamixels), before, strict=True)))
    dynamixels.run(0.5)
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [1] * 6
    assert positions(dynamixels) == pytest.approx(before, abs=DROOP_TICKS)
    assert farthest < DROOP_TICKS


def test_the_goals_are_the_positions(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    goals = enable(torque, dynamixels)
    for joint in CALIBRATION.joints:
        assert goals[joint.servo_id] == pytest.approx(joint.ticks_from_rad(START.get(joint.joint, 0.0)), abs=1)


def test_a_servo_that_counts_turns_holds_where_it_is(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3)._turns_ticks += 2 * 4096
    before = positions(dynamixels)
    goals = enable(torque_of(dynamixels), dynamixels)
    dynamixels.run(0.5)
    assert positions(dynamixels) == pytest.approx(before, abs=DROOP_TICKS)
    assert goals[3] == pytest.approx(CALIBRATION.joints[2].ticks_from_rad(1.1), abs=1)


def limits(dynamixels: SteppedDynamixels) -> Iterator[float]:
    """The share of full duty that each servo may use."""
    for servo in dynamixels.servo_bus.servos:
        yield servo._drive.torque_permille / 1000.0


def test_torque_begins_low_and_rises_slowly(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    steps = torque.enable(IDS)
    highest_at = []
    begun_s = dynamixels.clock()
    for wait_s in steps:
        dynamixels.run(wait_s)
        if all(dynamixels.registers(Register.TORQUE_ENABLE)):
            highest_at.append((dynamixels.clock() - begun_s, max(limits(dynamixels))))
    first_s = highest_at[0][0]
    assert highest_at[0][1] <= FIRST_TORQUE + 0.001
    assert all(highest < 0.79 for at_s, highest in highest_at if at_s < first_s + 0.8 * RAISE_S)
    assert list(limits(dynamixels)) == pytest.approx([0.8] * 5 + [0.5], abs=0.001)


def test_the_gripper_is_limited_by_its_current_and_the_rest_by_duty(
    torque: ServoTorque, dynamixels: SteppedDynamixels
) -> None:
    enable(torque, dynamixels)
    modes = dynamixels.registers(Register.OPERATING_MODE)
    assert modes == [OperatingMode.EXTENDED_POSITION] * 5 + [OperatingMode.CURRENT_BASED_POSITION]
    assert dynamixels.registers(Register.GOAL_PWM) == [round(0.8 * FULL_PWM)] * 5 + [FULL_PWM]
    assert dynamixels.servo(6).value(Register.GOAL_CURRENT) == 735


def test_limits_of_the_servo_itself_are_kept(dynamixels: SteppedDynamixels) -> None:
    for servo, register, value in ((3, Register.PWM_LIMIT, 500), (6, Register.CURRENT_LIMIT, 600)):
        dynamixels.servo(servo).write(register, encode(register, value))
    dynamixels.servo(3).write(Register.GOAL_PWM, encode(Register.GOAL_PWM, 500))
    enable(torque_of(dynamixels), dynamixels)
    assert dynamixels.servo(3).value(Register.GOAL_PWM) == 500
    assert dynamixels.servo(6).value(Register.GOAL_CURRENT) == 600


def test_every_servo_that_holds_has_its_profile_and_its_watchdog(
    torque: ServoTorque, dynamixels: SteppedDynamixels
) -> None:
    enable(torque, dynamixels)
    assert dynamixels.registers(Register.BUS_WATCHDOG) == [WATCHDOG] * 6
    assert min(dynamixels.registers(Register.PROFILE_VELOCITY)) > 0
    assert min(dynamixels.registers(Register.PROFILE_ACCELERATION)) > 0


def test_a_firmware_without_watchdog_is_driven_without(dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(1).set(Register.FIRMWARE_VERSION, 37)
    enable(torque_of(dynamixels), dynamixels)
    assert dynamixels.registers(Register.BUS_WATCHDOG) == [0] + [WATCHDOG] * 5


def test_servos_that_hold_keep_their_goals(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    enable(torque, dynamixels)
    goal = dynamixels.servo(2).value(Register.GOAL_POSITION) + 40
    dynamixels.servo(2).write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, goal))
    goals = enable(torque_of(dynamixels), dynamixels)
    assert dynamixels.servo(2).value(Register.GOAL_POSITION) == goal
    assert goals[2] == pytest.approx(CALIBRATION.joints[1].ticks_from_rad(-0.6) + 40, abs=1)


def test_a_servo_that_its_watchdog_has_stopped_stays_where_it_stopped(
    torque: ServoTorque, dynamixels: SteppedDynamixels
) -> None:
    enable(torque, dynamixels)
    servo = dynamixels.servo(5)
    servo.write(Register.PROFILE_VELOCITY, encode(Register.PROFILE_VELOCITY, 10))
    goal = servo.value(Register.GOAL_POSITION) - 1500
    servo.write(Register.GOAL_POSITION, encode(Register.GOAL_POSITION, goal))
    dynamixels.run(1.0)
    assert servo.value(Register.BUS_WATCHDOG) == -1
    stopped = servo.plant.position_ticks
    assert abs(servo.present_ticks - goal) > 1000
    goals = enable(torque_of(dynamixels), dynamixels)
    dynamixels.run(0.3)
    assert servo.plant.position_ticks == pytest.approx(stopped, abs=TORQUE_ON_WITHIN_TICKS)
    assert goals[5] == pytest.approx(servo.present_ticks, abs=TORQUE_ON_WITHIN_TICKS)
    assert servo.value(Register.BUS_WATCHDOG) == WATCHDOG


def test_servos_that_are_not_named_are_only_read(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    goals = run_to_end(torque.enable([1, 3]), dynamixels.run)
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [1, 0, 1, 0, 0, 0]
    assert set(goals) == set(IDS)
    assert dynamixels.servo(4).writes == 0


def test_an_arm_that_moves_is_not_switched_on(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3).plant.push_permille = -150.0
    with pytest.raises(StartupError, match="joint elbow_flex does not come to rest: let go of the arm"):
        enable(torque, dynamixels)
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [0] * 6


def test_an_arm_far_outside_its_limits_is_not_switched_on(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    plant = dynamixels.servo(3).plant
    plant.position_ticks = plant.upper_stop_ticks = plant.upper_stop_ticks + OUTSIDE_LIMIT_TICKS
    plant.block(None)
    dynamixels.run(0.01)
    with pytest.raises(StartupError, match=r"joint elbow_flex stands at \d+ ticks, outside .*: bring it inside"):
        enable(torque, dynamixels)
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [0] * 6


def test_a_servo_that_jumps_when_torque_comes_on_is_relaxed_again(
    torque: ServoTorque, dynamixels: SteppedDynamixels
) -> None:
    servo = dynamixels.servo(4)

    def knock(wait_s: float) -> None:
        dynamixels.run(wait_s + 0.001)
        if servo.value(Register.TORQUE_ENABLE):
            servo.plant.position_ticks += 3 * TORQUE_ON_WITHIN_TICKS

    with pytest.raises(
        StartupError, match=r"joint wrist_flex moved by -?\d+ ticks while torque came on; torque is off"
    ):
        run_to_end(torque.enable(IDS), knock)
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [0] * 6


def test_a_servo_lost_while_enabling_leaves_the_others_relaxed(
    torque: ServoTorque, dynamixels: SteppedDynamixels
) -> None:
    def lose(wait_s: float) -> None:
        dynamixels.run(wait_s)
        if dynamixels.servo(5).value(Register.TORQUE_ENABLE):
            dynamixels.servo_bus.faults.offline = {6}

    with pytest.raises(StartupError, match=r"torque off could not be verified at gripper \(id 6\)"):
        run_to_end(torque.enable(IDS), lose)
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [0] * 6


def test_relaxing_lowers_the_torque_before_it_is_off(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    enable(torque, dynamixels)
    steps = torque.relax(dict.fromkeys(IDS, 0.4))
    shares = []
    begun_s = dynamixels.clock()
    for wait_s in steps:
        dynamixels.run(wait_s)
        shares.append(next(limits(dynamixels)))
        if not dynamixels.servo(1).value(Register.TORQUE_ENABLE):
            break
    assert shares[1] <= 0.4
    assert shares == sorted(shares, reverse=True)
    assert shares[-2] < 0.02
    assert dynamixels.clock() - begun_s == pytest.approx(LOWER_S, abs=0.1)
    assert run_to_end(steps, dynamixels.run) == []
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [0] * 6


def test_a_relaxed_arm_has_its_full_torque_limits_again(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    enable(torque, dynamixels)
    run_to_end(torque.relax(torque.full_shares()), dynamixels.run)
    assert dynamixels.registers(Register.GOAL_PWM) == [round(0.8 * FULL_PWM)] * 5 + [FULL_PWM]


def test_an_emergency_stop_that_no_servo_heard_at_first_is_repeated(
    torque: ServoTorque, dynamixels: SteppedDynamixels
) -> None:
    enable(torque, dynamixels)
    steps = torque.emergency_stop()
    dynamixels.servo_bus.faults.lose_instruction = 1.0
    next(steps)
    dynamixels.servo_bus.faults.lose_instruction = 0.0
    next(steps)
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [0] * 6


def test_no_step_of_enabling_takes_more_than_one_transaction(dynamixels: SteppedDynamixels) -> None:
    hardware = DynamixelsInUse(dynamixels).hardware
    sent = []
    for wait_s in hardware._torque.enable(IDS):
        dynamixels.run(wait_s)
        sent.append(hardware.bus.counters.sent)
    # Torque limits are two sync writes: duties, and the gripper's current.
    assert max(after - before for before, after in pairwise(sent)) <= 2


def test_an_overload_is_cleared_by_a_reboot_and_the_servo_holds_again(
    torque: ServoTorque, dynamixels: SteppedDynamixels
) -> None:
    enable(torque, dynamixels)
    servo = dynamixels.servo(3)
    servo.fail(0x20)
    assert servo.value(Register.TORQUE_ENABLE) == 0
    before = positions(dynamixels)
    run_to_end(torque.clear_errors(3, hold=True), dynamixels.run)
    dynamixels.run(0.2)
    assert servo.value(Register.HARDWARE_ERROR_STATUS) == 0
    assert servo.value(Register.TORQUE_ENABLE) == 1
    assert servo.value(Register.BUS_WATCHDOG) == WATCHDOG
    assert servo.value(Register.GOAL_PWM) == round(0.8 * FULL_PWM)
    assert positions(dynamixels) == pytest.approx(before, abs=DROOP_TICKS)


def test_a_servo_that_does_not_come_back_from_its_reboot_is_told(
    torque: ServoTorque, dynamixels: SteppedDynamixels
) -> None:
    dynamixels.servo_bus.faults.offline = {3}
    with pytest.raises(NoReply):
        run_to_end(torque.clear_errors(3, hold=True), dynamixels.run)


def test_watchdogs_are_disarmed_at_once(torque: ServoTorque, dynamixels: SteppedDynamixels) -> None:
    enable(torque, dynamixels)
    torque.disarm_watchdogs()
    assert dynamixels.registers(Register.BUS_WATCHDOG) == [0] * 6
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [1] * 6
