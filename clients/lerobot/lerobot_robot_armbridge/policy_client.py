"""lerobot's RobotClient, whose chunks of actions the arm's server follows whole: ``armbridge-policy``.

The policy runs in lerobot's PolicyServer, on this machine or another one. Its protocol carries pickled objects: connect
only to a policy server that you trust.
"""

from __future__ import annotations

import logging
import threading

import draccus
from lerobot.async_inference.configs import RobotClientConfig
from lerobot.async_inference.helpers import TimedAction
from lerobot.async_inference.robot_client import RobotClient
from lerobot.utils.import_utils import register_third_party_plugins

from armbridge_client import ArmError, RequestRefused
from lerobot_robot_armbridge.armbridge import Armbridge
from lerobot_robot_armbridge.link import ArmLink

log = logging.getLogger(__name__)

# lerobot's functions that join actions, as blend and share of the new chunk.
BLENDS = {
    "latest_only": ("replace", 0.0),
    "average": ("ensemble", 0.5),
    "weighted_average": ("ensemble", 0.7),
    "conservative": ("ensemble", 0.3),
}

# A first target that is further away is reached by a planned motion [rad].
NEAR_RAD = 0.2
START_SPEED = 0.3


class ChunkClient(RobotClient):
    """RobotClient that sends chunks, and counts the steps of actions instead of sending them one by one."""

    def __init__(self, config: RobotClientConfig) -> None:
        super().__init__(config)
        if not isinstance(self.robot, Armbridge):
            self.robot.disconnect()
            raise TypeError(f"robot.type: must be armbridge, not {config.robot.type}")
        self._link: ArmLink = self.robot.link
        self._blend, self._weight = BLENDS[config.aggregate_fn_name]
        self._chunks = self._link.arm.chunks().__enter__()
        self._started = False
        self.failure = ""

    def stop(self) -> None:
        """Disconnect; the arm brakes to the last target and holds."""
        self._chunks.__exit__(None, None, None)
        super().stop()

    def control_loop_action(self, verbose: bool = False) -> dict[str, float]:  # noqa: ARG002 - lerobot's signature
        """Count a step: the server follows the targets by their times."""
        with self.action_queue_lock:
            self.action_queue_size.append(self.action_queue.qsize())
            action: TimedAction = self.action_queue.get_nowait()
        with self.latest_action_lock:
            self.latest_action = action.get_timestep()
        return self._action_tensor_to_action_dict(action.get_action())

    def _aggregate_action_queues(self, incoming_actions: list[TimedAction], aggregate_fn: object = None) -> None:  # noqa: ARG002 - lerobot's signature
        # The server blends the chunks; of lerobot's queue the numbers of the steps are needed.
        super()._aggregate_action_queues(incoming_actions, None)
        try:
            self._follow(incoming_actions)
        except RequestRefused as error:
            log.warning("a chunk is not followed: %s", error)
            if "the arm was stopped" in str(error):
                self._end(str(error))
        except (ArmError, ValueError) as error:
            self._end(str(error))

    def _follow(self, actions: list[TimedAction]) -> None:
        first_s = actions[0].get_timestamp()
        rows_rad = [self._link.in_rad(self._action_tensor_to_action_dict(each.get_action())) for each in actions]
        if not self._started:
            self._go_to(rows_rad[0])
            # The chunk was made before: the policy looks again.
            with self.action_queue_lock:
                self.action_queue.queue.clear()
            self._started = True
            return
        names = list(rows_rad[0])
        answer = self._chunks.send(
            names,
            [each.get_timestamp() - first_s for each in actions],
            [[row[name] for name in names] for row in rows_rad],
            observed_at_s=first_s,
            blend=self._blend,
            weight=self._weight,
        )
        if answer.refused_from >= 0:
            log.warning("a chunk is followed in part: %s", answer.message)

    def _go_to(self, target_rad: dict[str, float]) -> None:
        """Go to the first target by a planned motion, unless the arm is near it."""
        present_rad = self._link.in_rad(self._link.positions())
        far = {
            name: target
            for name, target in target_rad.items()
            if "gripper" not in name and abs(target - present_rad[name]) > NEAR_RAD
        }
        if far:
            arm_rad = {name: target for name, target in target_rad.items() if "gripper" not in name}
            log.info("the arm goes to the first target, %s", ", ".join(sorted(far)))
            self._link.arm.move_joints(arm_rad, speed=START_SPEED)

    def _end(self, failure: str) -> None:
        log.error("the policy ends: %s", failure)
        self.failure = failure
        self.shutdown_event.set()


def run(config: RobotClientConfig) -> None:
    """Run a policy of a PolicyServer on the arm, until Ctrl-C, a stop or an error."""
    client = ChunkClient(config)
    try:
        if not client.start():
            raise SystemExit(f"no policy server answers at {config.server_address}")
        receiver = threading.Thread(target=client.receive_actions, daemon=True)
        receiver.start()
        client.control_loop(task=config.task)
    except KeyboardInterrupt:
        log.info("ended by Ctrl-C")
    finally:
        client.stop()
    if client.failure:
        raise SystemExit(client.failure)


def main() -> None:
    """Start from the command line."""
    logging.basicConfig(level=logging.INFO)
    register_third_party_plugins()
    run(draccus.parse(RobotClientConfig))
