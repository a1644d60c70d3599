"""Orders: the causes that keep a fault from being reset; the rest is shown by the supervisor's tests."""

from dataclasses import replace
from pathlib import Path

import pytest

from harness.server import read_write_log
from robot.calibration import Calibration
from robot.emulator.populations import POPULATIONS
from robot.errors import StartupError
from robot.faults import Fault, FaultCode
from robot.hardware.config import EmulatedConfig, SerialConfig
from robot.hardware.feetech.profiles import LEROBOT
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import StatusFlag
from robot.messages import END_TIMEOUT_S, EmergencyPolicy, GuardLimits, Mode, Order, Outcome, Shutdown
from tests.helpers.arm_rig import CALIBRATION, ArmRig, run
from tests.helpers.emulator import SteppedEmulator
from tests.helpers.motions import smooth_move

IDS = [joint.servo_id for joint in CALIBRATION.joints]


def relaxed(emulator: SteppedEmulator, **settings: object) -> ArmRig:
    made = ArmRig(emulator, start_enabled=False, **settings)
    made.until_mode(Mode.RELAXED)
    return made


@pytest.fixture
def rig(emulator: SteppedEmulator) -> ArmRig:
    return relaxed(emulator)


def latch(rig: ArmRig, code: FaultCode) -> None:
    """Have the arm in a fault that it found some time ago."""
    rig.supervisor.arm.controller.latch(Fault(code, "it was found"))


def test_the_guards_bear_what_is_configured(emulator: SteppedEmulator) -> None:
    rig = ArmRig(emulator, guard_limits=GuardLimits(min_voltage_v=9.0, torque_limit=0.4))
    rig.until_mode(Mode.FAULT)
    assert "it needs 9 V at least" in rig.supervisor.fault.message
    assert rig.bus.read(1, Register.TORQUE_LIMIT) == 400


def test_a_bus_that_waits_long_for_replies_is_silent_after_several_of_them_only(emulator: SteppedEmulator) -> None:
    emulator.port.latency_s = 0.1
    rig = ArmRig(emulator).started()
    emulator.command(offline=IDS)
    rig.run(0.9)
    assert rig.mode is Mode.HOLDING
    rig.run(0.2)
    assert rig.fault_code == FaultCode.BUS_SILENT.value


@pytest.mark.parametrize(
    ("code", "temperature_c", "resets"),
    [
        (FaultCode.OVERHEATED, 54, True),
        (FaultCode.OVERHEATED, 55, False),
        (FaultCode.STALLED, 64, True),
        (FaultCode.STALLED, 65, False),
    ],
)
def test_a_hot_arm_must_cool_down_before_its_fault_is_reset(
    emulator: SteppedEmulator, rig: ArmRig, code: FaultCode, temperature_c: int, resets: bool
) -> None:
    emulator.command(temperature=dict.fromkeys(map(str, IDS), temperature_c))
    rig.run(0.05)
    latch(rig, code)
    answer = rig.order(Order.RESET_FAULT)
    assert answer.done is resets
    assert str(temperature_c) in answer.message or resets


@pytest.mark.parametrize(
    ("settings", "remedy"),
    [({}, ": switch the servos' supply off and on"), ({"hardware": EmulatedConfig(CALIBRATION)}, "")],
    ids=["real", "simulated"],
)
def test_a_servo_that_still_complains_keeps_the_fault_and_an_overload_of_a_real_arm_asks_for_a_power_cut(
    emulator: SteppedEmulator, settings: dict[str, EmulatedConfig], remedy: str
) -> None:
    rig = relaxed(emulator, **settings)
    latch(rig, FaultCode.STALLED)
    for flag in (StatusFlag.ENCODER, StatusFlag.TEMPERATURE, StatusFlag.CURRENT, StatusFlag.OVERLOAD):
        emulator.command(status={"4": int(flag)})
        rig.run(0.05)
        complaint = f"{str(flag.name).lower()}{remedy if flag is StatusFlag.OVERLOAD else ''}"
        assert rig.refused(Order.RESET_FAULT).endswith(f"wrist_flex (id 4) still complains of {complaint}")
    # The supply has a fault of its own.
    emulator.command(status={"4": int(StatusFlag.VOLTAGE | StatusFlag.ANGLE)})
    rig.run(0.05)
    assert rig.order(Order.RESET_FAULT).message == "the arm is relaxed"


def test_the_reset_of_a_relaxed_arm_switches_off_what_is_driven_all_the_same(rig: ArmRig) -> None:
    rig.bus.write(3, Register.TORQUE_ENABLE, 1)
    latch(rig, FaultCode.STALLED)
    assert rig.order(Order.RESET_FAULT).done
    assert rig.torque() == [0] * len(IDS)


def test_a_reset_lets_no_joint_go_that_is_not_overloaded(emulator: SteppedEmulator) -> None:
    rig = ArmRig(emulator).started()
    emulator.command(status={"4": int(StatusFlag.VOLTAGE)})
    rig.run(0.05)
    latch(rig, FaultCode.STALLED)
    reset = rig.begin(Order.RESET_FAULT)
    rig.until(lambda: rig.answer(reset) is not None or rig.torque() != [1] * len(IDS))
    assert (rig.mode, rig.torque()) == (Mode.HOLDING, [1] * len(IDS))


def test_an_emergency_stop_that_holds_cuts_the_torque_of_a_relaxed_arm_and_leaves_one_that_is_not_checked_yet(
    emulator: SteppedEmulator,
) -> None:
    rig = relaxed(emulator, on_emergency_stop=EmergencyPolicy.HOLD)
    assert rig.order(Order.EMERGENCY_STOP).message == "torque is off at every servo"
    rig = ArmRig(emulator, on_emergency_stop=EmergencyPolicy.HOLD)
    rig.bus.write(3, Register.TORQUE_ENABLE, 1)
    assert rig.order(Order.EMERGENCY_STOP).message == "the arm holds where it is"
    assert rig.torque()[2] == 1


def test_without_a_fault_there_is_nothing_to_reset_and_an_enabled_arm_is_left_alone(rig: ArmRig) -> None:
    assert rig.order(Order.RESET_FAULT).message == "there is no fault"
    rig.order(Order.ENABLE)
    assert rig.order(Order.ENABLE).message == "the arm is enabled already"


SHIFTED_TICKS = -85


def calibrated(emulator: SteppedEmulator, **settings: object) -> ArmRig:
    """An arm whose calibration says which homing offsets its servos should have, as a file does."""
    return ArmRig(emulator, hardware=SerialConfig(replace(CALIBRATION, offsets_known=True), "/dev/arm"), **settings)


def test_an_arm_whose_zero_has_shifted_is_read_but_not_switched_on_nor_dropped(emulator: SteppedEmulator) -> None:
    emulator.open_bus().write(3, Register.HOMING_OFFSET, SHIFTED_TICKS)
    rig = calibrated(emulator)
    rig.until_mode(Mode.FAULT)
    assert rig.fault_code == FaultCode.STARTUP_REFUSED.value
    assert "the zero has shifted" in str(rig.supervisor.fault)
    assert rig.torque() == [0] * len(IDS)
    assert rig.state.position_rad is not None
    rig.order(Order.RESET_FAULT)
    assert "--write-back" in rig.refused(Order.ENABLE)
    assert rig.torque() == [0] * len(IDS)
    rig.bus.write(3, Register.HOMING_OFFSET, 0)
    rig = calibrated(emulator).started()
    rig.bus.write(3, Register.HOMING_OFFSET, SHIFTED_TICKS)
    again = calibrated(emulator)
    again.until_mode(Mode.FAULT)
    assert "the zero has shifted" in str(again.supervisor.fault)
    assert again.torque() == [1] * len(IDS)


def rig_on(population: str) -> ArmRig:
    return ArmRig(SteppedEmulator("--population", population, wire_time=False))


# The second stands so near to its goal that the gripper counts as being there, and pushes on.
@pytest.mark.parametrize(
    ("obstacle_rad", "goal_rad", "outcome"), [(0.6, 0.0, Outcome.GRIPPED), (0.9, 0.81, Outcome.REACHED)]
)
def test_a_gripper_of_lerobot_that_squeezes_or_is_kept_from_its_goal_pushes_for_long_without_an_overload(
    obstacle_rad: float, goal_rad: float, outcome: Outcome
) -> None:
    rig = rig_on("lerobot").started()
    rig.execute(smooth_move({"gripper": (0.0, 1.2)}, 1.0))
    rig.until(lambda: bool(rig.ended))
    rig.emulator.command(obstacle={"6": CALIBRATION.joints[5].ticks_from_rad(obstacle_rad)})
    rig.execute(smooth_move({"gripper": (1.2, goal_rad)}, 1.0), motion_id=2, gripping=outcome is Outcome.GRIPPED)
    rig.until(lambda: len(rig.ended) == 2)
    rig.run(6.0)
    assert (rig.supervisor.fault, rig.ended[-1].outcome) == (None, outcome)
    assert 0.1 < abs(rig.state.load[5]) < LEROBOT.gripper[Register.OVERLOAD_TORQUE] / 100.0


def other_elbow() -> Calibration:
    """The calibration with another offset and range of the elbow."""
    elbow = replace(CALIBRATION.joints[2], homing_offset=-25, range_min=940, range_max=3200)
    return Calibration((*CALIBRATION.joints[:2], elbow, *CALIBRATION.joints[3:]))


def test_a_relaxed_arm_takes_a_calibration_into_its_servos_and_one_that_holds_none(emulator: SteppedEmulator) -> None:
    rig = ArmRig(emulator).started()
    assert "relax it first" in rig.refused(Order.WRITE_CALIBRATION, other_elbow())
    assert rig.bus.read(3, Register.HOMING_OFFSET) == 0
    assert rig.refused(Order.WRITE_CALIBRATION) == "there is no calibration to write"
    assert rig.order(Order.RELAX).done
    answer = rig.order(Order.WRITE_CALIBRATION, other_elbow())
    assert answer.done, answer.message
    assert "3 registers of 1 servos" in answer.message
    registers = (Register.HOMING_OFFSET, Register.MIN_ANGLE_LIMIT, Register.MAX_ANGLE_LIMIT, Register.LOCK)
    assert [rig.bus.read(3, register) for register in registers] == [-25, 940, 3200, 1]
    assert rig.torque() == [0] * len(IDS)


CALIBRATED = (Register.HOMING_OFFSET, Register.MIN_ANGLE_LIMIT, Register.MAX_ANGLE_LIMIT)
OLD, NEW = (
    tuple((joint.homing_offset, joint.range_min, joint.range_max) for joint in calibration.joints)
    for calibration in (CALIBRATION, other_elbow())
)


def held_by(rig: ArmRig) -> tuple[tuple[int, ...], ...]:
    """Offset and limits of every servo."""
    return tuple(tuple(rig.bus.read(servo, register) for register in CALIBRATED) for servo in IDS)


def test_an_arm_with_a_new_calibration_is_not_enabled_before_the_old_one_is_written_back(rig: ArmRig) -> None:
    assert rig.order(Order.WRITE_CALIBRATION, other_elbow()).done
    assert not rig.order(Order.ENABLE).done
    rig.run(0.5)
    assert "elbow_flex (id 3) (offset 0 to -25" in rig.refused(Order.ENABLE)
    rig.order(Order.RESET_FAULT)
    assert not rig.order(Order.ENABLE).done
    assert rig.torque() == [0] * len(IDS)
    assert rig.order(Order.WRITE_CALIBRATION, CALIBRATION).done
    rig.run(0.5)
    rig.order(Order.RESET_FAULT)
    assert rig.order(Order.ENABLE).done


def test_an_arm_written_to_is_not_enabled_before_every_servo_was_read(emulator: SteppedEmulator, rig: ArmRig) -> None:
    rig.order(Order.WRITE_CALIBRATION, other_elbow())
    emulator.command(offline=[5])
    rig.run(3.0)
    arm = rig.supervisor.arm
    emulator.command(online=[5])
    with pytest.raises(StartupError, match="not checked since"):
        run(arm.hardware.enable(range(len(IDS))))
    rig.run(3.0)
    with pytest.raises(StartupError, match="calibration in use"):
        run(arm.hardware.enable(range(len(IDS))))
    assert rig.torque() == [0] * len(IDS)


def test_an_emergency_stop_at_any_step_of_a_write_leaves_servos_that_are_locked_and_consistent() -> None:
    for steps in range(1, 1000):
        emulator = SteppedEmulator(wire_time=False)
        rig = relaxed(emulator)
        rig.bus.write(1, Register.LOCK, 0)
        number = rig.begin(Order.WRITE_CALIBRATION, other_elbow())
        for _ in range(steps):
            rig.supervisor.work()
        if rig.answer(number) is not None:
            break
        assert rig.order(Order.EMERGENCY_STOP).done
        assert held_by(rig) in (OLD, NEW), steps
        assert rig.bus.read(3, Register.LOCK) == 1, steps
        was_written = held_by(rig) == NEW
        rig.run(0.1)
        rig.order(Order.RESET_FAULT)
        assert rig.order(Order.ENABLE).done is not was_written, steps
    assert steps > len(IDS) * len(CALIBRATED)


def begin_to_write(rig: ArmRig) -> None:
    """Begin to write the calibration, up to the first limit."""
    rig.begin(Order.WRITE_CALIBRATION, other_elbow())
    for _ in range(1000):
        if rig.bus.read(3, Register.MIN_ANGLE_LIMIT) == NEW[2][1]:
            return
        rig.supervisor.work()
    raise AssertionError("the limit is not written")


def test_an_emergency_stop_cuts_torque_before_the_write_that_it_interrupts_is_undone(tmp_path: Path) -> None:
    log = tmp_path / "writes.jsonl"
    emulator = SteppedEmulator("--write-log", str(log), wire_time=False)
    rig = relaxed(emulator)
    begin_to_write(rig)
    before = len(read_write_log(log))
    rig.begin(Order.EMERGENCY_STOP)
    addresses = [entry["address"] for entry in read_write_log(log)[before:]]
    emulator.end()
    assert addresses[0] == Register.TORQUE_ENABLE
    assert addresses[-1] == Register.LOCK


@pytest.mark.parametrize("seed", range(4))
def test_a_write_with_half_of_the_replies_lost_leaves_an_arm_that_does_not_move_with_a_wrong_zero(seed: int) -> None:
    emulator = SteppedEmulator("--seed", str(seed), wire_time=False)
    rig = relaxed(emulator)
    number = rig.begin(Order.WRITE_CALIBRATION, other_elbow())
    rig.tick()
    emulator.command(drop=0.5)
    rig.until(lambda: rig.answer(number) is not None, timeout_s=30.0)
    emulator.command(drop=0.0)
    rig.run(3.0)
    held = held_by(rig)
    rig.order(Order.RESET_FAULT)
    assert held in (OLD, NEW)
    assert rig.order(Order.ENABLE).done is (held == OLD)


def test_a_process_that_ends_during_a_write_locks_the_servos(rig: ArmRig, emulator: SteppedEmulator) -> None:
    begin_to_write(rig)
    rig.supervisor.handle(Shutdown())
    emulator.clock.advance(10.0 * END_TIMEOUT_S)
    rig.until(rig.supervisor.finished)
    assert held_by(rig) in (OLD, NEW)
    assert rig.bus.read(3, Register.LOCK) == 1


def test_a_hand_that_turns_a_relaxed_joint_across_the_seam_is_no_fault(emulator: SteppedEmulator, rig: ArmRig) -> None:
    # A reading from one end of the turn to the other within a cycle.
    emulator.command(jump={"3": -1000})
    rig.run(0.1)
    emulator.command(jump={"3": 1100})
    rig.run(0.1)
    assert rig.mode is Mode.RELAXED
    assert rig.order(Order.ENABLE).done


@pytest.mark.parametrize("population", sorted(POPULATIONS.keys() - {"ros2_driver", "kit"}))
def test_an_arm_of_each_population_is_enabled_where_it_stands(population):
    rig = rig_on(population).started()
    before = [servo.plant.position_ticks for servo in rig.emulator.servo_bus.servos]
    rig.run(1.0)
    assert [servo.plant.position_ticks for servo in rig.emulator.servo_bus.servos] == pytest.approx(before, abs=30.0)


def test_a_kit_is_no_arm_yet():
    rig = rig_on("kit")
    rig.run(3.0)
    assert rig.mode is not Mode.HOLDING
    assert [servo.value(40) for servo in rig.emulator.servo_bus.servos] == [0] * 6


def test_nothing_but_a_power_cut_ends_an_overload_that_stays_and_every_order_says_so() -> None:
    rig = rig_on("clone").started()
    rig.emulator.command(push={"3": 900})
    rig.until(lambda: rig.fault_code == "overload", 10.0)
    rig.emulator.command(push={"3": 0})
    # The controller tries to relax the arm by itself.
    rig.run(5.0)
    switch, cut = "switch the servos' supply off and on", "they may still be driven until the servos' supply is cut"
    for order, words in ((Order.RESET_FAULT, switch), (Order.RELAX, cut), (Order.EMERGENCY_STOP, cut)):
        answer = rig.order(order)
        assert not answer.done, order
        assert "elbow_flex (id 3)" in answer.message, order
        assert words in answer.message, order
    rig.emulator.command(power_cycle=IDS)
    rig.run(1.0)
    answer = rig.order(Order.RESET_FAULT)
    assert answer.done, answer.message
    assert rig.order(Order.ENABLE).done
    assert rig.mode is Mode.HOLDING
