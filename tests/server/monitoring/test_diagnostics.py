from __future__ import annotations

from dataclasses import replace
from typing import Any

from robot.faults import Fault, FaultCode
from robot.hardware.interface import BusCounters
from robot.messages import ArmHealth, ArmState, JointHealth, Mode
from server.monitoring.diagnostics import diagnostic_array
from tests.helpers.arm_server import ArmClient, ServerOnBus, values_of

SERVO = JointHealth("elbow_flex", "servo 3", 0.5, 31, 5.0, 0.1, -0.2, True, 0, 0.01, 2)
HEALTH = ArmHealth(
    100.0,
    Mode.HOLDING,
    "/dev/arm",
    (SERVO,),
    BusCounters(sent=7, timeouts=1),
    (0.0001, 0.0002, 0.0003),
    (0.002, 0.003, 0.004),
    True,
)
STATE = ArmState(100.0, Mode.HOLDING, ("elbow_flex",))
NAN = float("nan")


def statuses(state: ArmState = STATE, health: ArmHealth | None = HEALTH, now_s: float = 100.5) -> list[dict[str, Any]]:
    told: list[dict[str, Any]] = diagnostic_array(state, health, now_s, "so101")["status"]
    return told


def test_a_sound_arm_is_ok_with_the_figures_of_bus_loop_and_servos() -> None:
    arm, servo = statuses()
    assert (arm["level"], servo["level"]) == (0, 0)
    values = values_of(arm)
    assert values["loop_lateness_ms"] == "p50 0.100, p99 0.200, max 0.300"
    assert (values["bus_sent"], values["bus_timeouts"]) == ("7", "1")
    assert servo["hardware_id"] == "servo 3"
    assert values_of(servo)["temperature_c"] == "31"
    assert values_of(servo)["torque"] == "on"


def test_an_ideal_joint_has_neither_temperature_nor_bus() -> None:
    ideal = replace(SERVO, hardware_id="ideal joint", temperature_c=NAN, voltage_v=NAN, current_a=NAN, load=0.0)
    arm, joint = statuses(health=replace(HEALTH, port="ideal", joints=(ideal,), bus=None))
    assert (arm["level"], joint["level"], joint["hardware_id"]) == (0, 0, "ideal joint")
    assert values_of(joint).keys() == values_of(statuses()[1]).keys() - {"temperature_c", "voltage_v", "current_a"}
    assert values_of(arm)["port"] == "ideal"
    assert not [key for key in values_of(arm) if key.startswith("bus")]


def test_a_simulated_arm_that_a_busy_machine_slows_down_says_so() -> None:
    arm, servo = statuses(health=replace(HEALTH, real_time_factor=0.42))
    assert (arm["level"], arm["message"]) == (1, "the arm holds, at 42% of real time: this machine is busy")
    assert values_of(arm)["real_time_factor"] == "0.42"
    assert servo["level"] == 0
    arm, _ = statuses(health=replace(HEALTH, real_time_factor=0.95))
    assert (arm["level"], values_of(arm)["real_time_factor"]) == (0, "0.95")


def test_a_slow_simulated_arm_reports_as_seldom_as_its_time_passes() -> None:
    now_s = 108.0
    state = replace(STATE, stamp_s=now_s)
    assert statuses(state, replace(HEALTH, real_time_factor=0.25), now_s)[1]["level"] == 0
    assert statuses(state, replace(HEALTH, real_time_factor=0.5), now_s)[1]["level"] == 3


def test_what_is_worse_than_slow_is_told_instead() -> None:
    fault = Fault(FaultCode.STALLED, "joint elbow_flex pushes in vain", "elbow_flex")
    arm, _ = statuses(replace(STATE, mode=Mode.FAULT, fault=fault), replace(HEALTH, real_time_factor=0.42))
    assert (arm["level"], arm["message"].startswith(str(fault))) == (2, True)


def test_a_servo_with_a_warning_makes_servo_and_arm_warn() -> None:
    arm, servo = statuses(health=replace(HEALTH, joints=(replace(SERVO, warnings=("warm: 56 degC",)),)))
    assert (arm["level"], servo["level"], servo["message"]) == (1, 1, "warm: 56 degC")


def test_the_joint_of_a_fault_is_an_error() -> None:
    fault = Fault(FaultCode.STALLED, "joint elbow_flex pushes in vain", "elbow_flex")
    arm, servo = statuses(replace(STATE, mode=Mode.FAULT, fault=fault))
    assert (arm["level"], servo["level"]) == (2, 2)


def test_a_servo_that_is_not_read_is_stale() -> None:
    assert statuses(health=replace(HEALTH, joints=(replace(SERVO, age_s=2.0),)))[1]["level"] == 3
    assert statuses(now_s=104.0)[1]["level"] == 3
    assert statuses(replace(STATE, mode=Mode.DISCONNECTED))[1]["level"] == 3


def test_an_arm_process_that_says_nothing_more_is_stale() -> None:
    arm = statuses(now_s=104.0)[0]
    assert (arm["level"], arm["message"]) == (3, "the last state of the arm is 4.0 s old")


def test_before_the_first_report_there_is_the_arm_alone() -> None:
    assert [status["name"] for status in statuses(health=None)] == ["arm"]


async def test_a_silent_servo_shows_within_seconds(client: ArmClient, served: ServerOnBus) -> None:
    served.emulator.command(offline=[3])
    await client.until(
        "/diagnostics",
        lambda arrays: any(
            status["name"] == "arm: elbow_flex" and status["level"] == 2 for status in arrays[-1]["status"]
        ),
    )
