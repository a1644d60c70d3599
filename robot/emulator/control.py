"""Live commands to the emulated servos, one JSON object a line, inside the arm process from a Unix socket."""

from __future__ import annotations

import contextlib
import json
import os
import socket
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo

from robot.calibration import MAX_TICK
from robot.emulator.arm import Adapter, InProcessPort
from robot.emulator.feetech import FeetechServo
from robot.emulator.servo_bus import EmulatedBus
from robot.hardware.feetech.registers import Register

# A controller that sends more bytes than this without a line end is disconnected; a command is short.
MAX_COMMAND_BYTES = 64 << 10

MAX_CONTROLLERS = 8  # one is in use at a time; the rest allows for connections that were not closed

READ_BYTES = 4096

MAX_PUSH_PERMILLE = 1000  # full duty of the motor

# Greatest values of registers PRESENT_TEMPERATURE, PRESENT_VOLTAGE and STATUS.
MAX_TEMPERATURE_C = 255
MAX_VOLTAGE_V = 25.5
MAX_STATUS = 255

MAX_DELAY_S = 10.0  # longer than anything waits for a reply
MAX_USB_FRAME_MS = 100  # FTDI's adapters delay bytes by 16 ms
MAX_HEAT_RATE = 3600  # an hour of heating in a second


@dataclass(frozen=True)
class Emulation:
    """Servo bus and adapter, the targets of commands."""

    bus: EmulatedBus[FeetechServo]
    adapter: Adapter


def _servo_of(name: object, info: ValidationInfo[Sequence[FeetechServo]]) -> FeetechServo:
    return _named(name, {str(servo.servo_id): servo for servo in info.context}, info.context, "a servo id")


def _servo_in_chain(name: object, info: ValidationInfo[Sequence[FeetechServo]]) -> FeetechServo:
    """Return the servo of a number in the chain, as several may have the same id, or of a joint's name."""
    numbered = {str(place): servo for place, servo in enumerate(info.context, start=1)}
    return _named(name, numbered, info.context, "a number")


def _named(
    name: object, numbered: Mapping[str, FeetechServo], servos: Sequence[FeetechServo], number: str
) -> FeetechServo:
    found = {**numbered, **{servo.joint: servo for servo in servos}}.get(str(name))
    if found is None:
        raise ValueError(f"must be {number} out of {', '.join(numbered)}, or a joint's name")
    return found


Probability: TypeAlias = Annotated[float, Field(ge=0.0, le=1.0)]
Voltage: TypeAlias = Annotated[float, Field(ge=0.0, le=MAX_VOLTAGE_V)]
Ticks: TypeAlias = Annotated[float, Field(ge=0, le=MAX_TICK)]
Servo: TypeAlias = Annotated[FeetechServo, BeforeValidator(_servo_of)]
ServoInChain: TypeAlias = Annotated[FeetechServo, BeforeValidator(_servo_in_chain)]


def _command(example: object, meaning: str) -> Any:
    return Field(None, description=meaning, examples=[example])


class LiveCommand(BaseModel):
    """Live commands of one line, by name; a line has any number of them."""

    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, arbitrary_types_allowed=True, defer_build=True
    )

    drop: Probability = _command(0.01, "probability that a reply is lost")
    corrupt: Probability = _command(0.05, "probability that one byte of a reply is wrong")
    wrong_id: Probability = _command(0.01, "probability that a reply bears another id, with a sound checksum")
    truncate: Probability = _command(0.01, "probability that a reply is cut short")
    duplicate: Probability = _command(0.01, "probability that a reply comes twice")
    noise: Probability = _command(0.01, "probability that noise comes before a reply")
    delay: Probability = _command(0.01, "probability that the host gets a reply, and those behind it, later")
    delay_s: Annotated[float, Field(ge=0.0, le=MAX_DELAY_S)] = _command(0.02, "delay of these replies [s]")
    lose_instruction: Probability = _command(0.01, "probability that no servo hears an instruction")
    offline: list[Servo] = _command([3], "these servos neither hear nor speak")
    online: list[Servo] = _command([3], "these do again")
    unplug: list[ServoInChain] = _command(
        ["gripper", 5], "the cables of these, by joint or number in the chain, are pulled: they lose power"
    )
    plug: list[ServoInChain] = _command(["gripper"], "these are plugged in again, and start with torque off")
    power_cycle: list[Servo] = _command([3], "these lose power for a moment, and start with torque off and goal 0")
    torque_off: list[Servo] = _command([3], "torque goes off there, behind the driver's back")
    powers_up_holding: list[Servo] = _command([3], "power-ups leave torque on, at the present position")
    overload_latches: list[Servo] = _command([3], "only a power cycle clears an overload; until then torque stays on")
    mirror: list[Servo] = _command(["gripper"], "the horns of these are mounted mirrored, or as before")
    obstacle: dict[Servo, Ticks | None] = _command(
        {"3": 2100}, "something in the way of the joint at this tick; null takes it away"
    )
    push: dict[Servo, Annotated[float, Field(ge=-MAX_PUSH_PERMILLE, le=MAX_PUSH_PERMILLE)]] = _command(
        {"3": 150}, "a push on the joint, in the motor's duty that would do the same [0.1 %]; 0 ends it"
    )
    hand: dict[Servo, Ticks | None] = _command(
        {"3": 1900}, "a hand takes the joint to this tick, whatever the motor does; null lets go"
    )
    jump: dict[Servo, Annotated[float, Field(ge=-MAX_TICK, le=MAX_TICK)]] = _command(
        {"3": 400}, "the joint jumps by this number of ticks"
    )
    temperature: dict[Servo, Annotated[float, Field(ge=0, le=MAX_TEMPERATURE_C)]] = _command(
        {"3": 66}, "temperature of the motor, which warms or cools from there [degC]"
    )
    voltage: dict[Servo, Voltage] = _command({"3": 4.2}, "supply of the servo [V]")
    supply: Voltage = _command(4.2, "supply of all servos [V]")
    status: dict[Servo, Annotated[int, Field(ge=0, le=MAX_STATUS)]] = _command(
        {"3": 2}, "errors forced on the servo, bits of register STATUS; 0 takes them back"
    )
    heat_rate: Annotated[float, Field(ge=0.0, le=MAX_HEAT_RATE)] = _command(
        100, "how much faster than life motors warm and cool"
    )
    stall_behind_missing: bool = _command(True, "a sync read ends at the first servo that does not answer")
    usb_frame_ms: Annotated[float, Field(ge=0.0, le=MAX_USB_FRAME_MS)] = _command(
        1, "replies come at multiples of this time [ms]; 0 for at once"
    )
    frozen: bool = _command(True, "the adapter neither takes nor gives bytes; bytes that come meanwhile wait")
    plugged: Literal[True, False, "renamed"] = _command(
        False, 'port and link are gone; true brings them back, "renamed" under another name of the port'
    )


# For people who call for help at the command line.
COMMANDS_HELP = (
    "Live commands to a running emulator, one JSON object a line.\n\n"
    + "".join(
        f"{json.dumps({name: (field.examples or [None])[0]}):<31} {field.description}\n"
        for name, field in LiveCommand.model_fields.items()
    )
    + """
Ticks are as in register PRESENT_POSITION. A joint's name may stand for a servo's id, for example where several
servos have the same id. Every line is answered by {"ok": true}, with the port's name as "port" after "plugged", or by
{"error": "..."}. One object may hold several commands; either all of them are carried out or none.
"""
)


def answer(line: bytes, emulation: Emulation) -> bytes:
    try:
        values = json_object(line)
        command = check(LiveCommand, values, emulation.bus.servos)
    except ValueError as error:
        return _line({"error": str(error)})
    carry_out(command, values, emulation)
    emulation.bus.record_command(values)
    return _line({"ok": True, "port": emulation.adapter.port} if "plugged" in values else {"ok": True})


class Controller:
    """Connection to a controller of the emulator, by the descriptors to read its commands from and to answer at."""

    def __init__(self, reader: int, writer: int) -> None:
        self.reader = reader
        self._writer = writer
        self._rest = b""
        self.gone = False  # True once it has closed its end, or sends no line end

    def handle(self, emulation: Emulation) -> None:
        try:
            data = os.read(self.reader, READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if line.strip():
                self.write(answer(line, emulation))
        self.gone = not data or len(self._rest) > MAX_COMMAND_BYTES

    def write(self, line: bytes) -> None:
        """Send a line; it is lost when nobody reads."""
        with contextlib.suppress(OSError):
            os.write(self._writer, line)


def json_object(line: bytes) -> dict[str, object]:
    """Parse a line of JSON; raises ValueError for anything but a JSON object."""
    try:
        values = json.loads(line)
    except json.JSONDecodeError as error:
        raise ValueError(f"no JSON at column {error.colno}: {error.msg}") from error
    if not isinstance(values, dict):
        raise ValueError(f"a command is a JSON object, not {values!r}")  # noqa: TRY004 - refused input like the rest
    return values


C = TypeVar("C", bound=LiveCommand)


def check(model: type[C], values: Mapping[str, object], servos: Sequence[FeetechServo]) -> C:
    """Check commands for some servos; raises ValueError that names field, limit and value, before anything changes."""
    try:
        return model.model_validate(values, context=servos)
    except ValidationError as error:
        flaw = error.errors(include_url=False)[0]
    name = ".".join(str(part) for part in flaw["loc"] if part != "[key]")
    if flaw["type"] == "extra_forbidden":
        raise ValueError(f"unknown command {name!r}; there are {', '.join(LiveCommand.model_fields)}")
    if flaw["type"] == "missing":
        raise ValueError(f"{name}: is missing")
    limit = flaw["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    raise ValueError(f"{name}: {limit}, not {flaw['input']!r}")


# Commands for a list of servos, and for a value of each servo.
_OF_SERVOS: Mapping[str, Callable[[FeetechServo], object]] = {
    "unplug": FeetechServo.unplug,
    "plug": FeetechServo.plug_in,
    "power_cycle": FeetechServo.power_up,
    "torque_off": lambda servo: servo.write(Register.TORQUE_ENABLE, bytes([0])),
    "powers_up_holding": lambda servo: setattr(servo, "powers_up_holding", True),
    "overload_latches": lambda servo: setattr(servo.protection, "latches", True),
    "mirror": FeetechServo.mirror,
}
_OF_VALUES: Mapping[str, Callable[[FeetechServo, Any], None]] = {
    "obstacle": lambda servo, ticks: servo.plant.block(None if ticks is None else servo.encoder_ticks(ticks)),
    "push": lambda servo, permille: setattr(servo.plant, "push_permille", permille),
    "hand": lambda servo, ticks: setattr(
        servo.plant, "hand_ticks", None if ticks is None else servo.encoder_ticks(ticks)
    ),
    "jump": lambda servo, ticks: setattr(servo.plant, "position_ticks", servo.plant.position_ticks + ticks),
    "temperature": lambda servo, degrees: setattr(servo.motor, "temperature_c", degrees),
    "voltage": lambda servo, volts: setattr(servo, "voltage_v", volts),
    "status": lambda servo, bits: setattr(servo.protection, "forced", bits),
}


def carry_out(command: LiveCommand, names: Iterable[str], emulation: Emulation) -> None:
    faults, adapter, servos = emulation.bus.faults, emulation.adapter, emulation.bus.servos
    for name in names:
        value = getattr(command, name)
        match name:
            case _ if name in _OF_SERVOS:
                for servo in value:
                    _OF_SERVOS[name](servo)
            case _ if name in _OF_VALUES:
                for servo, setting in value.items():
                    _OF_VALUES[name](servo, setting)
            case "offline":
                faults.offline |= {servo.servo_id for servo in value}
            case "online":
                faults.offline -= {servo.servo_id for servo in value}
            case "supply":
                for servo in servos:
                    servo.voltage_v = value
            case "heat_rate":
                for servo in servos:
                    servo.motor.rate = value
            case "usb_frame_ms":
                adapter.frame_s = value / 1000.0
            case "frozen":
                adapter.frozen = value
            case "plugged" if value is False:
                adapter.unplug()
            case "plugged":
                adapter.plug_in(renamed=value == "renamed")
            case _:
                setattr(faults, name, value)


def _line(reply: Mapping[str, object]) -> bytes:
    return json.dumps(reply).encode() + b"\n"


class CommandedPort(InProcessPort):
    """Port that polls a socket for live commands, once at each time of the clock."""

    def __init__(self, bus: EmulatedBus[FeetechServo], clock: Callable[[], float], control: ControlSocket) -> None:
        super().__init__(bus, clock)
        self._emulation = Emulation(bus, self)
        self._control = control
        self._polled_s = clock()

    def check(self) -> None:
        """Carry out the commands that have arrived; raise PortError while the port is unplugged."""
        self._poll()
        super().check()

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802 - the SDK's name
        if self._clock() != self._polled_s:
            self._poll()
        return super().writePort(packet)

    def _poll(self) -> None:
        """Bring the servos up to the present, then carry out the commands, which the log records with this time."""
        self._polled_s = self._clock()
        self._bus.advance(self._polled_s)
        self._control.poll(self._emulation)


class ControlSocket:
    """Unix socket for live commands, one JSON object a line; it replaces a socket that an ended process has left."""

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
        self._controllers: dict[socket.socket, Controller] = {}

    def poll(self, emulation: Emulation) -> None:
        with contextlib.suppress(OSError):
            connection, _ = self._listener.accept()
            if len(self._controllers) < MAX_CONTROLLERS:
                connection.setblocking(False)
                self._controllers[connection] = Controller(connection.fileno(), connection.fileno())
            else:
                connection.close()
        for connection, controller in list(self._controllers.items()):
            controller.handle(emulation)
            if controller.gone:
                del self._controllers[connection]
                connection.close()
