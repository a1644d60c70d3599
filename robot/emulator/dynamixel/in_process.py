"""Emulated Dynamixel bus inside the arm process: a port that answers within the call.

No reply can be late, since the servos' time is the caller's.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence

from robot.calibration import Calibration, JointCalibration
from robot.description.gravity import LinkWeights
from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.emulator.arm import WEIGHED_AGAIN_RAD
from robot.emulator.dynamixel.servo import FULL_PERMILLE, DynamixelServo
from robot.emulator.dynamixel.servo_bus import DynamixelBus
from robot.emulator.faults import Faults
from robot.emulator.plant import Plant
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedDynamixelConfig
from robot.hardware.dynamixel.bus import Bus
from robot.hardware.dynamixel.family import Dynamixel, model_of
from robot.hardware.dynamixel.registers import FULL_PWM, OperatingMode
from robot.hardware.interface import HardwareInterface
from robot.hardware.servos.hardware import ServoHardware
from robot.hardware.servos.servo_map import full_torque
from robot.messages import GuardLimits

BAUDRATE = 1_000_000

# Friction in the gear carries most of a resting joint's weight; the share that is left for the motor is the one of an
# STS3215 (:mod:`robot.emulator.arm`).
CARRIED_BY_MOTOR = 0.18


class EmulatedDynamixels:
    """Emulated servos of an arm as a hardware source; they keep running while the hardware is closed.

    Args:
        robot: description of the arm.
        config: calibration, faults and start of the servos.
        bounds: soft limits of the joints.
        guard_limits: torque limits.
        clock: time of the control loop [s].

    Attributes:
        bus: the servo bus.
        port: its port.
    """

    def __init__(
        self,
        robot: RobotModel,
        config: EmulatedDynamixelConfig,
        bounds: JointBounds,
        guard_limits: GuardLimits,
        clock: Callable[[], float],
    ) -> None:
        self._config = config
        self._bounds = bounds
        self._guard_limits = guard_limits
        self._clock = clock
        chance = random.Random(config.seed)  # noqa: S311 - repeatable faults, no secret
        faults = Faults(drop=config.drop, corrupt=config.corrupt, random=chance)
        servos = build_servos(config)
        self.bus = DynamixelBus(servos, faults, clock(), weight_of(robot, config.calibration, servos))
        if config.driven:
            # As an arm process leaves them: holding, at their torque limits.
            for servo, share in zip(servos, full_torque(config.calibration, guard_limits), strict=True):
                servo.hold(round(share * FULL_PWM))
        self.port = DynamixelPort(self.bus, clock)

    def open(self) -> HardwareInterface:
        """Open the servos' port.

        Raises:
            PortError: it is unplugged.
        """
        self.port.check()
        bus = Bus(self.port, self._clock)
        calibration = self._config.calibration
        return ServoHardware(
            Dynamixel(), bus, calibration, self._bounds, self._guard_limits, self._clock, simulated=True
        )


def build_servos(config: EmulatedDynamixelConfig) -> list[DynamixelServo]:
    """Build the arm's servos at its start, each in its range."""
    return [_servo(joint, config.start_rad.get(joint.joint, 0.0)) for joint in config.calibration.joints]


def weight_of(robot: RobotModel, calibration: Calibration, servos: Sequence[DynamixelServo]) -> Callable[[], None]:
    """Return a function that loads the servos with the links' weight at the present pose.

    Args:
        robot: description of the arm.
        calibration: joints of the servos.
        servos: in the order of the calibration.
    """
    weights = LinkWeights(robot)
    joints = list(zip(calibration.joints, servos, strict=True))
    weighed: dict[str, float] = {}

    def weigh() -> None:
        """Load the servos with the weight at the present pose."""
        position_rad = {
            joint.joint: joint.rad_from_ticks(servo.plant.position_ticks + joint.homing_offset)
            for joint, servo in joints
        }
        if all(abs(at - weighed.get(name, math.inf)) < WEIGHED_AGAIN_RAD for name, at in position_rad.items()):
            return
        weighed.update(position_rad)
        torques_nm = weights.holding_torques(position_rad)
        for joint, servo in joints:
            # The plant counts in ticks, which may fall while the joint's position rises.
            sign = math.copysign(1.0, joint.rad_s_from_ticks_s(1.0))
            duty = FULL_PERMILLE * torques_nm[joint.joint] / servo.model.stall_torque_nm
            servo.plant.gravity_permille = sign * CARRIED_BY_MOTOR * duty

    return weigh


def _servo(joint: JointCalibration, start_rad: float) -> DynamixelServo:
    start_ticks = joint.ticks_from_rad(min(max(start_rad, joint.lower_rad), joint.upper_rad))
    # A Dynamixel adds its homing offset to the encoder's position.
    plant = Plant(
        position_ticks=start_ticks - joint.homing_offset,
        lower_stop_ticks=joint.range_min - joint.homing_offset,
        upper_stop_ticks=joint.range_max - joint.homing_offset,
    )
    limits = joint.range_min, joint.range_max
    return DynamixelServo(
        joint.servo_id, model_of(joint), plant, limits, joint.homing_offset, OperatingMode.EXTENDED_POSITION
    )


class DynamixelPort:
    """Port of an emulated bus.

    Implements :class:`robot.hardware.port.BusPort` for the host, and the methods of ``dynamixel_sdk``'s
    ``PortHandler``, so that the SDK's packet handlers run on it unchanged.

    Args:
        bus: the servo bus.
        clock: time of bus and caller [s].
    """

    def __init__(self, bus: DynamixelBus, clock: Callable[[], float]) -> None:
        self.port_name = EmulatedDynamixelConfig.port
        self.baudrate = BAUDRATE
        self.is_open = True
        self.is_using = False
        # Replies are never late, and not waited for.
        self.latency_s, self.quiet_s = 0.0, 0.0
        self.discarded_bytes = 0
        self._bus = bus
        self._clock = clock
        self._plugged = True
        self._input = b""

    def plug_in(self) -> None:
        """Make the port usable again."""
        self._plugged = True

    def unplug(self) -> None:
        """Make the port unusable, and drop the bytes not read yet."""
        self._plugged = False
        self._input = b""

    def check(self) -> None:
        """Raise PortError while the port is unplugged."""
        if not self._plugged:
            raise PortError(self.port_name, "is unplugged")

    def receive(self, timeout_s: float, /) -> bytes:  # noqa: ARG002 - all replies are there at once
        """Return the bytes that have arrived.

        Raises:
            PortLost: the port is unplugged.
        """
        self._require_plugged()
        data, self._input = self._input, b""
        return data

    def openPort(self) -> bool:  # noqa: N802 - the SDK's name, as below
        """Open the port; True when it is plugged in."""
        self.is_open = self._plugged
        return self.is_open

    def closePort(self) -> None:  # noqa: N802
        """Close the port; the servos keep running."""
        self.is_open = False
        self._input = b""

    def clearPort(self) -> None:  # noqa: N802
        """Discard the input that has arrived."""
        self.discarded_bytes += len(self._input)
        self._input = b""

    def getPortName(self) -> str:  # noqa: N802
        """Return the port's name."""
        return self.port_name

    def getBaudRate(self) -> int:  # noqa: N802
        """Return the bits per second."""
        return self.baudrate

    def setBaudRate(self, baudrate: int) -> bool:  # noqa: N802
        """Set the bits per second; the servos know one rate alone."""
        self.baudrate = baudrate
        return True

    def getBytesAvailable(self) -> int:  # noqa: N802
        """Return the number of bytes that have arrived."""
        return len(self._input)

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Return some of the bytes that have arrived, as many as there are."""
        self._require_plugged()
        data, self._input = self._input[:length], self._input[length:]
        return data

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802
        """Pass a packet to the servos.

        Raises:
            PortLost: the port is unplugged.
        """
        self._require_plugged()
        if self.baudrate == BAUDRATE:
            self._input += self._bus.receive(bytes(packet), self._clock())
        return len(packet)

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Do nothing: a reply that is not there will not come."""

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802
        """Do nothing; see :meth:`setPacketTimeout`."""

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """Return True when no byte is left to read."""
        return not self._input

    def _require_plugged(self) -> None:
        if not self._plugged:
            raise PortLost(self.port_name, "it was unplugged")
