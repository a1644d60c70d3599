"""Emulated servo bus inside the arm process: a port that answers within the call.

No reply can be late, since the servos' time is the caller's. The packets are the same, byte for byte, as those on a
pseudo terminal (:mod:`robot.emulator.process`).
"""

from __future__ import annotations

import contextlib
import math
import random
import selectors
import socket
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.emulator.arm import build_servos, weight_of
from robot.emulator.control import MAX_COMMAND_BYTES, Emulation, answer
from robot.emulator.faults import Faults
from robot.emulator.populations import POPULATIONS
from robot.emulator.servo_bus import BAUDRATE, Reply, ServoBus
from robot.emulator.write_log import WriteLog
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.family import Feetech
from robot.hardware.feetech.registers import Register, encode
from robot.hardware.interface import HardwareInterface
from robot.hardware.port import LOCAL_LATENCY_S, QUIET_S
from robot.hardware.servos.hardware import ServoHardware
from robot.hardware.servos.servo_map import full_torque
from robot.messages import GuardLimits

# One is in use at a time; the rest allows for connections that were not closed.
MAX_CONTROLLERS = 8

READ_BYTES = 4096

# What a frozen adapter keeps, as a pseudo terminal does (N_TTY_BUF_SIZE in Linux).
MAX_WAITING_BYTES = 4096


class EmulatedServos:
    """Emulated servos of an arm as a hardware source; they keep running while the hardware is closed.

    Args:
        robot: description of the arm, for the weight of its links.
        config: calibration, faults and start of the servos.
        bounds: soft limits of the joints.
        guard_limits: torque limits.
        clock: time of the control loop [s].

    Attributes:
        bus: the servo bus.

    Raises:
        OSError: the log or the control socket cannot be created.
    """

    def __init__(
        self,
        robot: RobotModel,
        config: EmulatedConfig,
        bounds: JointBounds,
        guard_limits: GuardLimits,
        clock: Callable[[], float],
    ) -> None:
        self._config = config
        self._bounds = bounds
        self._guard_limits = guard_limits
        self._clock = clock
        joints = config.calibration.joints
        start_rad = [
            min(max(config.start_rad.get(joint.joint, 0.0), joint.lower_rad), joint.upper_rad) for joint in joints
        ]
        population = POPULATIONS[config.population]
        servos = build_servos(config.calibration, start_rad, population, as_read=config.resumes)
        if config.driven and (config.resumes or not population.has_shifted):
            # As an arm process leaves them: holding, at its torque limits.
            for servo, share in zip(servos, full_torque(config.calibration, guard_limits), strict=True):
                servo.power_up(holding=True)
                servo.write(Register.TORQUE_LIMIT, encode(Register.TORQUE_LIMIT, round(share * 1000.0)))
        chance = random.Random(config.seed)  # noqa: S311 - repeatable faults, no secret
        faults = Faults(drop=config.drop, corrupt=config.corrupt, random=chance)
        log = WriteLog(config.write_log, append=config.resumes) if config.write_log else None
        weight = weight_of(robot, config.calibration, servos)
        self.bus = ServoBus(servos, faults, clock(), log, weight, wire_time=False)
        self._port = (
            CommandedPort(self.bus, clock, ControlSocket(config.control))
            if config.control
            else InProcessPort(self.bus, clock)
        )

    def open(self) -> HardwareInterface:
        """Open the servos' port.

        Raises:
            PortError: it is unplugged.
        """
        self._port.check()
        return ServoHardware(
            Feetech(self._config.profile),
            Bus(self._port, self._clock),
            # Emulated servos are built from the calibration: it tells their offsets, also where it was assumed.
            replace(self._config.calibration, offsets_known=True),
            self._bounds,
            self._guard_limits,
            self._clock,
            simulated=True,
        )


class InProcessPort:
    """Port of an emulated bus, and its adapter.

    Implements :class:`robot.hardware.port.BusPort` for the host and :class:`robot.emulator.control.Adapter` for
    live commands.

    Args:
        bus: the servo bus.
        clock: time of bus and caller [s].
        wait: lets that time pass [s], for a bus with wire time; None for one without.

    Attributes:
        port: its name.
        frozen: True while it neither takes nor delivers bytes, which wait meanwhile.
        frame_s: interval at multiples of which replies are delivered [s], as USB does; 0 delivers them at once, and so
            does a bus without wire time, whose caller does not wait for a frame's end.
    """

    def __init__(self, bus: ServoBus, clock: Callable[[], float], wait: Callable[[float], None] | None = None) -> None:
        self.port = self.port_name = EmulatedConfig.port
        self.baudrate = BAUDRATE
        self.is_using = False
        # Without wire time only replies that a command delays are late, and those are not waited for.
        self.latency_s, self.quiet_s = (0.0, 0.0) if wait is None else (LOCAL_LATENCY_S, QUIET_S)
        self.discarded_bytes = 0
        self.frame_s = 0.0
        self._frozen = False
        self._waiting = b""
        self._bus = bus
        self._clock = clock
        self._wait = wait
        self._plugged = True
        self._outbox: deque[tuple[float, Reply]] = deque()

    @property
    def frozen(self) -> bool:
        """True while it neither takes nor delivers bytes."""
        return self._frozen

    @frozen.setter
    def frozen(self, on: bool) -> None:
        self._frozen = on
        if not on:
            waiting, self._waiting = self._waiting, b""
            self._pass_on(waiting)

    def plug_in(self, *, renamed: bool = False) -> None:  # noqa: ARG002 - only the name of a real port would change
        """Make the port usable again."""
        self._plugged = True

    def unplug(self) -> None:
        """Make the port unusable, and drop the bytes not delivered yet."""
        self._plugged = False
        self._outbox.clear()
        self._waiting = b""

    def check(self) -> None:
        """Raise PortError while the port is unplugged."""
        if not self._plugged:
            raise PortError(self.port_name, "is unplugged by a command to the emulator")

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        """Discard the input that has arrived."""
        self.discarded_bytes += len(self._take())

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Pass a packet to the servos; a frozen adapter keeps it until it goes on, if there is room.

        Raises:
            PortLost: the port is unplugged.
        """
        self._require_plugged()
        if not self._frozen:
            self._pass_on(bytes(packet))
        elif len(self._waiting) + len(packet) <= MAX_WAITING_BYTES:
            self._waiting += bytes(packet)
        return len(packet)

    def receive(self, timeout_s: float, /) -> bytes:
        """Return the bytes that have arrived by now; with wire time, wait for the next ones.

        Raises:
            PortLost: the port is unplugged.
        """
        self._require_plugged()
        data = self._take()
        if data or self._wait is None or timeout_s <= 0.0:
            return data
        now_s = self._clock()
        due_s = self._outbox[0][0] if self._outbox and not self.frozen else now_s + timeout_s
        self._wait(min(timeout_s, max(due_s - now_s, 0.0)))
        return self._take()

    def closePort(self) -> None:  # noqa: N802 - the SDK's name
        """Close the port; the servos keep running."""
        self._outbox.clear()

    def _pass_on(self, data: bytes) -> None:
        frame_s = 0.0 if self._wait is None else self.frame_s
        for reply in self._bus.receive(data, self._clock(), self.baudrate):
            due_s = math.ceil(reply.due_s / frame_s) * frame_s if frame_s else reply.due_s
            self._outbox.append((due_s, reply))

    def _take(self) -> bytes:
        if self.frozen:
            return b""
        now_s, data = self._clock(), b""
        while self._outbox and self._outbox[0][0] <= now_s:
            data += self._outbox.popleft()[1].data
        return data

    def _require_plugged(self) -> None:
        if not self._plugged:
            raise PortLost(self.port_name, "a command to the emulator unplugged it")


class CommandedPort(InProcessPort):
    """Port that polls a socket for live commands, once at each time of the clock.

    Args:
        bus: the servo bus.
        clock: time of bus and caller [s].
        control: socket of the commands.
    """

    def __init__(self, bus: ServoBus, clock: Callable[[], float], control: ControlSocket) -> None:
        super().__init__(bus, clock)
        self._emulation = Emulation(bus, self)
        self._control = control
        self._polled_s = clock()

    def check(self) -> None:
        """Carry out the commands that have arrived; raise PortError while the port is unplugged."""
        self._poll()
        super().check()

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Carry out the commands that have arrived, then pass a packet to the servos."""
        if self._clock() != self._polled_s:
            self._poll()
        return super().writePort(packet)

    def _poll(self) -> None:
        """Bring the servos up to the present, then carry out the commands, which the log records with this time."""
        self._polled_s = self._clock()
        self._bus.advance(self._polled_s)
        self._control.poll(self._emulation)


class ControlSocket:
    """Unix socket for live commands, one JSON object a line (:mod:`robot.emulator.control`).

    Args:
        path: path of the socket; one left by an ended process is replaced.

    Raises:
        OSError: something else is there, or the socket cannot be created.
    """

    def __init__(self, path: Path) -> None:
        with contextlib.suppress(FileNotFoundError):
            if path.is_socket():
                path.unlink()
        self._listener = socket.socket(socket.AF_UNIX)
        try:
            self._listener.bind(str(path))
        except OSError:
            self._listener.close()
            raise
        self._listener.listen()
        self._listener.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._buffers: dict[socket.socket, bytes] = {}

    def poll(self, emulation: Emulation) -> None:
        """Carry out and answer the commands that have arrived; never waits."""
        for key, _ in self._selector.select(0.0):
            if key.fileobj is self._listener:
                self._accept()
            elif isinstance(key.fileobj, socket.socket):
                self._answer(key.fileobj, emulation)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            controller, _ = self._listener.accept()
            if len(self._buffers) >= MAX_CONTROLLERS:
                controller.close()
                return
            controller.setblocking(False)
            self._buffers[controller] = b""
            self._selector.register(controller, selectors.EVENT_READ)

    def _answer(self, controller: socket.socket, emulation: Emulation) -> None:
        try:
            data = controller.recv(READ_BYTES)
            *lines, rest = (self._buffers[controller] + data).split(b"\n")
            for line in lines:
                if line.strip():
                    controller.sendall(answer(line, emulation))
        except OSError:
            data, rest = b"", b""
        self._buffers[controller] = rest
        if not data or len(rest) > MAX_COMMAND_BYTES:
            self._selector.unregister(controller)
            del self._buffers[controller]
            controller.close()
