"""Condition of the server as ROS topics: ``/diagnostics`` once a second, and the log on ``/rosout``.

A service changes the loggers' levels, as ROS 2 nodes have one.
"""

import asyncio
import dataclasses
import logging
import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from protocol.messages import ListLimits, Stamp
from robot import logs
from robot.faults import ADVICE, Fault, ServoAlert, advise
from robot.hardware.config import SIMULATED_PORTS
from robot.hardware.interface import status_names
from robot.logs import MAX_CHANGED_LOGGERS, OUR_LOGGER, LoggerLevel, message_of
from robot.messages import ArmHealth, ArmState, JointHealth, Mode
from server.arm.interface import status
from server.diagnostic_values import LEVEL_ERROR, LEVEL_OK, LEVEL_WARN, diagnostic_status, key_values
from server.graph.permissions import CONFIGURING
from server.graph.topics import Graph

log = logging.getLogger("armbridge.monitoring")

TOPIC = "/diagnostics"

# diagnostic_msgs/DiagnosticStatus: no recent values.
LEVEL_STALE = 3

PERIOD_S = 1.0

# Beginning of the names of the joints' statuses.
JOINT_PREFIX = "arm: "

# Three missing reports; diagnostic_aggregator waits longer, 5 s. A simulated arm that runs slower than real time sends
# its reports more rarely in proportion.
STALE_AFTER_S = 3.0

# A simulated arm with a smaller real-time factor is reported as slow.
SLOW_FACTOR = 0.9

# A servo is read a hundred times a second.
SERVO_STALE_AFTER_S = 1.0

# Lost replies for which cables deserve a look, and their share; single ones get lost on a good arm.
MANY_LOST = 20
LOST_SHARE = 0.01


class Diagnostics:
    """Publishes the latest health of the arm, also when no new report comes."""

    def __init__(self, graph: Graph, robot_name: str, fault_file: Callable[[], Path | None]) -> None:
        self._robot_name = robot_name
        self._fault_file = fault_file
        self._node = graph.node("diagnostics")
        self._state: ArmState | None = None
        self._state_at_s = 0.0
        self._health: ArmHealth | None = None
        self._node.advertise(TOPIC, "diagnostic_msgs/DiagnosticArray")

    async def run(self) -> None:
        """Publish regularly from the first state on, until cancelled."""
        while True:
            await asyncio.sleep(PERIOD_S)
            self.publish()

    def take_state(self, state: ArmState) -> None:
        self._state, self._state_at_s = state, self._node.clock()

    def take_health(self, health: ArmHealth) -> None:
        self._health = health

    def publish(self) -> None:
        """Publish the arm first, then its servos; nothing before the first state."""
        state, health, now_s = self._state, self._health, self._node.clock()
        if state is None:
            return
        arm, state_age_s, fault_file = status(state, self._robot_name), now_s - self._state_at_s, self._fault_file()
        if fault_file is not None:
            arm["values"] += key_values({"fault_file": str(fault_file)})
        if state_age_s > STALE_AFTER_S:
            arm |= {"level": LEVEL_STALE, "message": f"the last state of the arm is {state_age_s:.1f} s old"}
        statuses = [arm]
        if health is not None:
            age_s = (now_s - health.monotonic_s) * min(health.real_time_factor, 1.0)
            stale = state.mode is Mode.DISCONNECTED or age_s > STALE_AFTER_S
            arm["values"] += key_values(_arm_values(health))
            if health.real_time_factor < SLOW_FACTOR * health.rate and arm["level"] == LEVEL_OK:
                wanted = "" if health.rate == 1.0 else f", not {health.rate:.0%}"
                share = f"{health.real_time_factor:.0%} of real time{wanted}"
                arm |= {"level": LEVEL_WARN, "message": f"{arm['message']}, at {share}: this machine is busy"}
            statuses += [_joint_status(joint, health, state.fault, stale=stale) for joint in health.joints]
            arm["level"] = max(arm["level"], *(min(each["level"], LEVEL_WARN) for each in statuses))
        stamp = self._node.message_types.now().as_message()
        self._node.publish(TOPIC, {"header": {"stamp": stamp, "frame_id": ""}, "status": statuses})


def _arm_values(health: ArmHealth) -> dict[str, str]:
    values = {
        "port": health.port,
        "real_time_priority": str(health.real_time).lower(),
        "memory_locked": str(health.memory_locked).lower(),
        "real_time_factor": f"{health.real_time_factor:.2f}",
        "loop_lateness_ms": _percentiles_ms(health.lateness_s),
    }
    if health.bus is None:
        return values
    counts = {f"bus_{name}": str(count) for name, count in dataclasses.asdict(health.bus).items()}
    return values | {"bus_round_trip_ms": _percentiles_ms(health.round_trip_s)} | counts


def _percentiles_ms(values_s: Sequence[float]) -> str:
    p50, p99, greatest = (1e3 * value_s for value_s in values_s)
    return f"p50 {p50:.3f}, p99 {p99:.3f}, max {greatest:.3f}"


def _joint_status(joint: JointHealth, health: ArmHealth, fault: Fault | None, *, stale: bool) -> dict[str, Any]:
    level, message = LEVEL_OK, "no complaints"
    own_fault = fault if fault is not None and fault.joint == joint.joint else None
    warnings = [warning.sentence for warning in joint.warnings]
    if own_fault is not None:
        level, message = LEVEL_ERROR, "; ".join(("the arm's fault is about this joint", *warnings))
    elif stale or joint.age_s > SERVO_STALE_AFTER_S:
        level, message = LEVEL_STALE, "; ".join(warnings) or "the servo is not being read"
    elif warnings:
        level, message = LEVEL_WARN, "; ".join(warnings)
    values = _joint_values(joint) | _register_values(joint, health, own_fault)
    return diagnostic_status(level, f"{JOINT_PREFIX}{joint.joint}", message, values, joint.hardware_id)


def _joint_values(joint: JointHealth) -> dict[str, str]:
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


def _register_values(joint: JointHealth, health: ArmHealth, fault: Fault | None) -> dict[str, str]:
    """Return the servo's registers, its errors by kind, and what to do about these and its warnings."""
    values = {f"register/{name}": str(value) for name, value in joint.registers.items()}
    values |= {f"expected/{name}": str(value) for name, value in joint.expected.items()}
    errors = {"silent_cycles": joint.silent_cycles, **joint.errors}
    values |= {f"error/{kind}": str(count) for kind, count in errors.items()}
    advice = [] if fault is None else [str(fault)]
    # The fault's sentence has its own remedy already.
    advised = {alert for alert, each in ADVICE.items() if fault is not None and each.do is fault.code}
    others = [alert for alert in _alerts(joint, health) if alert not in advised]
    advice += advise(others, simulated=health.port in SIMULATED_PORTS)
    if advice:
        values["advice"] = "\n".join(advice)
    return values


def _alerts(joint: JointHealth, health: ArmHealth) -> Iterator[ServoAlert]:
    yield from (warning.alert for warning in joint.warnings)
    yield from (ServoAlert(name) for name in status_names(joint.status))
    yield from (ServoAlert(kind) for kind in joint.errors)
    # A cycle sends a read, and writes while the arm is driven.
    if health.bus is not None and joint.silent_cycles > max(MANY_LOST, LOST_SHARE * health.bus.sent):
        yield ServoAlert.SILENT_CYCLES


ROSOUT_TOPIC = "/rosout"

# Records that a new subscriber gets; ROS 2 keeps 1000 for 10 s (rcl/logging_rosout.h).
LOG_DEPTH = 100

# A longer burst repeats itself; records that are left out are still in the log itself.
MAX_WAITING = 1000

SET_LEVELS = "/armbridge/set_logger_levels"

# rcl_interfaces/LoggerLevel counts as Python does; 0 leaves the level to the parent logger.
LEVELS = {
    0: "unset",
    logging.DEBUG: "debug",
    logging.INFO: "info",
    logging.WARNING: "warn",
    logging.ERROR: "error",
    logging.CRITICAL: "fatal",
}

# Loggers in one request; there are a few dozen.
MAX_REQUESTED = 200

_OURS = re.compile(rf"{OUR_LOGGER}(\.[a-z0-9_]{{1,40}}){{0,4}}")


class Rosout(logging.Handler):
    """Publishes every record of the server's log, from its construction to :meth:`close`."""

    def __init__(self, graph: Graph, loop: asyncio.AbstractEventLoop) -> None:
        super().__init__()
        self._loop = loop
        self._node = graph.node("rosout")
        self._waiting = 0
        self._node.advertise(ROSOUT_TOPIC, "rcl_interfaces/msg/Log", depth=LOG_DEPTH)
        logging.getLogger(OUR_LOGGER).addHandler(self)

    def close(self) -> None:
        logging.getLogger(OUR_LOGGER).removeHandler(self)
        super().close()

    def emit(self, record: logging.LogRecord) -> None:
        """Publish a record soon; never at once, as it may be about the very message that is being published."""
        if self._waiting >= MAX_WAITING or self._loop.is_closed():
            return
        self._waiting += 1
        self._loop.call_soon_threadsafe(self._publish, log_message(record))

    def _publish(self, message: dict[str, Any]) -> None:
        self._waiting -= 1
        self._node.publish(ROSOUT_TOPIC, message)


def log_message(record: logging.LogRecord) -> dict[str, Any]:
    """Return the rcl_interfaces/Log of a record; Python and ROS count levels alike, 10 to 50."""
    return {
        "stamp": Stamp.from_seconds(record.created).as_message(),
        "level": max(10, min(50, record.levelno // 10 * 10)),
        "name": record.name,
        "msg": message_of(record),
        "file": record.filename,
        "function": record.funcName or "",
        "line": record.lineno,
    }


def offer_level_service(graph: Graph) -> None:
    type_name = "rcl_interfaces/srv/SetLoggerLevels"
    limits = ListLimits({f"{type_name}_Request.levels": MAX_REQUESTED})
    graph.node(OUR_LOGGER).offer(SET_LEVELS, type_name, _set_levels, limits=limits, rule=CONFIGURING)


def _set_levels(request: dict[str, Any]) -> dict[str, Any]:
    reasons = [_change(each["name"], each["level"]) for each in request["levels"]]
    return {"results": [{"successful": not reason, "reason": reason} for reason in reasons]}


def _change(name: str, level: int) -> str:
    if not _OURS.fullmatch(name):
        return f"name: must be {OUR_LOGGER} or a logger below it, as {OUR_LOGGER}.gateway, not {name[:80]!r}"
    if level not in LEVELS:
        return f"level: must be one of {', '.join(map(str, LEVELS))}, not {level}"
    if not logs.change(LoggerLevel(name, level)):
        return f"name: the levels of {MAX_CHANGED_LOGGERS} loggers have been changed already, the limit"
    log.warning("the level of %s is %s now", name, LEVELS[level])
    return ""
