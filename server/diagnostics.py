"""``/diagnostics``: the condition of arm, bus and servos, once a second, as ROS's tools show it."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Sequence
from typing import Any

from protocol.messages import Stamp
from robot.messages import ArmHealth, ArmState, JointHealth, Mode
from server.arm.topics import LEVEL_ERROR, LEVEL_OK, LEVEL_WARN, key_values, status
from server.graph.node import Node
from server.graph.topics import Graph

TOPIC = "/diagnostics"

# Of diagnostic_msgs/DiagnosticStatus: nothing new is known.
LEVEL_STALE = 3

PERIOD_S = 1.0

# Three reports missed: as diagnostic_aggregator, which waits 5 s, but sooner. A simulated arm that runs slower reports
# as much more seldom.
STALE_AFTER_S = 3.0

# A simulated arm that runs slower than this is seen to be slow.
SLOW_FACTOR = 0.9

# A servo is asked a hundred times a second.
SERVO_STALE_AFTER_S = 1.0


class Diagnostics:
    """Publishes the latest condition, also when none comes any more.

    Args:
        graph: where the topic is.
        robot_name: names the hardware.
    """

    def __init__(self, graph: Graph, robot_name: str) -> None:
        self._graph = graph
        self._robot_name = robot_name
        self._node = Node("diagnostics")
        self._state: ArmState | None = None
        self._health: ArmHealth | None = None
        self._task: asyncio.Task[None] | None = None

    def open(self) -> None:
        """Advertise the topic, and begin to publish."""
        self._graph.advertise(self._node, TOPIC, "diagnostic_msgs/DiagnosticArray")
        self._task = asyncio.create_task(self._run(), name="diagnostics")

    def close(self) -> None:
        """Publish no more."""
        if self._task is not None:
            self._task.cancel()

    def take_state(self, state: ArmState) -> None:
        """Take note of a state."""
        self._state = state

    def take_health(self, health: ArmHealth) -> None:
        """Take note of a condition."""
        self._health = health

    async def _run(self) -> None:
        while True:
            await asyncio.sleep(PERIOD_S)
            if self._state is not None:
                message = diagnostic_array(self._state, self._health, time.time(), self._robot_name)
                self._graph.publish(self._node, TOPIC, message)


def diagnostic_array(state: ArmState, health: ArmHealth | None, now_s: float, robot_name: str) -> dict[str, Any]:
    """The diagnostic_msgs/DiagnosticArray: the arm first, then every servo that was ever heard of.

    Args:
        state: the latest.
        health: the latest, or None before the first.
        now_s: wall-clock time [s since the epoch].
        robot_name: names the hardware.
    """
    arm = status(state, robot_name)
    age_s = now_s - state.stamp_s
    if age_s > STALE_AFTER_S:
        arm |= {"level": LEVEL_STALE, "message": f"the last state of the arm is {age_s:.1f} s old"}
    statuses = [arm]
    if health is not None:
        stale = state.mode is Mode.DISCONNECTED or (now_s - health.stamp_s) * health.real_time_factor > STALE_AFTER_S
        arm["values"] += key_values(_arm_values(health))
        if health.real_time_factor < SLOW_FACTOR and arm["level"] == LEVEL_OK:
            share = f"{health.real_time_factor:.0%} of real time"
            arm |= {"level": LEVEL_WARN, "message": f"{arm['message']}, at {share}: this machine is busy"}
        faulty = state.fault.joint if state.fault is not None else ""
        statuses += [_joint_status(joint, stale=stale, faulty=joint.joint == faulty) for joint in health.joints]
        arm["level"] = max(arm["level"], *(min(each["level"], LEVEL_WARN) for each in statuses))
    return {"header": {"stamp": Stamp.from_seconds(now_s).as_message(), "frame_id": ""}, "status": statuses}


def _arm_values(health: ArmHealth) -> dict[str, str]:
    values = {
        "port": health.port,
        "real_time_priority": str(health.real_time).lower(),
        "real_time_factor": f"{health.real_time_factor:.2f}",
        "loop_lateness_ms": _percentiles_ms(health.lateness_s),
    }
    bus = health.bus
    if bus is None:
        return values
    return values | {
        "bus_round_trip_ms": _percentiles_ms(health.round_trip_s),
        "bus_sent": str(bus.sent),
        "bus_replies": str(bus.replies),
        "bus_timeouts": str(bus.timeouts),
        "bus_discarded_bytes": str(bus.discarded_bytes),
        "bus_retries": str(bus.retries),
    }


def _percentiles_ms(values_s: Sequence[float]) -> str:
    p50, p99, greatest = (1e3 * value_s for value_s in values_s)
    return f"p50 {p50:.3f}, p99 {p99:.3f}, max {greatest:.3f}"


def _joint_status(joint: JointHealth, *, stale: bool, faulty: bool) -> dict[str, Any]:
    level, message = LEVEL_OK, "no complaints"
    if faulty:
        level, message = LEVEL_ERROR, "; ".join(("the arm's fault is about this joint", *joint.warnings))
    elif stale or joint.age_s > SERVO_STALE_AFTER_S:
        level, message = LEVEL_STALE, "; ".join(joint.warnings) or "the servo is not being read"
    elif joint.warnings:
        level, message = LEVEL_WARN, "; ".join(joint.warnings)
    return {
        "level": level,
        "name": f"arm: {joint.joint}",
        "message": message,
        "hardware_id": joint.hardware_id,
        "values": key_values(_joint_values(joint)),
    }


def _joint_values(joint: JointHealth) -> dict[str, str]:
    """Values of a joint; those that its hardware does not measure are left out."""
    torque = {None: "unknown", True: "on", False: "off"}[joint.torque_enabled]
    measured = {
        "position_rad": (joint.position_rad, ".4f"),
        "load": (joint.load, ".3f"),
        "temperature_c": (joint.temperature_c, ".0f"),
        "voltage_v": (joint.voltage_v, ".1f"),
        "current_a": (joint.current_a, ".3f"),
    }
    return {
        **{name: format(value, spec) for name, (value, spec) in measured.items() if not math.isnan(value)},
        "torque": torque,
        "status_bits": str(joint.status),
        "age_s": f"{joint.age_s:.3f}",
        "silent_cycles": str(joint.silent_cycles),
    }
