from __future__ import annotations

import pytest

from robot.faults import ADVICE, REMEDIES, SIMULATED_REMEDIES, FaultCode, ServoAlert, advise
from robot.hardware.interface import StatusFlag

# Their sentences say what to do.
SELF_EXPLAINING = {
    ServoAlert.POSITION_LIMITS,
    ServoAlert.RETURN_DELAY,
    ServoAlert.EPROM_UNLOCKED,
    ServoAlert.NO_WATCHDOG,
}


def test_every_other_alert_has_its_meaning_and_a_remedy() -> None:
    assert set(ADVICE) == set(ServoAlert) - SELF_EXPLAINING
    assert all(advice.means and advice.remedy().endswith(".") for advice in ADVICE.values())
    assert advise(SELF_EXPLAINING) == []


@pytest.mark.parametrize("flag", StatusFlag)
def test_every_status_flag_is_an_alert_of_its_name(flag: StatusFlag) -> None:
    assert ServoAlert(str(flag.name).lower()) in ADVICE


def test_a_fault_s_remedy_is_said_in_the_words_of_the_fault() -> None:
    (said,) = advise([ServoAlert.OVERLOAD, ServoAlert.OVERLOAD])
    assert said.startswith("overload: the load was too high for too long")
    assert said.endswith(REMEDIES[FaultCode.OVERLOAD])
    (simulated,) = advise([ServoAlert.OVERLOAD], simulated=True)
    assert simulated.endswith(SIMULATED_REMEDIES[FaultCode.OVERLOAD])
