"""The emulated servo bus inside the process that drives it: a port whose requests are answered at once.

Nothing between the two can be late: bytes written are answered within the call, and the servos' time is the caller's.
The packets are the same, byte for byte, as those on a pseudo terminal (:mod:`robot.emulator.process`).
"""

from __future__ import annotations

import contextlib
import math
import random
import selectors
import socket
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from robot.description.limits import JointBounds
from robot.emulator.arm import build_servos, weight_of
from robot.emulator.control import Emulation, answer
from robot.emulator.faults import Faults
from robot.emulator.servo_bus import BAUDRATE, Reply, ServoBus
from robot.emulator.write_log import WriteLog
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.hardware import FeetechHardware
from robot.hardware.feetech.port import LOCAL_LATENCY_S, QUIET_S
from robot.hardware.feetech.registers import Register, encode
from robot.hardware.feetech.servo_map import ServoMap
from robot.hardware.interface import HardwareInterface
from robot.messages import GuardLimits

# One for whoever rehearses, some for those that did not close theirs.
MAX_CONTROLLERS = 8

READ_BYTES = 4096

# A command is short; who sends more without a line end is no controller.
MAX_COMMAND_BYTES = 64 << 10


class EmulatedServos:
    """Emulated servos of an arm, as a source of hardware; they go on when the hardware is closed.

    Args:
        config: the servos, their faults, and where they start.
        bounds: soft limits of the joints.
        guard_limits: how hard the servos may push.
        clock: time of the control loop [s].

    Attributes:
        bus: the servos' end of the wire.

    Raises:
        OSError: the log or the control socket cannot be made.
    """

    def __init__(
        self, config: EmulatedConfig, bounds: JointBounds, guard_limits: GuardLimits, clock: Callable[[], float]
    ) -> None:
        self._config = config
        self._bounds = bounds
        self._guard_limits = guard_limits
        self._clock = clock
        joints = config.calibration.joints
        start_rad = [
            min(max(config.start_rad.get(joint.joint, 0.0), joint.lower_rad), joint.upper_rad) for joint in joints
        ]
        servos = build_servos(config.calibration, start_rad)
        if config.driven:
            # As an arm process leaves them: holding, at the torque that it allows.
            full_torque = ServoMap(config.calibration, bounds, guard_limits).full_torque.tolist()
            for servo, permille in zip(servos, full_torque, strict=True):
                servo.power_up(holding=True)
                servo.write(Register.TORQUE_LIMIT, encode(Register.TORQUE_LIMIT, permille))
        chance = random.Random(config.seed)  # noqa: S311 - repeatable faults, no secret
        faults = Faults(drop=config.drop, corrupt=config.corrupt, random=chance)
        log = WriteLog(config.write_log, append=config.resumes) if config.write_log else None
        weight = weight_of(config.calibration, servos)
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
        return FeetechHardware(
            Bus(self._port, self._clock),
            self._config.calibration,
            self._bounds,
            self._guard_limits,
            self._clock,
            simulated=True,
        )


class InProcessPort:
    """The port of a servo bus, as ``robot.hardware.feetech.port.BusPort``, and the adapter that commands pull.

    Args:
        bus: the servos at its other end.
        clock: time of bus and caller [s].
        wait: lets that time pass [s], for a bus whose bytes take their time on the wire; None where none does.

    Attributes:
        port: its name, for the emulator's commands.
        frozen: whether it neither takes nor gives bytes; what comes meanwhile is lost.
        frame_s: replies are handed on at multiples of this time [s], as USB does; 0 hands them on at once, and so does
            a bus without time on the wire, whose caller does not wait for a frame's end.
    """

    def __init__(self, bus: ServoBus, clock: Callable[[], float], wait: Callable[[float], None] | None = None) -> None:
        self.port = self.port_name = EmulatedConfig.port
        self.baudrate = BAUDRATE
        self.is_using = False
        # Where no time passes nothing is late but what a command delays, and that is not waited for.
        self.latency_s, self.quiet_s = (0.0, 0.0) if wait is None else (LOCAL_LATENCY_S, QUIET_S)
        self.discarded_bytes = 0
        self.frozen = False
        self.frame_s = 0.0
        self._bus = bus
        self._clock = clock
        self._wait = wait
        self._plugged = True
        self._outbox: deque[tuple[float, Reply]] = deque()

    def plug_in(self, *, renamed: bool = False) -> None:  # noqa: ARG002 - a name is all that a real one would change
        """Have the port again."""
        self._plugged = True

    def unplug(self) -> None:
        """Lose the port, and what it had still to give."""
        self._plugged = False
        self._outbox.clear()

    def check(self) -> None:
        """Raise PortError while the port is unplugged."""
        if not self._plugged:
            raise PortError(self.port_name, "is unplugged by a command to the emulator")

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        """Discard the input that has arrived."""
        self.discarded_bytes += len(self._take())

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Have the servos obey a packet.

        Raises:
            PortLost: the port is unplugged.
        """
        self._require_plugged()
        if not self.frozen:
            frame_s = 0.0 if self._wait is None else self.frame_s
            for reply in self._bus.receive(bytes(packet), self._clock(), self.baudrate):
                due_s = math.ceil(reply.due_s / frame_s) * frame_s if frame_s else reply.due_s
                self._outbox.append((due_s, reply))
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
        """Close the port; the servos go on."""
        self._outbox.clear()

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
    """A port whose servos take live commands, once each time that the clock moves on.

    Args:
        bus: the servos at its other end.
        clock: time of bus and caller [s].
        control: where the commands come in.
    """

    def __init__(self, bus: ServoBus, clock: Callable[[], float], control: ControlSocket) -> None:
        super().__init__(bus, clock)
        self._emulation = Emulation(bus, self)
        self._control = control
        self._polled_s = clock()

    def check(self) -> None:
        """Take the commands that have come; raise PortError while the port is unplugged."""
        self._poll()
        super().check()

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        """Take the commands that have come, then have the servos obey a packet."""
        if self._clock() != self._polled_s:
            self._poll()
        return super().writePort(packet)

    def _poll(self) -> None:
        """Carry out the commands now: what they do begins now, and is on record with this time."""
        self._polled_s = self._clock()
        self._bus.advance(self._polled_s)
        self._control.poll(self._emulation)


class ControlSocket:
    """A Unix socket that takes live commands to the servos, one JSON object a line (:mod:`robot.emulator.control`).

    Args:
        path: where it is; a socket that an ended process has left there is replaced.

    Raises:
        OSError: there is something else, or it cannot be made.
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
        """Carry out and answer the commands that have come; never waits."""
        for key, _ in self._selector.select(0.0):
            if key.fileobj is self._listener:
                self._accept()
            elif isinstance(key.fileobj, socket.socket):
                self._obey(key.fileobj, emulation)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            controller, _ = self._listener.accept()
            if len(self._buffers) >= MAX_CONTROLLERS:
                controller.close()
                return
            controller.setblocking(False)
            self._buffers[controller] = b""
            self._selector.register(controller, selectors.EVENT_READ)

    def _obey(self, controller: socket.socket, emulation: Emulation) -> None:
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
