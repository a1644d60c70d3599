import contextlib
import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from harness.server import read_write_log
from robot.calibration import Calibration
from robot.commissioning.scan import scan
from robot.description.robot_file import ProfileTable
from robot.errors import DescriptionError, RobotError, StartupError
from robot.faults import FaultCode, ServoAlert
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.family import PHASE_MULTI_TURN, Feetech, differences, read_differences, write_to_servos
from robot.hardware.feetech.profiles import FACTORY, LEROBOT, ServoProfile, nearest_profile, profile_of
from robot.hardware.feetech.registers import GOAL_ADDRESS, SETTINGS, Register
from robot.hardware.interface import run_to_end
from robot.hardware.servos.family import Limit, ServoFound, ServoMap
from robot.hardware.servos.hardware import CYCLES_BETWEEN
from robot.hardware.servos.survey import survey
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, FeetechsInUse, run
from tests.helpers.emulator import SteppedEmulator, goal_block
from tests.helpers.robots import nominal_calibration

FAMILY = Feetech()
IDS = [joint.servo_id for joint in CALIBRATION.joints]


def surveyed(bus: Bus, family: Feetech = FAMILY) -> dict[int, ServoFound]:
    return run(survey(family, bus, ServoMap(family, CALIBRATION, BOUNDS)))


def set_all(bus: Bus, profile: ServoProfile) -> None:
    for joint in CALIBRATION.joints:
        for register, value in profile.expected(gripper=joint.servo.gripper).items():
            bus.write(joint.servo_id, register, value)


def test_a_servo_is_as_strong_as_its_settings_and_without_a_threshold_it_is_not_protected(bus: Bus) -> None:
    set_all(bus, LEROBOT)
    for register in (Register.OVERLOAD_TORQUE, Register.PROTECTION_TIME, Register.PROTECTION_CURRENT):
        bus.write(1, register, 0)
    strength = FAMILY.actuation(CALIBRATION.joints, surveyed(bus))
    assert strength.max_torque == pytest.approx([1.0] * 5 + [0.5])
    assert strength.stiffness == pytest.approx([0.5] * 6)
    assert strength.overload_torque == pytest.approx([np.inf, *[0.8] * 4, 0.25])
    assert strength.overload_time_s == pytest.approx([np.inf, *[2.0] * 5])
    assert strength.overload_current_a == pytest.approx([np.inf, *[3.25] * 4, 1.625])


def test_a_setting_that_differs_from_its_profile_is_told_with_its_consequence(bus: Bus) -> None:
    before = bus.counters.sent
    found = surveyed(bus, Feetech(LEROBOT))
    # The model, the settings, and the commands.
    assert bus.counters.sent - before == 3 * len(IDS)
    assert all("P_GAIN is 32, not 16" in " ".join(each.sentence for each in found[servo].warnings) for servo in IDS)
    assert all(found[servo].expected[Register.P_GAIN] == 16 for servo in IDS)
    set_all(bus, LEROBOT)
    bus.write(3, Register.PROTECTION_TIME, 20)
    found = surveyed(bus)
    assert [servo for servo in IDS if found[servo].warnings] == [3]
    (warning,) = found[3].warnings
    expected = "register PROTECTION_TIME is 20, not 200 as in the profile lerobot: an overload latches after 0.2 s"
    assert warning.sentence == expected


@pytest.mark.parametrize(
    ("register", "value", "alert", "words"),
    [
        (Register.OPERATING_MODE, 1, None, r"servo 2 (shoulder_lift) is in operating mode 1"),
        (Register.MIN_ANGLE_LIMIT, 100, ServoAlert.ANGLE_LIMITS, "(100, "),
        (Register.PHASE, 12 | PHASE_MULTI_TURN, ServoAlert.SEVERAL_TURNS, "its position may overflow"),
        (Register.RETURN_DELAY, 250, ServoAlert.RETURN_DELAY, "comes 500 us later: set register RETURN_DELAY to 0"),
        (Register.LOCK, 0, ServoAlert.EPROM_UNLOCKED, "EPROM is unlocked"),
        (Register.P_GAIN, 8, ServoAlert.REGISTER, "droops further"),
        (Register.MAX_TORQUE, 300, ServoAlert.REGISTER, "30 % of its torque"),
    ],
)
def test_a_deviating_setting_is_told_and_another_mode_refused(
    bus: Bus, register: Register, value: int, alert: ServoAlert | None, words: str
) -> None:
    bus.write(2, register, value)
    if alert is None:
        with pytest.raises(StartupError, match=re.escape(words)):
            surveyed(bus)
        return
    (warning,) = surveyed(bus)[2].warnings
    assert warning.alert is alert
    assert words in warning.sentence


@pytest.mark.parametrize("model", [776, 2825])
def test_a_servo_of_another_model_is_told(emulator: SteppedEmulator, model: int) -> None:
    named = Calibration(
        tuple(
            replace(each, servo=replace(each.servo, model="776" if each.servo_id == 2 else "sts3215"))
            for each in CALIBRATION.joints
        )
    )
    emulator.servo_bus.servos[1].set(Register.MODEL_NUMBER, model)
    found = run(survey(FAMILY, emulator.open_bus(), ServoMap(FAMILY, named, BOUNDS)))
    alerts = [warning.alert for warning in found[2].warnings]
    assert alerts == [ServoAlert.MODEL] * (model != 776)


def test_the_soft_limits_are_narrowed_to_what_the_servos_allow(emulator: SteppedEmulator) -> None:
    bus = emulator.open_bus()
    bus.write(1, Register.MAX_ANGLE_LIMIT, CALIBRATION.joints[0].ticks_from_rad(0.5))
    found = FeetechsInUse(emulator).found
    assert found.bounds.upper_rad[0] == pytest.approx(0.5, abs=0.05)
    assert found.bounds.upper_rad[1:] == pytest.approx(BOUNDS.upper_rad[1:])
    for register in (Register.MIN_ANGLE_LIMIT, Register.MAX_ANGLE_LIMIT):
        bus.write(1, register, 0)
    servos = FeetechsInUse(emulator)
    assert servos.found.bounds.upper_rad == pytest.approx(BOUNDS.upper_rad)
    # Limits of 0 are none: its goal is not clamped to them.
    assert servos.enable() == pytest.approx(servos.read().position_rad, abs=0.01)


def test_each_servo_has_a_supply_limit_of_its_own(emulator: SteppedEmulator) -> None:
    emulator.open_bus().write(2, Register.MAX_VOLTAGE, 74)
    assert FeetechsInUse(emulator).found.max_voltage_v == pytest.approx([8.0, 7.4, 8.0, 8.0, 8.0, 8.0])


def test_a_servo_is_asked_for_no_more_than_it_is_set_to_give(emulator: SteppedEmulator) -> None:
    emulator.open_bus().write(2, Register.MAX_TORQUE, 600)
    hardware = FeetechsInUse(emulator).hardware
    assert hardware.full_torque == pytest.approx([0.8, 0.6, 0.8, 0.8, 0.8, 0.5])
    assert hardware._torque.full_limits()[2] == Limit(Register.TORQUE_LIMIT, 600)
    hardware.write_goals(np.zeros(6))
    ticks, cap = CALIBRATION.joints[0].ticks_from_rad(0.0), hardware.servos.speed_ticks_s[1]
    assert hardware.bus.sync_read((1,), GOAL_ADDRESS, 7)[1].data == goal_block(ticks, int(np.ceil(cap)))


def test_torque_limits_that_servos_have_lost_are_written_again(emulator: SteppedEmulator) -> None:
    servos = FeetechsInUse(emulator)
    servos.enable()
    servos.hardware.write_torque_shares(servos.hardware.full_torque)
    for lost_to, rebooted in ((200, False), (1000, True)):
        for servo in emulator.servo_bus.servos:
            servo.write(Register.TORQUE_LIMIT, Register.TORQUE_LIMIT.encode(lost_to))
        faults = [servos.hardware.check(0.0) for _ in range(len(IDS) * len(FAMILY.read_back) * CYCLES_BETWEEN)]
        codes = [fault.code for fault in faults if fault is not None]
        # The limit of a servo after power-up.
        assert codes == [FaultCode.SERVO_REBOOTED] * len(IDS) * rebooted
        servos.hardware.write_torque_shares(servos.hardware.full_torque)
        assert [servo.value(Register.TORQUE_LIMIT) for servo in emulator.servo_bus.servos] == [800] * 5 + [500]


def test_a_servo_that_would_clamp_its_goal_is_not_switched_on_and_a_stuck_overload_needs_a_power_cycle(
    emulator: SteppedEmulator,
) -> None:
    bus, limit = emulator.open_bus(), Register.MAX_ANGLE_LIMIT
    before = bus.read(1, limit)
    bus.write(1, limit, 2000)
    with pytest.raises(StartupError, match="shoulder_pan stands at"):
        FeetechsInUse(emulator).enable()
    assert not run_to_end(FeetechsInUse(emulator).hardware.driven(), emulator.run).any()
    bus.write(1, limit, before)
    servos = FeetechsInUse(emulator)
    servos.enable()
    emulator.servo_bus.servos[2].write = lambda _address, _data: 0  # type: ignore[method-assign]
    with pytest.raises(StartupError, match=r"the overload of elbow_flex \(id 3\) stays latched"):
        run_to_end(servos.hardware.clear_overloads([2], hold=True), emulator.run)


def test_an_arm_that_holds_is_adopted_unwritten(start_emulator: Callable[..., SteppedEmulator], tmp_path: Path) -> None:
    log = tmp_path / "writes.jsonl"
    emulator = start_emulator("--write-log", str(log), "--start", "0.5,-0.5,0.5,0.2,0.1,0.3")
    with contextlib.closing(emulator.open_bus()) as bus:
        first = FeetechsInUse(emulator).enable()
        bus.ping(1)  # the emulator has then logged all that came before
        written = len(read_write_log(log))
        assert FeetechsInUse(emulator).enable() == pytest.approx(first)
        bus.ping(1)
        assert len(read_write_log(log)) == written


def recalibrated(*servos: int, **values: int) -> Calibration:
    """The calibration with other values of some servos."""
    joints = nominal_calibration().joints
    return Calibration(tuple(replace(joint, **values) if joint.servo_id in servos else joint for joint in joints))


REGISTERS = (Register.HOMING_OFFSET, Register.MIN_ANGLE_LIMIT, Register.MAX_ANGLE_LIMIT)

# Two servos, so that one is done or not begun while the other is written.
CHANGED = (2, 3)
VALUES = {2: (-25, 940, 3130), 3: (-31, 951, 3142)}
WANTED = Calibration(
    tuple(
        replace(joint, **dict(zip(("homing_offset", "range_min", "range_max"), VALUES[joint.servo_id], strict=True)))
        if joint.servo_id in VALUES
        else joint
        for joint in nominal_calibration().joints
    )
)

# MAX_ANGLE_LIMIT stays as it is, so nothing names or writes it.
ELBOW_CHANGED = recalibrated(3, homing_offset=-12, range_min=950)


def calibrated_registers_of(bus, servos=IDS):
    """Offset and limits of servos, by id."""
    return {servo: tuple(bus.read(servo, register) for register in REGISTERS) for servo in servos}


def interrupted(at_step, loss):
    """Servos whose writing was interrupted before a step; None when it had fewer steps."""
    emulator = SteppedEmulator(wire_time=False)
    bus = emulator.open_bus()
    before = calibrated_registers_of(bus)
    steps = write_to_servos(bus, run(read_differences(bus, WANTED)))
    try:
        for _ in range(at_step):
            next(steps)
    except StopIteration:
        return None
    emulator.command(**loss)
    with contextlib.suppress(RobotError):
        run(steps)
    emulator.command(online=IDS, plugged=True)
    return emulator.open_bus(), before


@pytest.mark.parametrize("loss", [{"offline": IDS}, {"plugged": False}])
def test_a_write_that_is_interrupted_at_any_step_leaves_no_new_offset_with_old_limits(loss):
    for at_step in itertools.count(1):
        found = interrupted(at_step, loss)
        if found is None:
            break
        bus, before = found
        for servo, held in calibrated_registers_of(bus, CHANGED).items():
            assert held[0] == before[servo][0] or held == VALUES[servo], (at_step, servo, held)
    assert at_step > len(CHANGED) * len(REGISTERS)


def test_a_write_that_is_given_up_at_any_step_is_undone_unless_the_servo_has_taken_all():
    locked = 0
    for at_step in itertools.count(1):
        bus = SteppedEmulator(wire_time=False).open_bus()
        before = calibrated_registers_of(bus, CHANGED)
        steps = write_to_servos(bus, run(read_differences(bus, WANTED)))
        if len(list(itertools.islice(steps, at_step))) < at_step:
            break
        written = calibrated_registers_of(bus, CHANGED)
        steps.close()
        for servo, held in calibrated_registers_of(bus, CHANGED).items():
            # The offset is written last.
            whole = written[servo][0] == VALUES[servo][0]
            assert held == (VALUES if whole else before)[servo], at_step
            assert bus.read(servo, Register.LOCK) == 1, at_step
            locked += held != written[servo]
    assert locked > len(REGISTERS)


def test_only_what_differs_is_written_and_it_outlives_a_power_cut(start_emulator, write_log):
    emulator = start_emulator("--write-log", str(write_log))
    bus = emulator.open_bus()
    found = run_to_end(read_differences(bus, ELBOW_CHANGED))
    assert found == differences(ELBOW_CHANGED, scan(bus, IDS).registers)
    assert [each.register for each in found] == [Register.MIN_ANGLE_LIMIT, Register.HOMING_OFFSET]
    run_to_end(write_to_servos(bus, found), emulator.run)
    emulator.command(power_cycle=[3])
    assert differences(ELBOW_CHANGED, scan(bus, IDS).registers) == []
    written = {(entry["address"], *entry["data"]) for entry in read_write_log(write_log) if entry["data"]}
    assert written <= {(register, "3") for register in (*REGISTERS[:2], Register.LOCK, Register.TORQUE_ENABLE)}
    assert bus.read(3, Register.LOCK) == 1
    bus.close()


def test_the_nearest_profile_is_found_though_a_setting_differs() -> None:
    for profile in (FACTORY, LEROBOT):
        grippers = (False, False, True)
        servos = [(dict.fromkeys(SETTINGS, 0) | profile.expected(gripper=each), each) for each in grippers]
        servos[0][0][Register.D_GAIN] = 40
        assert nearest_profile(servos) is profile


def test_registers_of_an_arm_replace_those_of_the_base_or_are_refused_with_their_place() -> None:
    registers = {"P_GAIN": 20, "overload_torque": 60}
    profile = profile_of(ProfileTable(base="lerobot", registers=registers, gripper={"MAX_TORQUE": 400}))
    arm, gripper = profile.expected(gripper=False), profile.expected(gripper=True)
    assert arm[Register.P_GAIN] == gripper[Register.P_GAIN] == 20
    assert arm[Register.OVERLOAD_TORQUE] == gripper[Register.OVERLOAD_TORQUE] == 60
    assert (arm[Register.MAX_TORQUE], gripper[Register.MAX_TORQUE]) == (1000, 400)
    assert gripper[Register.PROTECTION_CURRENT] == 250
    for spec, words in (
        (ProfileTable(registers={"P_GAINN": 20}), r"hardware.profile.registers.P_GAINN: there is no such .*P_GAIN"),
        (ProfileTable(registers={"GOAL_POSITION": 20}), "there is no such setting"),
        (ProfileTable(gripper={"P_GAIN": 256}), r"hardware.profile.gripper.P_GAIN: must be 0 to 255, not 256"),
        (ProfileTable(registers={"HOMING_OFFSET": 2048}), "must be -2047 to 2047, not 2048"),
        (ProfileTable(registers={"HOMING_OFFSET": -2048}), "must be -2047 to 2047, not -2048"),
    ):
        with pytest.raises(DescriptionError, match=words):
            profile_of(spec)
