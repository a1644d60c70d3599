"""Reads of the bus that write nothing: the servos that answer, their registers, and the time of replies and cycles."""

import contextlib
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robot.description.servo_table import ServoSpec
from robot.errors import NoReply
from robot.hardware.feetech import registers
from robot.hardware.feetech.bus import Bus
from robot.hardware.feetech.registers import (
    CONTROL,
    SETTINGS_BLOCK,
    TELEMETRY,
    VOLT_PER_UNIT,
    Register,
)
from robot.hardware.interface import Steps, run_to_end
from robot.hardware.servos.bus import read_registers
from robot.trajectory import PERIOD_S

# Baud rates at which a port can be opened, by register BAUD_RATE: the SDK has no name for 76800.
BAUDRATE_BY_CODE: Mapping[int, int] = {code: rate for code, rate in enumerate(registers.BAUDRATES) if rate != 76_800}
BAUDRATES = tuple(BAUDRATE_BY_CODE.values())

FACTORY_ID = 1  # id of a new servo


# All documented registers, in blocks that the bus reads elsewhere too: a servo need not answer any longer read.
BLOCKS = (SETTINGS_BLOCK, CONTROL, TELEMETRY)


@dataclass(frozen=True)
class ServoRegisters:
    """Value of every register of one servo."""

    servo_id: int
    registers: Mapping[Register, int]
    baudrate: int = BAUDRATES[0]  # baud rate at which it answers

    def __getitem__(self, register: Register) -> int:
        return self.registers[register]

    @property
    def angle_limits_ticks(self) -> tuple[int, int]:
        """Lowest and highest goal [ticks]; (0, 0) means none."""
        return self[Register.MIN_ANGLE_LIMIT], self[Register.MAX_ANGLE_LIMIT]

    @property
    def firmware(self) -> str:
        """Version, as ``3.10``."""
        return f"{self[Register.FIRMWARE_MAJOR]}.{self[Register.FIRMWARE_MINOR]}"

    @property
    def voltage_v(self) -> float:
        return self[Register.PRESENT_VOLTAGE] * VOLT_PER_UNIT

    @property
    def voltage_limits_v(self) -> tuple[float, float]:
        """Registers MIN_VOLTAGE and MAX_VOLTAGE, which differ between the 7.4 V and the 12 V variant [V]."""
        return self[Register.MIN_VOLTAGE] * VOLT_PER_UNIT, self[Register.MAX_VOLTAGE] * VOLT_PER_UNIT


def read_all(bus: Bus, servo_id: int) -> Steps[dict[Register, int]]:
    """Read every register of a servo, as a sequence; raises NoReply."""
    values: dict[Register, int] = {}
    for block in BLOCKS:
        values |= yield from read_registers(bus, servo_id, block)
    return values


@dataclass(frozen=True)
class ScanResult:
    """Result of a scan."""

    servos: tuple[ServoRegisters, ...]  # servos that answered every read, ordered by id
    unsteady_ids: tuple[int, ...] = ()  # servos that answered some reads only
    garbled_bytes: int = 0  # bytes of invalid replies to the broadcast ping

    @property
    def registers(self) -> dict[int, Mapping[Register, int]]:
        return {servo.servo_id: servo.registers for servo in self.servos}

    @property
    def ids(self) -> frozenset[int]:
        return frozenset(servo.servo_id for servo in self.servos) | frozenset(self.unsteady_ids)


def scan(bus: Bus, expected_ids: Collection[int]) -> ScanResult:
    """Find and read the servos on the bus; expected ids are also pinged alone: a broadcast's replies may get lost."""
    garbled = bus.counters.discarded_bytes
    ids = set(bus.broadcast_ping())
    garbled = bus.counters.discarded_bytes - garbled
    for servo_id in set(expected_ids) - ids:
        with contextlib.suppress(NoReply):
            bus.ping(servo_id)
            ids.add(servo_id)
    servos, unsteady = [], []
    for servo_id in sorted(ids):
        try:
            servos.append(ServoRegisters(servo_id, run_to_end(read_all(bus, servo_id))))
        except NoReply:
            unsteady.append(servo_id)
    return ScanResult(tuple(servos), tuple(unsteady), garbled)


def explain_missing(result: ScanResult, joints: Sequence[ServoSpec]) -> list[str]:
    """Explain missing and unsteady servos, a sentence each; joints are in the order of the chain."""
    present = [joint.servo_id in result.ids for joint in joints]
    notes = [
        f"servo {servo_id} answers some questions only: its plug, or the power supply, has bad contact"
        for servo_id in result.unsteady_ids
    ]
    if result.garbled_bytes:
        notes.append("some replies were garbled: two servos may have the same id (armbridge setup gives each its own)")
    if all(present):
        return notes
    missing = ", ".join(
        f"{joint.servo_id} ({joint.joint})" for joint, there in zip(joints, present, strict=True) if not there
    )
    return [f"no answer from servo {missing}: {_cause(result, joints, present)}", *notes]


def _cause(result: ScanResult, joints: Sequence[ServoSpec], present: list[bool]) -> str:
    if not any(present) and result.garbled_bytes:
        return "something answers, but cannot be understood"
    if not any(present):
        return (
            "none answers, so look at what they share: is the power supply on, the adapter's jumper on B, and the baud "
            "rate 1000000 (armbridge scan --all-bauds tries the others)?"
        )
    if result.ids == {FACTORY_ID}:
        return "only the id that new servos have answers: set the servos' ids (armbridge setup does)"
    first = present.index(False)
    if not any(present[first:]):
        return f"all from {joints[first].joint} on are silent: check the cable that leads to it"
    return "servos behind it answer, so the cable is sound: its id or baud rate is another, or it is defective"


@dataclass(frozen=True)
class CycleTimes:
    """Times of many read cycles."""

    cycles: int
    # Time from the instruction to the last reply, median of the complete cycles [s]; NaN without one.
    round_trip_p50_s: float
    round_trip_p99_s: float  # its 99th percentile [s]
    lateness_p99_s: float  # start of the cycles after their deadlines, 99th percentile [s]
    lost_replies: int
    expected_replies: int


def measure_cycles(
    bus: Bus,
    servo_ids: Sequence[int],
    cycles: int,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> CycleTimes:
    """Read all servos as the control loop does, 100 times a second."""
    round_trips, lateness = [], []
    replies = 0
    due_s = clock()
    for _ in range(cycles):
        due_s = max(due_s + PERIOD_S, clock())
        wait(max(0.0, due_s - clock()))
        start_s = clock()
        frames = bus.sync_read(servo_ids, TELEMETRY.address, TELEMETRY.length)
        lateness.append(start_s - due_s)
        replies += len(frames)
        if len(frames) == len(servo_ids):
            round_trips.append(clock() - start_s)
    p50_s, p99_s = np.percentile(round_trips or [np.nan], [50, 99]).tolist()
    expected = cycles * len(servo_ids)
    return CycleTimes(cycles, p50_s, p99_s, float(np.percentile(lateness, 99)), expected - replies, expected)
