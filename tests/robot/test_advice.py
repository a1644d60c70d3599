from __future__ import annotations

import numpy as np
import pytest

from robot.advice import ADVICE, Complaint, advise, complaints_in
from robot.control.guards import Guards
from robot.faults import REMEDIES, SIMULATED_REMEDIES, FaultCode
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.family import PHASE_MULTI_TURN, Feetech
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import StatusFlag
from robot.hardware.servos.servo_map import ServoMap
from robot.hardware.servos.survey import survey
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, NAMES, reading, run

HERE = np.zeros(6)
FAMILY = Feetech()
SERVOS = ServoMap(FAMILY, CALIBRATION, BOUNDS)


def test_every_complaint_has_its_meaning_and_a_remedy() -> None:
    assert set(ADVICE) == set(Complaint)
    assert all(advice.means and advice.remedy().endswith(".") for advice in ADVICE.values())


@pytest.mark.parametrize("flag", StatusFlag)
def test_every_status_flag_is_a_complaint_of_its_name(flag: StatusFlag) -> None:
    assert Complaint(str(flag.name).lower()) in ADVICE


WARNINGS = {
    "a flag": ({"status": StatusFlag.OVERLOAD | StatusFlag.VOLTAGE}, [Complaint.VOLTAGE, Complaint.OVERLOAD]),
    "warm": ({"temperature_c": 56.0}, [Complaint.WARM]),
    "hot": ({"temperature_c": 61.0}, [Complaint.SLOWED]),
    "silent": ({"age_s": 0.5}, [Complaint.NO_ANSWER]),
}


@pytest.mark.parametrize(("told", "complaints"), WARNINGS.values(), ids=WARNINGS.keys())
def test_every_warning_of_the_guards_has_advice(told: dict[str, float], complaints: list[Complaint]) -> None:
    warnings = Guards(NAMES).warnings(reading(HERE, **told), 0)
    assert len(warnings) == 1
    assert complaints_in(warnings) == complaints


SURVEYED = {
    "limits": (Register.MIN_ANGLE_LIMIT, 100, Complaint.ANGLE_LIMITS),
    "several turns": (Register.PHASE, PHASE_MULTI_TURN, Complaint.SEVERAL_TURNS),
    "another setting": (Register.P_GAIN, 8, Complaint.REGISTER),
}


@pytest.mark.parametrize(("register", "value", "complaint"), SURVEYED.values(), ids=SURVEYED.keys())
def test_a_warning_of_the_survey_has_advice(bus: Bus, register: Register, value: int, complaint: Complaint) -> None:
    bus.write(2, register, value)
    assert complaints_in(run(survey(FAMILY, bus, SERVOS))[2].warnings) == [complaint]


@pytest.mark.parametrize(("register", "value"), [(Register.RETURN_DELAY, 250), (Register.LOCK, 0)])
def test_a_warning_that_says_what_to_do_has_no_other_advice(bus: Bus, register: Register, value: int) -> None:
    bus.write(2, register, value)
    (warning,) = run(survey(FAMILY, bus, SERVOS))[2].warnings
    assert complaints_in([warning]) == []
    assert "to 0" in warning or "armbridge setup" in warning


def test_a_firmware_and_a_model_that_differ_have_advice() -> None:
    warnings = [
        "the servo has firmware 3.9, most others 3.10",
        "the servo is model 2825, not 777: its speed and torque",
    ]
    assert complaints_in(warnings) == [Complaint.FIRMWARE, Complaint.MODEL]


def test_a_fault_s_remedy_is_said_in_the_words_of_the_fault() -> None:
    (said,) = advise([Complaint.OVERLOAD, Complaint.OVERLOAD])
    assert said.startswith("overload: the load was too high for too long")
    assert said.endswith(REMEDIES[FaultCode.OVERLOAD])
    (simulated,) = advise([Complaint.OVERLOAD], simulated=True)
    assert simulated.endswith(SIMULATED_REMEDIES[FaultCode.OVERLOAD])


def test_a_warning_that_is_unknown_has_no_advice() -> None:
    assert complaints_in(["the gain is 16; raise it to 32"]) == []
