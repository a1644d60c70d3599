from __future__ import annotations

from robot.faults import REMEDIES, Fault, FaultCode


def test_every_fault_has_a_remedy() -> None:
    assert set(REMEDIES) == set(FaultCode)


def test_a_fault_reads_as_what_happened_and_what_to_do() -> None:
    fault = Fault(FaultCode.STALLED, "joint elbow_flex stands still at 0.52 rad with 80 % of its torque", "elbow_flex")
    assert str(fault).startswith("joint elbow_flex stands still at 0.52 rad with 80 % of its torque. Clear what")
