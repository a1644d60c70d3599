"""Parts of a server as operations look at them, made by hand."""

from dataclasses import dataclass
from typing import Any

from robot.faults import Fault, FaultCode
from robot.messages import ArmHealth, ArmState, BusCounters, JointHealth, Mode
from server.gateway.connection import Traffic
from server.monitoring.health import Sources
from server.monitoring.monitor import GoalCounters

JOINTS = ("shoulder_pan", "gripper")

# The time of what is watched, by each clock.
NOW_S = 1000.0


@dataclass
class _WatchedArm:
    state: ArmState
    state_age_s: float = 0.01
    state_max_age_s: float = 1.0


@dataclass
class _WatchedPlanners:
    load_failure: str | None = None
    loaded_count: int = 2
    waiting_count: int = 3


@dataclass
class _WatchedRecorder:
    dropped: int = 0


@dataclass
class _WatchedQueue:
    waiting_count: int = 2
    active_count: int = 1


# They stand for parts of which the monitor reads no more than these fields.
WatchedArm: Any = _WatchedArm
WatchedPlanners: Any = _WatchedPlanners
WatchedRecorder: Any = _WatchedRecorder
WatchedQueue: Any = _WatchedQueue


def arm_state(mode: Mode = Mode.HOLDING, fault: FaultCode | None = None, reason: str = "") -> ArmState:
    """A state; its words name what a stranger should not hear of."""
    found = None if fault is None else Fault(fault, "servo 3 on /dev/ttySECRET is hot", "elbow_flex")
    return ArmState(NOW_S, mode, JOINTS, reason=reason, fault=found)


def arm_health() -> ArmHealth:
    """A condition."""
    servos = tuple(
        JointHealth(joint, f"servo {number}", 0.1, 30 + number, 5.0, 0.25, -0.5, True, 0, 0.002, 4)
        for number, joint in enumerate(JOINTS, 1)
    )
    bus = BusCounters(sent=100, replies=90, timeouts=10, discarded_bytes=11, retries=12)
    return ArmHealth(
        NOW_S, Mode.HOLDING, "/dev/ttySECRET", servos, bus, (0.0001, 0.001, 0.002), (0.003, 0.004, 0.005), True
    )


def watched_sources() -> Sources:
    """Every part of a server at work."""
    return Sources(
        Traffic(),
        GoalCounters(),
        WatchedQueue(),
        WatchedArm(arm_state()),
        arm_health(),
        WatchedPlanners(),
        WatchedRecorder(),
        WatchedRecorder(),
        started=True,
    )
