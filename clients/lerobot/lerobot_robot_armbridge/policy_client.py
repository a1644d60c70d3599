"""Runner of a learned policy, whose chunks of actions the arm's server follows whole: ``armbridge-policy``.

The policy runs in this process, in lerobot's PolicyServer or in openpi's server. lerobot's protocol carries pickled
objects: connect only to a policy server that you trust.
"""

from __future__ import annotations

import json
import logging
import time
from dataclasses import dataclass, field
from pathlib import Path

import draccus
from lerobot.robots import RobotConfig, make_robot_from_config
from lerobot.utils.import_utils import register_third_party_plugins

from armbridge_client import ArmError, ControlledByOther, NotPermitted, RequestRefused, after_stop
from armbridge_client.arm import Chunks
from armbridge_client.messages import DiagnosticStatus
from lerobot_robot_armbridge.armbridge import Armbridge
from lerobot_robot_armbridge.config_armbridge import ArmbridgeConfig
from lerobot_robot_armbridge.link import Watch
from lerobot_robot_armbridge.openpi import OpenPiOptions, OpenPiPolicy
from lerobot_robot_armbridge.policies import LocalPolicy, Observation, Policy, PolicyError, ServedPolicy
from lerobot_robot_armbridge.units import ARM_PATH

log = logging.getLogger(__name__)

# lerobot's functions that join actions, and real-time chunking, as blend and share of the new chunk.
BLENDS = {
    "latest_only": ("replace", 0.0),
    "average": ("ensemble", 0.5),
    "weighted_average": ("ensemble", 0.7),
    "conservative": ("ensemble", 0.3),
    "real_time": ("real_time", 0.0),
}

# A first target that is further away is reached by a planned motion [rad].
NEAR_RAD = 0.2
START_SPEED = 0.3

# The server follows no more points of a chunk.
MAX_ACTIONS = 500

# lerobot-train writes its options beside the policy.
TRAINING_FILE = "train_config.json"

# Phases in which the server refuses chunks, until the policy is resumed; they are looked at in this period [s].
HELD = ("paused", "taken_over")
POLL_S = 0.05
# A client that has control keeps it for seconds at least [s].
CONTROL_POLL_S = 1.0


@dataclass
class PolicyClientConfig:
    """Options of ``armbridge-policy``, which has the names of lerobot's RobotClient for its options.

    Attributes:
        policy: folder or hub name of a policy of lerobot that runs in this process.
        pretrained_name_or_path: as lerobot's PolicyServer at ``server_address`` finds a policy of ``policy_type``.
        openpi: openpi's server.
        policy_device: device of the policy, here or in the PolicyServer.
        actions_per_chunk: number of actions of each chunk that are followed, at most 500.
        fps: rate of the policy's actions [Hz].
        chunk_size_threshold: share of a chunk that is left when the policy looks again, 0 to 1.
        aggregate_fn_name: blend of a chunk with the one before it.
    """

    robot: RobotConfig
    task: str = ""
    policy: str = ""
    openpi: OpenPiOptions = field(default_factory=OpenPiOptions)
    pretrained_name_or_path: str = ""
    policy_type: str = ""
    server_address: str = "localhost:8080"
    policy_device: str = "cpu"
    actions_per_chunk: int = 50
    fps: float = 30.0
    chunk_size_threshold: float = 0.5
    aggregate_fn_name: str = "weighted_average"

    def check(self) -> None:
        """Raise ValueError with the option that is out of its limits."""
        sources = {
            "policy": self.policy,
            "openpi.url": self.openpi.url,
            "pretrained_name_or_path": self.pretrained_name_or_path,
        }
        if len(given := [name for name, value in sources.items() if value]) != 1:
            raise ValueError(f"one of {', '.join(sources)} must be given, not {' and '.join(given) or 'none'}")
        if not 1 <= self.actions_per_chunk <= MAX_ACTIONS:
            raise ValueError(f"actions_per_chunk must be 1 to {MAX_ACTIONS}, not {self.actions_per_chunk}")
        if not 0.0 < self.fps <= MAX_ACTIONS:
            raise ValueError(f"fps must be above 0 to {MAX_ACTIONS}, not {self.fps:g}")
        if not 0.0 <= self.chunk_size_threshold <= 1.0:
            raise ValueError(f"chunk_size_threshold must be 0 to 1, not {self.chunk_size_threshold:g}")
        if self.aggregate_fn_name not in BLENDS:
            raise ValueError(f"aggregate_fn_name must be one of {', '.join(BLENDS)}, not {self.aggregate_fn_name!r}")


def policy_of(config: PolicyClientConfig, robot: Armbridge) -> Policy:
    """Return the policy that the options name; raises PolicyError."""
    if config.policy:
        return LocalPolicy(config.policy, config.policy_device, robot)
    if config.openpi.url:
        return OpenPiPolicy(config.openpi, robot.link.server_names)
    return ServedPolicy(
        config.server_address,
        config.policy_type,
        config.pretrained_name_or_path,
        config.policy_device,
        robot,
        config.actions_per_chunk,
    )


class PolicyRunner:
    """Loop from observations to chunks that the arm's server follows.

    While the policy computes, the arm follows the chunk before; without a next one it brakes to the last target.
    """

    def __init__(self, config: PolicyClientConfig, robot: Armbridge, policy: Policy, chunks: Chunks) -> None:
        self._config, self._policy, self._chunks = config, policy, chunks
        self._robot, self._link = robot, robot.link
        self._state = Watch(robot.link.arm, f"{robot.link.prefix}/arm/chunks/state", DiagnosticStatus)
        self._near = False
        # Last stop before the policy began, or was resumed: a later one ends it, however long it computes or waits.
        self._stops = self._link.stops

    def run(self) -> None:
        """Run until an error: PolicyError, ArmError, or TimeoutError of a camera or the joint states."""
        while True:
            self._wait_while_held()
            try:
                with after_stop(self._stops):
                    self._follow_next_chunk()
            except ControlledByOther as error:
                log.info("the policy waits: %s", error)
                time.sleep(CONTROL_POLL_S)
                self._near = False

    def _follow_next_chunk(self) -> None:
        config, looked_s = self._config, time.monotonic()
        observation = self._observe()
        targets_rad = self._targets_rad(observation)
        if not self._near:
            self._near = True
            if self._go_to(targets_rad[0]):
                # The chunk was made before the motion: the policy looks again.
                return
        self._send(observation.stamp_s, targets_rad)
        followed_s = (1.0 - config.chunk_size_threshold) * len(targets_rad) / config.fps
        time.sleep(max(looked_s + followed_s - time.monotonic(), 0.0))

    @property
    def _held(self) -> str:
        """Sentence of a pause or take-over; empty while chunks are followed."""
        state = self._state.latched()
        phase = next((each.value for each in state.values if each.key == "phase"), "")
        return state.message if phase in HELD else ""

    def _wait_while_held(self) -> None:
        if not self._held:
            return
        log.info("the policy waits: %s", self._held)
        stops = self._link.stops
        while self._held:
            # From before it was seen held: a stop just after the person has resumed the policy is a later one.
            self._stops = stops
            time.sleep(POLL_S)
            stops = self._link.stops
        log.info("the policy goes on")
        self._policy.reset()
        self._near = False

    def _observe(self) -> Observation:
        stamp_s, positions_rad = self._link.state()
        images = {name: camera.read_latest() for name, camera in self._robot.cameras.items()}
        return Observation(stamp_s, self._link.in_units(positions_rad), positions_rad, images, self._config.task)

    def _targets_rad(self, observation: Observation) -> list[dict[str, float]]:
        actions = self._policy.actions(observation)[: self._config.actions_per_chunk]
        names = self._link.server_names
        if self._policy.radians:
            return [dict(zip(names.values(), row, strict=True)) for row in actions.tolist()]
        return [
            self._link.in_rad({f"{joint}.pos": value for joint, value in zip(names, row, strict=True)})
            for row in actions.tolist()
        ]

    def _send(self, stamp_s: float, targets_rad: list[dict[str, float]]) -> None:
        names = list(targets_rad[0])
        blend, weight = BLENDS[self._config.aggregate_fn_name]
        try:
            answer = self._chunks.send(
                names,
                [index / self._config.fps for index in range(len(targets_rad))],
                [[row[name] for name in names] for row in targets_rad],
                observed_at_s=stamp_s,
                blend=blend,
                weight=weight,
            )
        except (ControlledByOther, NotPermitted):
            raise
        except RequestRefused as error:
            if "the arm was stopped" in str(error):
                raise
            log.warning("a chunk is not followed: %s", error)
            self._near = False
            return
        if answer.refused_from >= 0:
            log.warning("a chunk is followed in part: %s", answer.message)

    def _go_to(self, target_rad: dict[str, float]) -> bool:
        """Go to a target by a planned motion; return False for an arm that is near it."""
        present_rad = self._link.state()[1]
        arm_rad = {name: target for name, target in target_rad.items() if "gripper" not in name}
        far = [name for name, target in arm_rad.items() if abs(target - present_rad[name]) > NEAR_RAD]
        if far:
            log.info("the arm goes to the first target, %s", ", ".join(far))
            self._link.arm.move_joints(arm_rad, speed=START_SPEED)
        return bool(far)


def trained_on(policy: str) -> Path | None:
    """Return the folder of the export that a policy was trained on by lerobot-train; None where it is not here."""
    try:
        root = json.loads((Path(policy) / TRAINING_FILE).read_text())["dataset"]["root"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Path(root) if isinstance(root, str) and (Path(root) / ARM_PATH).is_file() else None


def run(config: PolicyClientConfig) -> None:
    """Run a policy on the arm, until Ctrl-C, a stop or an error."""
    config.check()
    if isinstance(config.robot, ArmbridgeConfig) and config.robot.dataset is None and config.policy:
        config.robot.dataset = trained_on(config.policy)
    robot = make_robot_from_config(config.robot)
    if not isinstance(robot, Armbridge):
        raise TypeError(f"robot.type: must be armbridge, not {config.robot.type}")
    try:
        robot.connect()
        policy = policy_of(config, robot)
        try:
            with robot.link.arm.chunks() as chunks:
                PolicyRunner(config, robot, policy, chunks).run()
        finally:
            policy.close()
    except KeyboardInterrupt:
        log.info("ended by Ctrl-C")
    finally:
        if robot.is_connected:
            robot.disconnect()


def main() -> None:
    """Start from the command line."""
    # lerobot has set a level of its own.
    logging.basicConfig(level=logging.INFO, force=True)
    register_third_party_plugins()
    try:
        run(draccus.parse(PolicyClientConfig))
    except (PolicyError, ArmError, TimeoutError, TypeError, ValueError) as error:
        raise SystemExit(f"the policy ends: {error}") from error
