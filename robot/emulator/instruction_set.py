"""What each instruction of the protocol does to the servos that hear it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from scservo_sdk import (
    BROADCAST_ID,
    INST_ACTION,
    INST_PING,
    INST_READ,
    INST_REG_WRITE,
    INST_SYNC_READ,
    INST_SYNC_WRITE,
    INST_WRITE,
)

from robot.emulator.servo import Servo
from robot.emulator.wire import Instruction
from robot.hardware.feetech.registers import Register

# Codes of Feetech's protocol manual that its SDK has no names for.
INST_RESTORE = 0x06
INST_REBOOT = 0x08
INST_BACKUP = 0x09
INST_RESET = 0x0A
INST_CALIBRATE = 0x0B


@dataclass(frozen=True)
class Answer:
    """What a servo has to say: the data of its status packet."""

    servo: Servo
    data: bytes = b""


@dataclass
class Effect:
    """What an instruction did.

    Attributes:
        answers: in the order in which they are given.
        address: where was written.
        written: servo id to the bytes that it took there; several addresses need several effects.
    """

    answers: list[Answer] = field(default_factory=list)
    address: int = 0
    written: dict[int, bytes] = field(default_factory=dict)


def execute(instruction: Instruction, servos: Sequence[Servo], *, stall_behind_missing: bool = False) -> list[Effect]:
    """Do what the host says.

    Args:
        instruction: anything; what makes no sense does nothing.
        servos: those that hear it.
        stall_behind_missing: whether a sync read ends at the first servo that does not answer.
    """
    parameters = instruction.parameters
    hearers = [servo for servo in servos if instruction.servo_id in (servo.servo_id, BROADCAST_ID)]
    broadcast = instruction.servo_id == BROADCAST_ID
    match instruction.code, len(parameters):
        case (code, 0) if code == INST_PING:
            return [Effect([Answer(servo) for servo in hearers])]
        case (code, 2) if code == INST_READ and not broadcast:
            return [Effect([Answer(servo, servo.read(*parameters)) for servo in hearers])]
        case (code, count) if code == INST_SYNC_READ and count > 2:
            return [Effect(_sync_read(servos, parameters, stall_behind_missing=stall_behind_missing))]
        case (code, count) if code == INST_SYNC_WRITE and count > 2:
            return [_sync_write(servos, parameters)]
        case (code, count) if code in (INST_WRITE, INST_REG_WRITE) and count > 1:
            return [_write(hearers, parameters, broadcast=broadcast, kept=code == INST_REG_WRITE)]
        case (code, 0) if code == INST_ACTION:
            return _action(hearers, broadcast=broadcast)
        case (code, _) if code in _MAINTENANCE:
            for servo in hearers:
                _MAINTENANCE[code](servo)
            return [Effect(_acknowledgements(hearers, broadcast=broadcast))]
    return []


# The arm's joints turn less than once: there is no count of turns for INST_RESET to forget.
_MAINTENANCE: Mapping[int, Callable[[Servo], None]] = MappingProxyType(
    {
        INST_RESTORE: Servo.restore,
        INST_REBOOT: Servo.power_up,
        INST_BACKUP: Servo.back_up,
        INST_RESET: lambda _servo: None,
        INST_CALIBRATE: Servo.make_middle,
    }
)


def _acknowledgements(hearers: Sequence[Servo], *, broadcast: bool) -> list[Answer]:
    if broadcast:
        return []
    return [Answer(servo) for servo in hearers if servo.value(Register.RESPONSE_LEVEL) != 0]


def _sync_read(servos: Sequence[Servo], parameters: bytes, *, stall_behind_missing: bool) -> list[Answer]:
    present = {servo.servo_id: servo for servo in servos}
    answers = []
    for servo_id in parameters[2:]:
        if servo_id in present:
            answers.append(Answer(present[servo_id], present[servo_id].read(parameters[0], parameters[1])))
        elif stall_behind_missing:
            break
    return answers


def _write(hearers: Sequence[Servo], parameters: bytes, *, broadcast: bool, kept: bool) -> Effect:
    address, data = parameters[0], parameters[1:]
    for servo in hearers:
        if kept:
            servo.keep_write(address, data)
        else:
            servo.write(address, data)
    written = {} if kept else {servo.servo_id: data for servo in hearers}
    return Effect(_acknowledgements(hearers, broadcast=broadcast), address, written)


def _action(hearers: Sequence[Servo], *, broadcast: bool) -> list[Effect]:
    effects = [Effect(_acknowledgements(hearers, broadcast=broadcast))]
    for servo in hearers:
        taken = servo.take_kept_write()
        if taken is not None:
            effects.append(Effect([], taken[0], {servo.servo_id: taken[1]}))
    return effects


def _sync_write(servos: Sequence[Servo], parameters: bytes) -> Effect:
    address, length, blocks = parameters[0], parameters[1], parameters[2:]
    present = {servo.servo_id: servo for servo in servos}
    effect = Effect([], address)
    for at in range(0, len(blocks) - length, length + 1):
        servo_id, data = blocks[at], blocks[at + 1 : at + 1 + length]
        if servo_id in present:
            present[servo_id].write(address, data)
            effect.written[servo_id] = data
    return effect
