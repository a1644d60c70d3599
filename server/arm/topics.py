"""State of the arm as topics: ``/joint_states``, and the latched ``/arm/state`` and ``/arm/joint_limits``."""

from typing import Any

from protocol.messages import Stamp
from robot.calibration import Calibration
from robot.description.model import RobotModel
from robot.faults import Fault
from robot.messages import ArmHealth, ArmState, Mode, Pace
from server.diagnostic_values import LEVEL_ERROR, LEVEL_OK, LEVEL_WARN, key_values
from server.execution.monitors import ENABLE, RESET_FAULT
from server.graph.topics import Graph, LocalGraph

TOPIC = "/joint_states"

# Topics that are published with every state, or with every other: it, also of one of several arms, /tf, and
# controllers' states.
_FREQUENT = (TOPIC, "/tf", "_controller/controller_state", "_controller/state")


def states_are_observed(graph: Graph) -> bool:
    """Return True while somebody subscribes to a topic that is published with the arm's states."""
    return any(graph.subscribers(topic) for topic in graph.topic_names.types() if topic.endswith(_FREQUENT))


STATE_TOPIC = "/arm/state"
LIMITS_TOPIC = "/arm/joint_limits"

_SENTENCES = {
    Mode.DISCONNECTED: "the arm is not connected",
    Mode.CONNECTED: "the servos are being checked",
    Mode.RELAXED: "the arm is relaxed; {prefix}" + ENABLE + " makes it hold",
    Mode.HOLDING: "the arm holds",
    Mode.MOVING: "the arm moves",
    Mode.FAULT: "the arm has a fault",
}
# Start of the keys with the calibrated range of each joint, "LOWER UPPER" [rad].
CALIBRATED_RANGE = "calibrated_range_rad."

_LEVELS = {Mode.DISCONNECTED: LEVEL_ERROR, Mode.CONNECTED: LEVEL_WARN, Mode.FAULT: LEVEL_ERROR}


class ArmStateTopics:
    """Publishes the arm's mode, fault and pace, its calibrated ranges without margin, its joints and their limits."""

    def __init__(
        self, graph: LocalGraph, robot: RobotModel, state: ArmState, calibration: Calibration | None = None
    ) -> None:
        self._ranges = {
            f"{CALIBRATED_RANGE}{each.joint}": f"{each.lower_rad:.5f} {each.upper_rad:.5f}"
            for each in (calibration.joints if calibration else ())
        }
        self._robot = robot
        self._node, self._joints = graph.node("arm state"), graph.node("arm")
        # Contents of the last message.
        self._shown: tuple[Mode, str, Fault | None, Pace, int] | None = None
        self._limits: dict[str, Any] | None = None
        self._joints.advertise(TOPIC, "sensor_msgs/JointState")
        self._node.advertise(STATE_TOPIC, "diagnostic_msgs/DiagnosticStatus", latch=True)
        self._node.advertise(LIMITS_TOPIC, "moveit_msgs/KinematicSolverInfo", latch=True)
        self._publish_limits({joint.name: (joint.lower, joint.upper) for joint in robot.movable_joints})
        self.take_state(state)

    def take_state(self, state: ArmState, last_stop: int = 0) -> None:
        """Publish a state when it says something new, such as the stop epoch of the arm's last stop."""
        shown = state.mode, state.reason, state.fault, state.pace, last_stop
        if shown != self._shown:
            self._shown = shown
            message = status(state, self._robot.name, self._node.resolve(""))
            message["values"] += key_values({"last_stop": str(last_stop)} | self._ranges)
            self._node.publish(STATE_TOPIC, message)

    def publish_joints(self, state: ArmState) -> None:
        """Publish the joints of a state; a disconnected arm has none.

        Effort is the share of full motor duty, -1..1: the servos measure no torque.
        """
        if state.position_rad is None or state.velocity_rad_s is None or state.load is None:
            return
        message: dict[str, Any] = {
            "header": {"stamp": Stamp.from_seconds(state.stamp_s).as_message(), "frame_id": ""},
            "name": list(state.joint_names),
            "position": state.position_rad.tolist(),
            "velocity": state.velocity_rad_s.tolist(),
            "effort": state.load.tolist(),
        }
        self._joints.publish(TOPIC, message)

    def take_health(self, health: ArmHealth) -> None:
        """Publish the limits that the arm process keeps, when they are others."""
        if health.limits_rad is not None:
            names = [joint.joint for joint in health.joints]
            self._publish_limits(
                {name: (low, high) for name, (low, high) in zip(names, health.limits_rad.tolist(), strict=True)}
            )

    def _publish_limits(self, ranges_rad: dict[str, tuple[float, float]]) -> None:
        message = {
            "joint_names": list(ranges_rad),
            "limits": [
                {
                    "joint_name": name,
                    "has_position_limits": True,
                    "min_position": lower,
                    "max_position": upper,
                    "has_velocity_limits": True,
                    "max_velocity": self._robot.joints[name].max_velocity,
                    "has_acceleration_limits": True,
                    "max_acceleration": self._robot.joints[name].max_acceleration,
                }
                for name, (lower, upper) in ranges_rad.items()
            ],
        }
        if message != self._limits:
            self._limits = message
            self._node.publish(LIMITS_TOPIC, message)


def status(state: ArmState, robot_name: str, prefix: str = "") -> dict[str, Any]:
    """The diagnostic_msgs/DiagnosticStatus of a state; figures that change all the time are not in it."""
    message = _SENTENCES[state.mode].format(prefix=prefix)
    if state.fault is not None:
        message = f"{state.fault} The service that resets it is {prefix}{RESET_FAULT}."
    elif state.reason:
        message = f"{message}: {state.reason}"
    values = {
        "mode": state.mode.value,
        "reason": state.reason,
        "task": state.task,
        "course": state.pace.direction.value,
        "speed_factor": f"{state.pace.speed_factor:g}",
        "speed_limit": f"{state.pace.speed_limit:g}",
    }
    if state.fault is not None:
        values |= {
            "fault": state.fault.code.value,
            "fault_message": state.fault.message,
            "fault_remedy": state.fault.remedy,
            "fault_joint": state.fault.joint,
            "fault_stamp": f"{state.fault.stamp_s:.3f}",
        }
    return {
        "level": _LEVELS.get(state.mode, LEVEL_OK),
        "name": "arm",
        "message": message,
        "hardware_id": robot_name,
        "values": key_values(values),
    }
