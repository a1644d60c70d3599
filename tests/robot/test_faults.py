from __future__ import annotations

import pytest

from robot.faults import REMEDIES, SIMULATED_REMEDIES, Fault, FaultCode

# Things that only an arm of metal has, or that only a person at one can do.
OF_METAL = (
    "cable",
    "usb",
    "plug ",
    "plugs",
    "power supply",
    "servos' supply",
    "gear",
    "screw",
    "machine",
    "replace",
    "cut ",
)


def test_every_fault_has_a_remedy() -> None:
    assert set(REMEDIES) == set(FaultCode)


def test_a_fault_reads_as_what_happened_and_what_to_do() -> None:
    fault = Fault(FaultCode.STALLED, "joint elbow_flex stands still at 0.52 rad with 80 % of its torque", "elbow_flex")
    assert str(fault).startswith("joint elbow_flex stands still at 0.52 rad with 80 % of its torque. Clear what")


@pytest.mark.parametrize("code", FaultCode)
def test_the_remedy_for_a_simulated_arm_asks_for_nothing_that_only_metal_has(code: FaultCode) -> None:
    remedy = Fault(code, "", simulated=True).remedy.lower()
    assert not [word for word in OF_METAL if word in remedy]


@pytest.mark.parametrize("code", SIMULATED_REMEDIES)
def test_a_real_arm_is_given_its_own_remedy(code: FaultCode) -> None:
    assert Fault(code, "").remedy == REMEDIES[code] != SIMULATED_REMEDIES[code]


@pytest.mark.parametrize("code", FaultCode)
@pytest.mark.parametrize("simulated", [False, True])
def test_every_remedy_is_sentences(code: FaultCode, simulated: bool) -> None:
    remedy = Fault(code, "", simulated=simulated).remedy
    assert remedy[0].isupper()
    assert remedy.endswith(".")
