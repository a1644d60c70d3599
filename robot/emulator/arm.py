"""Emulated arm inside the arm process: its USB adapter, its servos as a hardware source, and its links' weight."""

from __future__ import annotations

import math
import random
import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Generic

import numpy as np

from robot.calibration import Calibration
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.description.urdf import parsed
from robot.emulator.servo import EmulatedServo
from robot.emulator.servo_bus import BAUDRATE, Codec, EmulatedBus, Faults, Reply, S, WriteLog
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.interface import HardwareInterface
from robot.hardware.servos.family import ServoFamily, full_torque
from robot.hardware.servos.hardware import ServoHardware
from robot.messages import GuardLimits
from robot.trajectory import Vector

if TYPE_CHECKING:
    from robot.physics.world import World

MAX_WAITING_BYTES = 4096  # what a frozen adapter keeps, as a pseudo terminal does (N_TTY_BUF_SIZE in Linux)


class Adapter(ABC):
    """Adapter that can freeze, deliver in frames, and be unplugged."""

    def __init__(self, port: str) -> None:
        self.port = port  # its name, the last one while it is unplugged
        self.frozen = False  # True while it neither takes nor delivers bytes, which wait meanwhile
        self.frame_s = 0.0  # it delivers the servos' bytes at multiples of this interval [s]; 0 for immediately
        self._outbox: deque[tuple[float, Reply]] = deque()

    @abstractmethod
    def plug_in(self, *, renamed: bool = False) -> None:
        """Create the port, under another name if ``renamed``, unless it is there."""

    @abstractmethod
    def unplug(self) -> None:
        """Remove the port, and drop the bytes not delivered yet."""

    def take(self, replies: Sequence[Reply]) -> None:
        """Queue replies until they are due for the host; without frames a burst wakes it once, as a whole."""
        for reply in replies:
            due_s = math.ceil(reply.due_s / self.frame_s) * self.frame_s if self.frame_s else replies[-1].due_s
            self._outbox.append((due_s, reply))

    def wait_s(self, now_s: float, most_s: float) -> float:
        """Return the time until bytes are due for the host [s], ``most_s`` at most."""
        if not self._outbox or self.frozen:
            return most_s
        return max(0.0, min(most_s, self._outbox[0][0] - now_s))

    def due_bytes(self, now_s: float) -> bytes:
        """Take the bytes that are due for the host out of the queue."""
        due = b""
        while not self.frozen and self._outbox and self._outbox[0][0] <= now_s:
            due += self._outbox.popleft()[1].data
        return due


class InProcessPort(Adapter):
    """Port of an emulated bus without wire time for the host; it never waits, since its time is the caller's."""

    def __init__(self, bus: EmulatedBus[Any], clock: Callable[[], float]) -> None:
        super().__init__(EmulatedConfig.port)
        self.port_name = self.port
        self.baudrate = BAUDRATE
        self.is_using = False
        self.latency_s = self.quiet_s = 0.0
        self.discarded_bytes = 0
        self._waiting = b""
        self._bus = bus
        self._clock = clock
        self._plugged = True

    def plug_in(self, *, renamed: bool = False) -> None:  # noqa: ARG002 - only the name of a real port would change
        self._plugged = True

    def unplug(self) -> None:
        """Make the port unusable, and drop the bytes not delivered yet."""
        self._plugged = False
        self._waiting = b""
        self._outbox.clear()

    def check(self) -> None:
        if not self._plugged:
            raise PortError(self.port_name, "is unplugged by a command to the emulator")

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        self.discarded_bytes += len(self._arrived())

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Pass a packet to the servos; a frozen adapter keeps it until it goes on, if there is room."""
        self._require_plugged()
        if len(self._waiting) + len(packet) <= MAX_WAITING_BYTES:
            self._waiting += bytes(packet)
        self._pass_on()
        return len(packet)

    def receive(self, timeout_s: float, /) -> bytes:  # noqa: ARG002 - the time that bytes take passes between ticks
        self._require_plugged()
        return self._arrived()

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        """Close the port; the servos keep running."""
        self._outbox.clear()

    def _pass_on(self) -> None:
        if not self.frozen and self._waiting:
            data, self._waiting = self._waiting, b""
            self._queue(self._bus.receive(data, self._clock(), self.baudrate))

    def _queue(self, replies: Sequence[Reply]) -> None:
        self._outbox.extend((reply.due_s, reply) for reply in replies)

    def _arrived(self) -> bytes:
        self._pass_on()
        return self.due_bytes(self._clock())

    def _require_plugged(self) -> None:
        if not self._plugged:
            raise PortLost(self.port_name, "a command to the emulator unplugged it")


WEIGHED_AGAIN_RAD = 0.005  # a joint that turns by less changes its weight by less than the servo's load resolves [rad]

GRAVITY_M_S2 = 9.81


class EmulatedArm(Generic[S]):
    """Emulated servos of an arm as a hardware source; they keep running while the hardware is closed."""

    def __init__(
        self,
        robot: RobotModel,
        config: EmulatedConfig,
        family: ServoFamily,  # as the driver sees the servos
        servos: Sequence[S],  # in the order of the calibration
        codec: Codec,
        bounds: JointBounds,
        limits: GuardLimits,
        clock: Callable[[], float],  # time of the control loop [s]
        log: WriteLog | None = None,
        *,
        holds: bool,  # True if the servos hold at their torque limits, as an arm process leaves them
    ) -> None:
        chance = random.Random(config.seed)  # noqa: S311 - repeatable faults, no secret
        faults = Faults(drop=config.drop, corrupt=config.corrupt, random=chance)
        if holds:
            for servo, share in zip(servos, full_torque(config.calibration, limits).tolist(), strict=True):
                servo.hold(share)
        self.world: World | None = None  # physical world of the arm's links; None without physics
        if config.physics:
            from robot.physics.servo_joints import ServoJoints  # MuJoCo takes 200 ms, and not everyone has it

            joints = ServoJoints(robot, config.calibration, servos)
            self.world, move = joints.world, joints.move
        else:
            move = weight_of(robot, config.calibration, servos)
        self.bus = EmulatedBus(servos, codec, faults, clock(), log, move, wire_time=False)
        self.port = InProcessPort(self.bus, clock)
        self._family = family
        # Emulated servos are built from the calibration, which therefore has their offsets, also where it was assumed.
        self._calibration = replace(config.calibration, offsets_known=True)
        self._bounds = bounds
        self._limits = limits
        self._clock = clock

    def open(self) -> HardwareInterface:
        """Open the servos' port; raises PortError while it is unplugged."""
        self.port.check()
        bus = self._family.bus(self.port, self._clock)
        hardware = ServoHardware(
            self._family, bus, self._calibration, self._bounds, self._limits, self._clock, simulated=True
        )
        hardware.world = self.world
        return hardware


def start_pose_rad(config: EmulatedConfig) -> list[float]:
    """Return the joints' positions at the start, each in its range."""
    joints = config.calibration.joints
    return [min(max(config.start_rad.get(joint.joint, 0.0), joint.lower_rad), joint.upper_rad) for joint in joints]


def weight_of(robot: RobotModel, calibration: Calibration, servos: Sequence[EmulatedServo[Any]]) -> Callable[..., None]:
    """Return a function that loads the servos, in the calibration's order, with the links' weight at their pose."""
    weights = LinkWeights(robot)
    joints = list(zip(calibration.joints, servos, strict=True))
    weighed: dict[str, float] = {}

    def weigh(_duration_s: float = 0.0) -> None:
        position_rad = {joint.joint: joint.rad_from_ticks(servo.joint_ticks) for joint, servo in joints}
        if all(abs(at - weighed.get(name, math.inf)) < WEIGHED_AGAIN_RAD for name, at in position_rad.items()):
            return
        weighed.update(position_rad)
        torques_nm = weights.holding_torques(position_rad)
        for joint, servo in joints:
            # The plant counts in ticks, which may fall while the joint's position rises.
            sign = math.copysign(1.0, joint.rad_s_from_ticks_s(1.0)) * (-1.0 if servo.mirrored else 1.0)
            servo.plant.gravity_permille = sign * servo.duty_permille_per_nm * torques_nm[joint.joint]

    return weigh


class LinkWeights:
    """Weight of the links of one robot, whose root's z axis points up."""

    def __init__(self, robot: RobotModel) -> None:
        self._forward = ForwardPlacements(robot)
        self._masses = {
            name: _mass(element)
            for element in parsed(robot.urdf).iterfind("link")
            if (name := element.get("name", "")) and element.find("inertial/mass") is not None
        }
        by_child = {joint.child: joint for joint in robot.joints.values()}
        self._axes = {
            joint.name: (joint.child, joint.type != "prismatic", self._forward.axis(joint.child))
            for joint in robot.movable_joints
        }
        # Links that hang on each movable joint; links come parents before children.
        above: dict[str, frozenset[str]] = {robot.root_link: frozenset()}
        for link in robot.links[1:]:
            above[link] = above[by_child[link].parent] | {by_child[link].name}
        self._carried = {name: [link for link in self._masses if name in above[link]] for name in self._axes}

    def holding_torques(self, position_rad: Mapping[str, float]) -> dict[str, float]:
        """Compute the torque by joint that balances the links' weight [Nm, or N], at positions [rad or m]."""
        transforms = self._forward.transforms(position_rad)
        weighed = {link: (mass, transforms[link] @ centre) for link, (mass, centre) in self._masses.items()}
        torques = {}
        for name, (child, turns, axis) in self._axes.items():
            transform = transforms[child]
            x, y, z = (transform[:3, :3] @ axis).tolist()
            px, py, _ = transform[:3, 3].tolist()
            torque = 0.0
            for link in self._carried[name]:
                mass, centre = weighed[link]
                # The height that a centre of mass gains for each radian, or metre: z of axis x (centre - origin).
                gain = x * (centre[1] - py) - y * (centre[0] - px) if turns else z
                torque += mass * GRAVITY_M_S2 * float(gain)
            torques[name] = torque
        return torques


def _mass(link: ET.Element) -> tuple[float, Vector]:
    mass, origin = link.find("inertial/mass"), link.find("inertial/origin")
    xyz = "0 0 0" if origin is None else origin.get("xyz", "0 0 0")
    value = 0.0 if mass is None else float(mass.get("value", "0"))
    return value, np.array([*(float(number) for number in xyz.split()), 1.0])
