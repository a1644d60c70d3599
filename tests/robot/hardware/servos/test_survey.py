from typing import Any

import pytest

from robot.errors import NoReply, StartupError
from robot.hardware.interface import run_to_end
from robot.hardware.servos.family import ServoFound
from robot.hardware.servos.survey import calibration_refusal, change_refusal, survey
from tests.helpers.servo_families import DYNAMIXEL, FEETECH, IDS, Family


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


def test_servos_that_do_not_answer_are_named_and_no_cable_if_they_are_emulated(family: Family, emulator: Any) -> None:
    for offline, sentence in (({3}, r"^no answer from elbow_flex \(id 3\)$"), (set(IDS), "^no servo answers$")):
        emulator.servo_bus.faults.offline = offline
        with pytest.raises(StartupError, match=sentence):
            surveyed(family, emulator, simulated=True)
    emulator.servo_bus.faults.offline = set()
    steps = survey(family.driver, emulator.open_bus(), family.servo_map)
    for _ in range(len(IDS) + 2):
        next(steps)
    emulator.servo_bus.faults.offline = set(IDS)
    with pytest.raises(NoReply):
        run_to_end(steps)


def test_limits_of_another_calibration_are_a_warning(family: Family, emulator: Any) -> None:
    joint = family.calibration.joints[1]
    family.put(emulator, 2, family.lowest_limit, joint.range_min - 100)
    (warning,) = surveyed(family, emulator)[2].warnings
    assert f"({joint.range_min - 100}, {joint.range_max})" in warning.sentence
    assert f"({joint.range_min}, {joint.range_max})" in warning.sentence


def test_a_homing_offset_that_another_program_wrote_is_refused_with_the_remedy(family: Family, emulator: Any) -> None:
    assert calibration_refusal(family.driver, family.servo_map, surveyed(family, emulator)) == ""
    calibrated = family.calibration.joints[2].homing_offset
    family.put(emulator, 3, "HOMING_OFFSET", calibrated - 85)
    reason = calibration_refusal(family.driver, family.servo_map, surveyed(family, emulator))
    assert f"elbow_flex (id 3) by 7.5 deg ({calibrated - 85} instead of {calibrated} ticks)" in reason
    assert "calibrate the arm again" in reason
    assert family.driver.recalibrate_advice in reason


def test_servos_whose_calibration_has_changed_since_the_start_are_refused(family: Family, emulator: Any) -> None:
    before = surveyed(family, emulator)
    family.put(emulator, 3, "HOMING_OFFSET", family.calibration.joints[2].homing_offset + 40)
    after = surveyed(family, emulator)
    servos = family.servo_map
    assert change_refusal(family.driver, servos, before, before, offsets_known=False) == ""
    assert "elbow_flex (id 3) (offset" in change_refusal(family.driver, servos, before, after, offsets_known=False)
    # Back to the calibration in use.
    assert change_refusal(family.driver, servos, after, before, offsets_known=True) == ""


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
    reason = calibration_refusal(FEETECH.driver, FEETECH.servo_map, surveyed(FEETECH, emulator))
    assert (f"elbow_flex (id 3) {lowest} to {highest} instead of" in reason and "--write-back" in reason) is refused


def test_a_servo_that_was_turned_many_times_is_refused() -> None:
    emulator = DYNAMIXEL.emulator()
    emulator.servo(3)._turns_ticks += 32 * 4096
    with pytest.raises(StartupError, match=r"elbow_flex \(id 3\) is at -\d+ ticks, more than 16 turns away"):
        surveyed(DYNAMIXEL, emulator)
