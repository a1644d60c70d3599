import itertools
import re

from robot.faults import ADVICE, REMEDIES, SIMULATED_REMEDIES, Fault, FaultCode, ServoAlert, advise
from robot.hardware.interface import StatusFlag

# Things that only an arm of metal has, or that only a person at one can do.
OF_METAL = re.compile("cable|usb|plug |plugs|power supply|servos' supply|gear|screw|machine|replace|cut ")


def test_every_fault_has_a_remedy_of_whole_sentences() -> None:
    assert set(REMEDIES) == set(FaultCode)
    for code, simulated in itertools.product(FaultCode, (False, True)):
        remedy = Fault(code, "", simulated=simulated).remedy
        assert remedy[0].isupper(), code
        assert remedy.endswith("."), code


def test_the_remedy_for_a_simulated_arm_asks_for_nothing_that_only_metal_has() -> None:
    for code in FaultCode:
        assert not OF_METAL.findall(Fault(code, "", simulated=True).remedy.lower()), code
    for code, simulated_remedy in SIMULATED_REMEDIES.items():
        assert Fault(code, "").remedy == REMEDIES[code] != simulated_remedy


def test_a_fault_reads_as_what_happened_and_what_to_do() -> None:
    fault = Fault(FaultCode.STALLED, "joint elbow_flex stands still at 0.52 rad with 80 % of its torque", "elbow_flex")
    assert str(fault).startswith("joint elbow_flex stands still at 0.52 rad with 80 % of its torque. Clear what")


# Their sentences say what to do.
SELF_EXPLAINING = {ServoAlert[name] for name in ("POSITION_LIMITS", "RETURN_DELAY", "EPROM_UNLOCKED", "NO_WATCHDOG")}


def test_every_other_alert_has_its_meaning_and_a_remedy_and_every_status_flag_is_one() -> None:
    assert set(ADVICE) == set(ServoAlert) - SELF_EXPLAINING
    assert all(advice.means and advice.remedy().endswith(".") for advice in ADVICE.values())
    assert advise(SELF_EXPLAINING) == []
    assert {ServoAlert(str(flag.name).lower()) for flag in StatusFlag} <= set(ADVICE)


def test_a_fault_s_remedy_is_said_in_the_words_of_the_fault() -> None:
    (said,) = advise([ServoAlert.OVERLOAD, ServoAlert.OVERLOAD])
    assert said.startswith("overload: the load was too high for too long")
    assert said.endswith(REMEDIES[FaultCode.OVERLOAD])
    (simulated,) = advise([ServoAlert.OVERLOAD], simulated=True)
    assert simulated.endswith(SIMULATED_REMEDIES[FaultCode.OVERLOAD])
