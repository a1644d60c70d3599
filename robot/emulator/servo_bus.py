"""The wire of the emulated bus: who speaks when, what is lost on it, and the servos at its end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from scservo_sdk import INST_PING, INST_READ, INST_SYNC_READ

from robot.emulator.faults import Faults
from robot.emulator.instruction_set import Answer, execute
from robot.emulator.servo import Servo
from robot.emulator.wire import Instruction, InstructionParser, status_packet
from robot.emulator.write_log import WriteLog
from robot.hardware.feetech.packets import wire_time_s
from robot.hardware.feetech.registers import Register

BAUDRATE = 1_000_000

# Register BAUD_RATE (Feetech's memory table V3.6).
BAUDRATES: Mapping[int, int] = MappingProxyType(
    dict(enumerate((1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)))
)

# From the end of what a servo waits for to the start of its reply.
TURNAROUND_S = 20e-6
RETURN_DELAY_UNIT_S = 2e-6

# Instructions that change nothing.
READING = (INST_PING, INST_READ, INST_SYNC_READ)

# A survey asks some dozens of different questions.
MAX_ANSWERED = 64

# Weight changes with the pose, and that slowly.
WEIGHING_S = 0.01


@dataclass
class Reply:
    """Bytes for the host.

    Attributes:
        start_s: when their first bit is on the wire (monotonic [s]).
        byte_s: how long each takes [s].
        end_s: when all have passed it.
        due_s: when the host may have them; later than ``end_s`` if the adapter holds them up.
        data: the bytes.
    """

    start_s: float
    byte_s: float
    end_s: float
    due_s: float
    data: bytes

    def talk_over(self, now_s: float) -> None:
        """Lose what has not yet passed the wire: with the host speaking as well, no byte is framed right."""
        passed = int((now_s - self.start_s) / self.byte_s)
        self.data = self.data[: max(0, passed)]


class ServoBus:
    """All servos of the arm on one wire.

    Args:
        servos: in the order of their ids.
        faults: may be changed while the bus runs.
        now_s: monotonic time [s].
        log: where writes are recorded, if anywhere.
        weigh: sets the servos' loads by the pose; without it the arm weighs nothing.
        wire_time: whether bytes take their time on the wire; else replies are there as soon as they are asked for, and
            nobody can talk over them.
    """

    def __init__(
        self,
        servos: Sequence[Servo],
        faults: Faults,
        now_s: float,
        log: WriteLog | None = None,
        weigh: Callable[[], None] | None = None,
        *,
        wire_time: bool = True,
    ) -> None:
        self.servos = tuple(servos)
        self.faults = faults
        self._log = log
        self._weigh = weigh or (lambda: None)
        self._weigh()
        self._weighed_s = now_s
        self._wire_time = wire_time
        self._parser = InstructionParser()
        self._now_s = now_s
        self._wire_free_s = self._given_s = now_s
        self._on_wire: list[Reply] = []
        # Of an arm at rest every tick asks and tells the same: requests since the last change, and their replies.
        self._answered: dict[tuple[bytes, int], bytes] = {}
        self._visible: list[tuple[object, ...]] = []

    def advance(self, now_s: float) -> None:
        """Let the servos move until ``now_s``."""
        if now_s <= self._now_s:
            return
        for servo in self.servos:
            servo.step(now_s - self._now_s)
        self._now_s = now_s
        if now_s - self._weighed_s >= WEIGHING_S and not all(servo.plant.at_rest for servo in self.servos):
            self._weighed_s = now_s
            self._weigh()
        visible = [servo.visible for servo in self.servos]
        if visible != self._visible:
            self._visible = visible
            self._answered.clear()

    def receive(self, data: bytes, now_s: float, baudrate: int = BAUDRATE) -> list[Reply]:
        """Take bytes from the host.

        What comes while servos still answer what came before is lost on the wire, and spoils their replies. Of
        instructions that come together each waits for the replies to the one before: how far apart the host sent
        them cannot be seen here.

        Returns:
            The replies. They may yet be spoilt until they have passed the wire.
        """
        self.advance(now_s)
        if self._on_wire and now_s < self._on_wire[-1].end_s:
            for reply in self._on_wire:
                reply.talk_over(now_s)
            return []
        self._on_wire = []
        if baudrate == 0:
            return []
        request = data, baudrate
        if not self._parser.begun and (again := self._answered.get(request)) is not None:
            due_s = max(now_s, self._given_s)
            return [Reply(now_s, wire_time_s(1, baudrate), now_s, due_s, again)] if again else []
        changes = sum(servo.changes for servo in self.servos)
        instructions = self._parser.feed(data, now_s)
        for instruction in instructions:
            self._wire_free_s = max(now_s, self._wire_free_s) + self._takes_s(instruction.byte_count, baudrate)
            if not self.faults.loses_instruction():
                self._obey(instruction, baudrate)
        # What changes a register may be answered otherwise the next time: a new id or baud rate is not heard again.
        unchanged = changes == sum(servo.changes for servo in self.servos)
        whole = [instruction.byte_count for instruction in instructions] == [len(data)]
        if whole and unchanged and not (self._wire_time or self._log is not None or self.faults.by_chance):
            if len(self._answered) >= MAX_ANSWERED:
                self._answered.clear()
            self._answered[request] = b"".join(reply.data for reply in self._on_wire)
        return self._on_wire

    def record_command(self, command: Mapping[str, object]) -> None:
        """Note a live command, which may have changed anything, and put it on record among the writes."""
        self._answered.clear()
        for servo in self.servos:
            servo.keep_up()
        if self._log is not None:
            self._log.record_command(self._now_s, command, self.servos)

    def _obey(self, instruction: Instruction, baudrate: int) -> None:
        hearers = [servo for servo in self.servos if self._hears(servo, baudrate)]
        effects = execute(instruction, hearers, stall_behind_missing=self.faults.stall_behind_missing)
        if instruction.code not in READING:
            self._answered.clear()
        for effect in effects:
            for answer in effect.answers:
                self._reply(answer, baudrate)
            if self._log is not None and effect.written:
                self._log.record_write(self._now_s, instruction.code, effect.address, effect.written, self.servos)

    def _hears(self, servo: Servo, baudrate: int) -> bool:
        return BAUDRATES.get(servo.baudrate_code) == baudrate and servo.servo_id not in self.faults.offline

    def _reply(self, answer: Answer, baudrate: int) -> None:
        servo = answer.servo
        delay_s = TURNAROUND_S + servo.value(Register.RETURN_DELAY) * RETURN_DELAY_UNIT_S if self._wire_time else 0.0
        start_s = self._wire_free_s + delay_s
        packet = status_packet(servo.servo_id, servo.error, answer.data)
        arriving = self.faults.strike(packet)
        self._wire_free_s = start_s + self._takes_s(max(len(packet), len(arriving)), baudrate)
        self._given_s = max(self._given_s, self._wire_free_s + self.faults.hold_up_s())
        self._on_wire.append(Reply(start_s, wire_time_s(1, baudrate), self._wire_free_s, self._given_s, arriving))

    def _takes_s(self, byte_count: int, baudrate: int) -> float:
        return wire_time_s(byte_count, baudrate) if self._wire_time else 0.0
