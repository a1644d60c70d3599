"""Arms that follow leaders: other arms of this server, or topics."""

from __future__ import annotations

from robot.messages import ArmState
from server.features.context import ServerContext
from server.lifecycle import Feature
from server.moveit.servo.servo_node import servo_setup
from server.teleop.session import Follower, FollowingContext
from server.teleop.teleoperation import Teleoperation

# Name, for clients, of a follower that is the only arm.
ONLY_ARM = "arm"


class Following(Feature):
    """Teleoperation: each arm that does not lead can follow."""

    name = "teleoperation"

    def __init__(self, context: ServerContext) -> None:
        planning = context.planning
        followers = [
            Follower(
                each.name or ONLY_ARM,
                each.served.prefix,
                each.robot,
                arm,
                servo_setup(planning.robot, each.parameters),
                each.gripper,
            )
            for each, arm in context.single_arms
            if not each.served.leads
        ]
        leaders = [each.name for each, _ in context.single_arms if each.served.leads]
        following = FollowingContext(planning, context.goals.queue, context.whole.go_to)
        self.teleoperation = Teleoperation(context.graph, following, followers, leaders)

    async def stop(self) -> None:
        await self.teleoperation.close()

    def on_state(self, arm: str, state: ArmState) -> None:
        # A leader is followed without waiting for the states of other arms.
        self.teleoperation.take_leader_state(arm, state)

    @property
    def observes_states(self) -> bool:
        return self.teleoperation.active
