"""The arm as a robot of lerobot: its targets are followed by the server, within limits and around obstacles."""

from __future__ import annotations

import asyncio
import itertools
import logging
import os
import time
from functools import cached_property

from lerobot.cameras import make_cameras_from_configs
from lerobot.robots import Robot
from lerobot.types import RobotAction, RobotObservation
from lerobot.utils.decorators import check_if_already_connected
from lerobot.utils.errors import DeviceNotConnectedError

from armbridge_client import ArmError, after_stop
from armbridge_client.messages import (
    Header,
    JointState,
    JointTrajectoryControllerState,
    StartTeleopRequest,
    TeleopState,
    Time,
    TriggerRequest,
)
from lerobot_robot_armbridge.config_armbridge import ArmbridgeConfig
from lerobot_robot_armbridge.link import ArmLink, Watch

log = logging.getLogger(__name__)

# Targets are sent between actions too: a servo holds its last goal, and the server brakes after 0.2 s of silence.
TARGET_PERIOD_S = 0.02
# A policy that sends nothing for this long is taken for ended.
SILENCE_S = 30.0
START_TIMEOUT_S = 10.0
_NUMBERS = itertools.count(1)


class ArmStopped(RuntimeError):
    """The arm no longer follows: somebody stopped it, or it has a fault, or another program moves it.

    Connect again to go on.
    """


class Armbridge(Robot):
    """An arm on an armbridge server.

    The arm goes to the first action by a planned motion, and follows the actions after it. It keeps its last target
    between actions. A stop by anybody ends the following: the next action raises ArmStopped, and nothing moves.
    """

    config_class = ArmbridgeConfig
    name = "armbridge"

    def __init__(self, config: ArmbridgeConfig) -> None:
        super().__init__(config)
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        self._link: ArmLink | None = None
        self._following: Following | None = None
        self._stops = 0  # number of the server's last stop before the latest observation

    @property
    def _joint_features(self) -> dict[str, type]:
        return {f"{joint}.pos": float for joint in self.config.joints}

    @cached_property
    def observation_features(self) -> dict[str, type | tuple[int | None, int | None, int]]:
        """Positions by joint, and the shape of each camera's images."""
        shapes = {name: (camera.height, camera.width, 3) for name, camera in self.cameras.items()}
        return {**self._joint_features, **shapes}

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Positions by joint."""
        return self._joint_features

    @property
    def is_connected(self) -> bool:
        """True from connect to disconnect."""
        return self._link is not None and all(camera.is_connected for camera in self.cameras.values())

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:  # noqa: ARG002 - lerobot's signature
        """Connect to the server and to the cameras; nothing moves. The arm is calibrated at the server."""
        self._link = ArmLink(self.config)
        self._stops = self._link.stops
        for camera in self.cameras.values():
            camera.connect()
        log.info("%s connected to %s.", self, self.config.url)

    @property
    def is_calibrated(self) -> bool:
        """True: the server drives no arm that is not calibrated."""
        return True

    def calibrate(self) -> None:
        """Do nothing: ``armbridge calibrate`` does it at the server."""

    def configure(self) -> None:
        """Do nothing: the server configures the servos."""

    def get_observation(self) -> RobotObservation:
        """Return the newest measured positions, and the newest image of each camera."""
        self._stops = self.link.stops
        observation: RobotObservation = dict(self.link.positions())
        for name, camera in self.cameras.items():
            observation[name] = camera.read_latest()
        return observation

    def send_action(self, action: RobotAction) -> RobotAction:
        """Have the arm follow a target.

        Returns:
            What the server commands at this moment, on the way to the target.

        Raises:
            ArmStopped: the arm no longer follows.
            ValueError: a joint is missing, or its value is no finite number.
        """
        link = self.link
        target_rad = link.in_rad(action)
        if self._following is None:
            self._following = Following(link, target_rad, self._stops)
        else:
            self._following.go_to(target_rad)
        return link.in_units(self._following.commanded_rad())

    def disconnect(self) -> None:
        """End the following softly, and disconnect; the arm holds."""
        link = self.link
        try:
            if self._following is not None:
                self._following.end()
        except ArmError as error:
            log.warning("the following did not end by itself: %s", error)
        finally:
            self._following = self._link = None
            link.arm.close()
            for camera in self.cameras.values():
                camera.disconnect()

    @property
    def link(self) -> ArmLink:
        """Connection to the arm."""
        if self._link is None:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first")
        return self._link


class Following:
    """Targets of lerobot as a leader that the server's arm follows (docs/teleoperation.md).

    Args:
        target_rad: first target, by the server's joints; the arm goes there by a planned motion.
        stops: number of the server's last stop before the target was decided on.

    Raises:
        RequestRefused: the arm cannot follow, with the server's sentence.
    """

    def __init__(self, link: ArmLink, target_rad: dict[str, float], stops: int) -> None:
        self._link, self._stops = link, stops
        self._target_rad = target_rad
        self._sent_rad = dict(target_rad)
        self._topic = f"/lerobot/{os.getpid()}_{next(_NUMBERS)}/joint_states"
        self._asked_at_s = time.monotonic()
        self._connection = link.arm.asynchronous.connection
        self._name = link.options.arm
        self._state = Watch(link.arm, f"{link.prefix}/teleop/state", TeleopState)
        self._controllers = [
            Watch(link.arm, f"{link.prefix}/{controller}/controller_state", JointTrajectoryControllerState)
            for controller in ("arm_controller", "gripper_controller")
        ]
        self._stopped = ""
        link.arm.loop.run(self._start())

    def go_to(self, target_rad: dict[str, float]) -> None:
        """Set the target.

        Raises:
            ArmStopped: the arm no longer follows.
        """
        if self._stopped:
            raise ArmStopped(f"the arm no longer follows: {self._stopped}; nothing moves until you connect again")
        self._target_rad = target_rad
        self._asked_at_s = time.monotonic()

    def commanded_rad(self) -> dict[str, float]:
        """Return the positions that the server commands, by its joints."""
        commanded = dict(self._sent_rad)
        for watch in self._controllers:
            message = watch.latched()
            commanded |= dict(zip(message.joint_names, message.reference.positions, strict=True))
        return commanded

    def end(self) -> None:
        """End the following; the arm brakes softly and holds."""
        self._link.arm.loop.run(self._end())

    async def _start(self) -> None:
        await self._send()
        self._sending = asyncio.create_task(self._keep_sending())
        request = StartTeleopRequest(follower=self._name, leader=self._topic)
        try:
            with after_stop(self._stops):
                response = await self._connection.call(f"{self._link.prefix}/teleop/start", request, START_TIMEOUT_S)
        except BaseException:
            self._sending.cancel()
            raise
        if not response.success:
            self._sending.cancel()
            raise ArmStopped(response.message)

    async def _end(self) -> None:
        self._sending.cancel()
        if not self._stopped:
            await self._connection.call(f"{self._link.prefix}/teleop/stop", TriggerRequest())

    async def _keep_sending(self) -> None:
        started = False
        while not self._stopped:
            await asyncio.sleep(TARGET_PERIOD_S)
            state = self._state.latched()
            # A following may begin and end between two looks, and another client's may begin after it.
            mine = state.leader == self._topic
            started = started or mine
            if started and not (mine and state.phase != "idle"):
                self._stopped = (mine and state.message) or "it was ended"
            elif time.monotonic() - self._asked_at_s > SILENCE_S:
                self._stopped = f"no action came for {SILENCE_S:g} s"
            else:
                try:
                    await self._send()
                except ArmError as error:
                    self._stopped = str(error)

    async def _send(self) -> None:
        # A target moves no faster than its joint can: the server takes a jump for a leader that is not to be followed.
        for joint, target in self._target_rad.items():
            step = self._link.speed_rad_s[joint] * TARGET_PERIOD_S
            sent = self._sent_rad[joint]
            self._sent_rad[joint] = sent + min(max(target - sent, -step), step)
        sec, nanosec = divmod(time.time_ns(), 1_000_000_000)
        # A leader's joints have no arm's name: the server pairs equal names.
        positions = [self._sent_rad[name] for name in self._link.server_names.values()]
        message = JointState(Header(Time(sec, nanosec)), list(self._link.server_names), positions)
        await self._connection.publish(self._topic, message)
