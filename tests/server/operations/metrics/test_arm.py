from __future__ import annotations

from dataclasses import replace

from robot.faults import FaultCode
from robot.messages import Mode
from server.operations.metrics.arm import arm_metrics, condition_metrics
from tests.helpers.metric_samples import samples
from tests.helpers.watched_parts import WatchedArm, arm_health, arm_state


def test_the_arms_mode_and_fault_are_ones_among_zeros() -> None:
    found = samples(arm_metrics(WatchedArm(arm_state(Mode.FAULT, FaultCode.OVERHEATED), 0.25)))
    assert [name[1:] for name, value in found.items() if value == 1] == [("fault",), ("overheated",)]
    assert len(found) == len(Mode) + len(FaultCode) + 1
    assert found["armbridge_arm_state_age_seconds",] == 0.25


def test_without_a_fault_all_are_zero() -> None:
    found = samples(arm_metrics(WatchedArm(arm_state())))
    assert {value for (name, *_), value in found.items() if name == "armbridge_arm_fault"} == {0}


def test_the_condition_is_told_in_base_units_by_joint() -> None:
    found = samples(condition_metrics(arm_health()))
    assert found["armbridge_bus_timeouts_total",] == 10
    assert found["armbridge_bus_retries_total",] == 12
    assert found["armbridge_arm_loop_lateness_seconds", "0.99"] == 0.001
    assert found["armbridge_bus_round_trip_seconds", "1"] == 0.005
    assert found["armbridge_servo_temperature_celsius", "shoulder_pan"] == 31
    assert found["armbridge_servo_voltage_volts", "gripper"] == 5.0
    assert found["armbridge_servo_silent_cycles_total", "gripper"] == 4
    assert found["armbridge_arm_real_time_factor",] == 1.0


def test_an_ideal_arm_has_no_metrics_of_what_it_does_not_have() -> None:
    servos = arm_health()
    nan = float("nan")
    joints = [replace(joint, temperature_c=nan, voltage_v=nan, current_a=nan) for joint in servos.joints]
    found = samples(condition_metrics(replace(servos, bus=None, joints=tuple(joints), real_time_factor=0.5)))
    assert not [name for name, *_ in found if name.startswith(("armbridge_bus", "armbridge_servo_temperature"))]
    assert not [name for name, *_ in found if name.endswith(("_volts", "_amperes"))]
    assert found["armbridge_servo_reply_age_seconds", "gripper"] == 0.002
    assert found["armbridge_arm_real_time_factor",] == 0.5
