"""The arm: what it does, its bus, its loop and its servos; what an ideal arm does not have is left out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from robot.faults import FaultCode
from robot.hardware.interface import BusCounters
from robot.messages import ArmHealth, JointHealth, Mode
from server.operations.parts import ArmPart

# Of a loop and a bus, by the part of the last second's values that is not above it.
QUANTILES = ("0.5", "0.99", "1")

_OF_SERVOS: tuple[tuple[str, str, Callable[[JointHealth], float]], ...] = (
    ("armbridge_servo_temperature_celsius", "Temperature of a servo.", lambda servo: servo.temperature_c),
    ("armbridge_servo_voltage_volts", "Voltage at a servo.", lambda servo: servo.voltage_v),
    ("armbridge_servo_current_amperes", "Current of a servo's motor, signed.", lambda servo: servo.current_a),
    ("armbridge_servo_load_ratio", "Share of the motor's full duty, signed.", lambda servo: servo.load),
    ("armbridge_servo_reply_age_seconds", "Time since a servo's last good reply.", lambda servo: servo.age_s),
)


def arm_metrics(arm: ArmPart) -> Iterator[Metric]:
    """What the arm does."""
    mode = GaugeMetricFamily("armbridge_arm_mode", "1 for what the arm is doing, 0 for all else.", labels=("mode",))
    for each in Mode:
        mode.add_metric((each.value,), int(arm.state.mode is each))
    fault = GaugeMetricFamily("armbridge_arm_fault", "1 for the fault of the arm, 0 for others.", labels=("code",))
    for code in FaultCode:
        fault.add_metric((code.value,), int(arm.state.fault is not None and arm.state.fault.code is code))
    yield from (mode, fault)
    yield GaugeMetricFamily("armbridge_arm_state_age_seconds", "Time since the last state came.", arm.state_age_s)


def condition_metrics(health: ArmHealth) -> Iterator[Metric]:
    """The arm's condition, as it told it last."""
    if health.bus is not None:
        yield from _bus_metrics(health.bus)
        yield _quantiles("armbridge_bus_round_trip_seconds", "Time that reading all servos took.", health.round_trip_s)
    yield _quantiles(
        "armbridge_arm_loop_lateness_seconds", "Start of the loop's ticks after their deadlines.", health.lateness_s
    )
    yield GaugeMetricFamily("armbridge_arm_real_time", "Whether the loop has real-time priority.", health.real_time)
    yield GaugeMetricFamily(
        "armbridge_arm_real_time_factor",
        "Seconds of the arm's time that pass in one second; below 1 where a busy machine slows a simulated arm down.",
        health.real_time_factor,
    )
    for name, meaning, value_of in _OF_SERVOS:
        family = GaugeMetricFamily(name, meaning, labels=("joint",))
        for joint in health.joints:
            if not math.isnan(value := value_of(joint)):
                family.add_metric((joint.joint,), value)
        yield family
    silent = CounterMetricFamily(
        "armbridge_servo_silent_cycles", "Cycles in which a servo did not answer.", labels=("joint",)
    )
    for joint in health.joints:
        silent.add_metric((joint.joint,), joint.silent_cycles)
    yield silent


def _bus_metrics(bus: BusCounters) -> Iterator[Metric]:
    for name, meaning, value in (
        ("instructions", "Instructions written to the bus.", bus.sent),
        ("replies", "Valid replies of servos.", bus.replies),
        ("timeouts", "Replies that did not come, or not soundly.", bus.timeouts),
        ("discarded_bytes", "Bytes that belonged to no valid reply.", bus.discarded_bytes),
        ("retries", "Instructions that were repeated.", bus.retries),
    ):
        yield CounterMetricFamily(f"armbridge_bus_{name}", f"{meaning} Since the bus was opened.", value)


def _quantiles(name: str, meaning: str, values_s: tuple[float, float, float]) -> Metric:
    family = GaugeMetricFamily(name, f"{meaning} Over the last second.", labels=("quantile",))
    for quantile, value_s in zip(QUANTILES, values_s, strict=True):
        family.add_metric((quantile,), value_s)
    return family
