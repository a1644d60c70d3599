"""Time of a simulated arm that is faster than the machine's, on ``/clock``, as for ROS nodes with use_sim_time."""

from protocol.messages import Stamp
from robot.messages import ArmState
from server.features.context import ServerContext
from server.lifecycle import Feature

TOPIC = "/clock"


class SimulatedTime(Feature):
    """Publishes the stamp of each state of the arm."""

    name = "the simulated time"

    def __init__(self, context: ServerContext) -> None:
        self._node = context.graph.node("clock")
        self._node.advertise(TOPIC, "rosgraph_msgs/Clock")

    @property
    def observes_states(self) -> bool:
        return bool(self._node.subscribers(TOPIC))

    def on_state(self, _arm: str, state: ArmState) -> None:
        """Publish the time of the only arm."""
        self._node.publish(TOPIC, {"clock": Stamp.from_seconds(state.stamp_s).as_message()})
