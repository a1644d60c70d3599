"""The arm process: reads and commands the servos 100 times a second.

Nothing else runs here, so neither a planner's lock nor a burst of messages can delay a tick. When the server asks
for the end, or is gone, the arm is braked along its path and the process ends with the servos holding.
"""

from __future__ import annotations

import gc
import logging
import math
import time
from collections import deque
from typing import Any

import numpy as np

from robot.bus import Bus
from robot.discovery import resolve_port
from robot.driver import Driver, JointBounds, Measured
from robot.errors import PortError, RobotError
from robot.messages import ArmConfig, ArmState, Execute, Mode, MotionEnded, Outcome, Shutdown, Stop
from robot.processes import Channel, channel_of_child
from robot.registers import (
    GOAL_ADDRESS,
    TELEMETRY_ADDRESS,
    TELEMETRY_BYTES,
    Telemetry,
    goal_block,
    parse_telemetry,
)
from robot.startup import SERVO_ACCELERATION, read_all, take_over
from robot.trajectory import Vector

log = logging.getLogger("armbridge.arm")

PERIOD_S = 0.01

# Goal_Velocity: leaves the servo room to catch up, and caps what a bad goal could do (2.8 rad/s).
VELOCITY_CAP_FACTOR = 1.3
VELOCITY_CAP_TICKS_S = 1800

# Between attempts to reach an arm that is not there.
FIRST_RETRY_S = 0.2
LONGEST_RETRY_S = 2.0

# No brake takes longer; past it the process ends anyway, so that the server can keep its own deadline.
SHUTDOWN_TIMEOUT_S = 2.0


class ArmLoop:
    """Owns the bus; talks to the server over the channel.

    Args:
        channel: the server.
        config: the arm; the joints of its calibration are the order of every array.
    """

    def __init__(self, channel: Channel, config: ArmConfig) -> None:
        self._channel = channel
        self._config = config
        self._calibration = config.calibration
        self._names = tuple(joint.joint for joint in self._calibration.joints)
        self._ids = tuple(joint.servo_id for joint in self._calibration.joints)
        self._bounds = JointBounds.of(config.robot, self._names)
        self._cap_ticks_s = {
            joint.servo_id: min(VELOCITY_CAP_TICKS_S, math.ceil(joint.ticks_s_from_rad_s(speed) * VELOCITY_CAP_FACTOR))
            for joint, speed in zip(self._calibration.joints, self._bounds.max_velocity, strict=True)
        }
        self._ticks_per_state = max(1, round(1.0 / (PERIOD_S * config.state_rate_hz)))
        self._lateness_s: deque[float] = deque(maxlen=self._ticks_per_state)
        self._shutdown_at_s: float | None = None

    def run(self) -> None:
        """Serve until shut down; an arm that is not there is tried again and again."""
        retry_s = FIRST_RETRY_S
        while not self._ending:
            try:
                bus = Bus.open(resolve_port(self._config.port))
            except RobotError as error:
                self._wait_disconnected(str(error), retry_s)
                retry_s = min(2.0 * retry_s, LONGEST_RETRY_S)
                continue
            try:
                self._drive(bus)
                retry_s = FIRST_RETRY_S
            except RobotError as error:
                log.warning("arm on %s: %s", self._config.port, error)
                self._wait_disconnected(str(error), retry_s)
                retry_s = min(2.0 * retry_s, LONGEST_RETRY_S)
            finally:
                bus.close()

    @property
    def _ending(self) -> bool:
        return self._shutdown_at_s is not None or self._channel.closed

    def _drive(self, bus: Bus) -> None:
        """Take the arm over and run its ticks until the end; raises RobotError when the bus is lost."""
        limits = {
            joint.servo_id: (joint.ticks_from_rad(lower), joint.ticks_from_rad(upper))
            for joint, lower, upper in zip(
                self._calibration.joints, self._bounds.lower_rad, self._bounds.upper_rad, strict=True
            )
        }
        taken = take_over(bus, self._calibration, limits, self._cap_ticks_s, time.sleep)
        log.info("arm %s on %s", "adopted as it was holding" if taken.adopted else "switched on", self._config.port)
        now_s = time.monotonic()
        readings = read_all(bus, self._calibration)
        hold_rad = np.array(
            [joint.rad_from_ticks(taken.goal_ticks[joint.servo_id]) for joint in self._calibration.joints]
        )
        driver = Driver(self._names, self._bounds, hold_rad, now_s)
        ticker = _Ticker(readings, dict.fromkeys(self._ids, now_s))
        try:
            self._tick_until_end(bus, driver, ticker)
        except PortError as error:
            self._report(driver.abandon(Outcome.BUS_LOST, str(error)))
            raise

    def _tick_until_end(self, bus: Bus, driver: Driver, ticker: _Ticker) -> None:
        deadline_s = time.monotonic() + PERIOD_S
        while not self._finished(driver):
            self._serve(driver, deadline_s)
            now_s = time.monotonic()
            self._lateness_s.append(now_s - deadline_s)
            self._tick(bus, driver, ticker)
            # Absolute deadlines; a tick that was missed is skipped, never made up for.
            deadline_s += PERIOD_S * max(1, math.ceil((time.monotonic() - deadline_s) / PERIOD_S))

    def _finished(self, driver: Driver) -> bool:
        if not self._ending:
            return False
        driver.stop()
        if self._shutdown_at_s is None:
            log.warning("the server is gone: stopping")
            self._shutdown_at_s = time.monotonic()
        return driver.mode is not Mode.MOVING or time.monotonic() - self._shutdown_at_s > SHUTDOWN_TIMEOUT_S

    def _serve(self, driver: Driver, deadline_s: float) -> None:
        """Take the server's commands until the tick is due."""
        while True:
            remaining_s = deadline_s - time.monotonic()
            if self._channel.closed:
                time.sleep(max(0.0, remaining_s))
                return
            for message in self._channel.receive(max(0.0, remaining_s)):
                self._obey(message, driver)
            if remaining_s <= 0.0:
                return

    def _obey(self, message: Any, driver: Driver | None) -> None:
        if isinstance(message, Execute):
            if driver is None:
                refusal: MotionEnded | None = MotionEnded(
                    message.motion_id, Outcome.BUS_LOST, "the arm is not connected"
                )
            else:
                refusal = driver.execute(message)
            self._report(refusal)
        elif isinstance(message, Stop) and driver is not None:
            driver.stop()
        elif isinstance(message, Shutdown):
            self._shutdown_at_s = time.monotonic()

    def _report(self, ended: MotionEnded | None) -> None:
        if ended is not None:
            self._channel.send(ended)

    def _tick(self, bus: Bus, driver: Driver, ticker: _Ticker) -> None:
        frames = bus.sync_read(self._ids, TELEMETRY_ADDRESS, TELEMETRY_BYTES)
        stamp_s, now_s = time.time(), time.monotonic()
        for servo, frame in frames.items():
            ticker.readings[servo] = parse_telemetry(frame.data)
            ticker.read_at_s[servo] = now_s
        position_rad = self._positions(ticker.readings)
        age_s = np.array([now_s - ticker.read_at_s[servo] for servo in self._ids])
        ended = driver.step(Measured(position_rad, age_s), now_s)
        bus.sync_write(GOAL_ADDRESS, self._goal_blocks(driver.goal_rad))
        self._report(ended)
        ticker.count += 1
        if ticker.count % self._ticks_per_state == 0:
            self._channel.send(self._state(driver, ticker.readings, position_rad, stamp_s), droppable=True)

    def _positions(self, readings: dict[int, Telemetry]) -> Vector:
        return np.array(
            [joint.rad_from_ticks(readings[joint.servo_id].position_ticks) for joint in self._calibration.joints]
        )

    def _goal_blocks(self, goal_rad: Vector) -> dict[int, bytes]:
        return {
            joint.servo_id: goal_block(
                joint.ticks_from_rad(float(goal)), self._cap_ticks_s[joint.servo_id], SERVO_ACCELERATION
            )
            for joint, goal in zip(self._calibration.joints, goal_rad, strict=True)
        }

    def _state(self, driver: Driver, readings: dict[int, Telemetry], position_rad: Vector, stamp_s: float) -> ArmState:
        joints = self._calibration.joints
        return ArmState(
            stamp_s=stamp_s,
            mode=driver.mode,
            joint_names=self._names,
            position_rad=position_rad,
            velocity_rad_s=np.array(
                [joint.rad_s_from_ticks_s(readings[joint.servo_id].velocity_ticks_s) for joint in joints]
            ),
            load=np.array([readings[joint.servo_id].load_permille / 1000.0 for joint in joints]),
            goal_rad=driver.goal_rad,
            motion_id=driver.motion_id,
            fraction=driver.fraction,
            remaining_s=driver.remaining_s,
            lateness_s=tuple(self._lateness_s),
        )

    def _wait_disconnected(self, reason: str, wait_s: float) -> None:
        """Answer the server while there is no arm."""
        self._channel.send(ArmState(time.time(), Mode.DISCONNECTED, self._names, reason=reason), droppable=True)
        until_s = time.monotonic() + wait_s
        while not self._ending and (remaining_s := until_s - time.monotonic()) > 0.0:
            for message in self._channel.receive(remaining_s):
                self._obey(message, None)


class _Ticker:
    """What one tick hands to the next: the last good reading of each servo, and when it was made."""

    def __init__(self, readings: dict[int, Telemetry], read_at_s: dict[int, float]) -> None:
        self.readings = readings
        self.read_at_s = read_at_s
        self.count = 0


def main() -> None:
    """Run the arm process: the first message is its configuration."""
    channel = channel_of_child()
    config = channel.receive_first()
    if config is None:
        return
    loop = ArmLoop(channel, config)
    # A collection in the middle of a motion would delay ticks; the loop makes no reference cycles.
    gc.collect()
    gc.freeze()
    gc.disable()
    loop.run()


if __name__ == "__main__":
    main()
