"""Orders to each arm, its state and its control, by its own names."""

from __future__ import annotations

from robot.messages import ArmHealth, ArmState
from server.access.control_lease import ControlServices
from server.arm.arms import read_now
from server.arm.services import ArmPace, ArmServices
from server.arm.topics import TOPIC as JOINT_STATES
from server.arm.topics import ArmStateTopics, JointStates
from server.features.context import ServerContext
from server.lifecycle import Feature


class ArmControl(Feature):
    """Services that switch, stop and pace an arm, topics of its state, and the lease of its control."""

    name = "control"

    def __init__(self, context: ServerContext) -> None:
        self._arms = {each.name: each for each in context.arms}
        self._joint_states = {each.name: JointStates(each.graph) for each in context.arms}
        self._states = {
            each.name: ArmStateTopics(
                each.graph, each.robot, each.served.arm.state, each.served.description.calibration
            )
            for each in context.arms
        }
        self._control = []
        for each in context.arms:
            ArmServices(each.graph, each.served.arm, each.stop)
            ArmPace(each.graph, each.served.arm)
            lease = context.access.leases_of_arms.get(each.name, context.access.lease)
            self._control.append(ControlServices(each.graph, lease))

    async def stop(self) -> None:
        for each in self._control:
            each.close()

    def on_state(self, arm: str, state: ArmState) -> None:
        each = self._arms[arm]
        # The joints of all arms are published without subscribers too, for a recording. One arm's own would cost as
        # much again.
        if not arm or each.graph.subscribers(JOINT_STATES):
            self._joint_states[arm].publish(read_now(each.served.arm, state))
        self._states[arm].take_state(state, each.served.arm.last_stop)

    def on_health(self, arm: str, health: ArmHealth) -> None:
        self._states[arm].take_health(health)
