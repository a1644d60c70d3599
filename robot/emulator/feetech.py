"""Emulated Feetech STS3215, and an arm of it (memory table V3.6 and SCS/STS protocol manual)."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence

from scservo_sdk import BROADCAST_ID, INST_PING, INST_READ

from robot.calibration import TICKS_PER_TURN, Calibration, JointCalibration
from robot.description.limits import JointBounds
from robot.description.model import RobotModel
from robot.emulator.arm import EmulatedArm, start_pose_rad
from robot.emulator.plant import NO_LOAD_TICKS_S, Drive, Plant
from robot.emulator.populations import FACTORY, POPULATIONS, SUPPLY_V, Population
from robot.emulator.servo import FULL_DUTY_PERMILLE, EmulatedServo, Thresholds
from robot.emulator.servo_bus import Codec, Instruction, WriteLog
from robot.hardware.config import EmulatedConfig
from robot.hardware.feetech.bus import HEADER, LENGTH_OVERHEAD, checksum
from robot.hardware.feetech.family import PHASE_MULTI_TURN, Feetech
from robot.hardware.feetech.registers import (
    AMPERE_PER_UNIT,
    BAUDRATES,
    MODELS,
    PROTECTION_TIME_UNIT_S,
    TABLE,
    TICKS_S2_PER_ACCELERATION_UNIT,
    VOLT_PER_UNIT,
    Register,
)
from robot.hardware.interface import StatusFlag
from robot.hardware.servos.registers import Area
from robot.messages import GuardLimits

MEMORY_BYTES = 87  # the last documented address is 86; addresses beyond it read as zero

# Values of a new servo; angle limits and id are the arm's.
FACTORY_EPROM: Mapping[Register, int] = {
    Register.FIRMWARE_MAJOR: 3,
    Register.FIRMWARE_MINOR: 10,
    Register.MODEL_NUMBER: MODELS["sts3215"],
    Register.RESPONSE_LEVEL: 1,
    Register.MAX_ANGLE_LIMIT: 4095,
    Register.MAX_TEMPERATURE: 70,
    Register.MAX_VOLTAGE: 80,
    Register.MIN_VOLTAGE: 40,
    Register.MAX_TORQUE: 1000,
    Register.PHASE: 12,
    Register.UNLOADING_CONDITION: 44,
    Register.LED_ALARM_CONDITION: 47,
    Register.P_GAIN: 32,
    Register.D_GAIN: 32,
    Register.MIN_STARTUP_FORCE: 16,
    Register.CW_DEAD_ZONE: 1,
    Register.CCW_DEAD_ZONE: 1,
    Register.PROTECTION_CURRENT: 500,
    Register.ANGULAR_RESOLUTION: 1,
    Register.PROTECTIVE_TORQUE: 20,
    Register.PROTECTION_TIME: 200,
    Register.OVERLOAD_TORQUE: 80,
}

# Register ACCELERATION 0 means the greatest one; lerobot writes this value to the limit register.
MAX_ACCELERATION = 254

STANDSTILL_TICKS_S = 3.0  # Register MOVING is 0 for a slower joint

# This value in register TORQUE_ENABLE makes the present position the middle; torque stays as it was.
TORQUE_ENABLE_MAKES_MIDDLE = 128
MIDDLE_TICKS = 2048

PERMILLE_PER_PERCENT = 10

OVERCURRENT_TIME_S = 2.0  # factory value of register 38, which is not emulated

# Far less than the stall torque of 1.62 Nm suggests: friction in the gear carries most of a resting joint's weight.
# With lerobot's gain the droop is then 14 ticks (1.2 deg) at a stretched shoulder, and 24 with 1.5 kg at 10 cm, where
# 20 to 30 were measured.
DUTY_PERMILLE_PER_NM = 130.0

STALL_TORQUE_NM = 1.62  # STS3215 C001 at 6 V: 16.5 kg cm

INST_RESET = 0x0A  # of the protocol manual, without a name in Feetech's SDK

# The EPROM ends where the SRAM begins, including addresses that are not documented.
_EPROM_BYTES = int(Register.TORQUE_ENABLE)
_WRITABLE = frozenset(range(Register.ID, MEMORY_BYTES)) - {
    register + offset for register in Register if register.area is Area.READ_ONLY for offset in range(register.size)
}


class FeetechServo(EmulatedServo[Register]):
    """STS3215 on the bus, from power-up on; its EPROM is given where it differs from a new servo's."""

    table = TABLE
    memory_bytes = MEMORY_BYTES
    return_delay = Register.RETURN_DELAY
    torque_limit = Register.TORQUE_LIMIT
    full_torque = 1000
    baudrates = BAUDRATES
    duty_permille_per_nm = DUTY_PERMILLE_PER_NM
    stall_torque_nm = STALL_TORQUE_NM
    backlash_ticks = 10.0  # 0.9 deg; 0.87 to 1.0 deg were measured (SO-ARM100, issue 134)

    def __init__(self, plant: Plant, eprom: Mapping[Register, int], *, joint: str = "", zero_ticks: int = 0) -> None:
        super().__init__(plant, joint, zero_ticks)
        self.voltage_v = SUPPLY_V
        self.powers_up_holding = False  # True if power-ups leave torque on, at the present position
        self.powers_up_unlocked = False  # True if power-ups leave the EPROM unlocked
        for register, value in {**FACTORY_EPROM, **eprom}.items():
            self.memory.set(register, value)
        self._stored_eprom = self._present_eprom
        self.power_up()

    def power_up(self) -> None:
        """Start as after a power cut: EPROM as last stored, torque off.

        The goal is 0 at any position: switching torque on without setting it makes the arm jump. Only a servo that
        powers up holding has its position as the goal.
        """
        self.memory.write(0, self._stored_eprom.ljust(MEMORY_BYTES, b"\0"))
        self.memory.set(Register.TORQUE_LIMIT, self.value(Register.MAX_TORQUE))
        self.memory.set(Register.LOCK, int(not self.powers_up_unlocked))
        self.kept_write = None
        self.protection.power_up()
        self._follow_registers()
        if self.connected and self.powers_up_holding:
            self.hold()

    def write(self, address: int, data: bytes) -> int:
        """Write memory, except read-only bytes; EPROM changes outlive a power cut only while LOCK is 0."""
        present = self.memory.read(address, len(data))
        # Goals are written a hundred times a second, also while the arm rests.
        if data == present:
            return 0
        unlocked, torque = self.value(Register.LOCK) == 0, self.value(Register.TORQUE_ENABLE)
        changes = enumerate(zip(data, present, strict=True), start=address)
        self.memory.write(address, bytes(new if at in _WRITABLE else old for at, (new, old) in changes))
        if unlocked:
            self._stored_eprom = self._present_eprom
        asked = self.value(Register.TORQUE_ENABLE)
        if asked == TORQUE_ENABLE_MAKES_MIDDLE:
            self.memory.set(Register.TORQUE_ENABLE, torque)
            self.make_middle()
        elif torque and not asked:
            if self.protection.latches and self.protection.latched:
                self.memory.set(Register.TORQUE_ENABLE, torque)
            self.protection.torque_off()
        self._follow_write(address)
        return 0

    @property
    def present_ticks(self) -> int:
        counted = round(self.plant.position_ticks) - self.value(Register.HOMING_OFFSET)
        return counted if self._counts_on else counted % TICKS_PER_TURN

    def acknowledges(self, code: int) -> bool:
        return code in (INST_PING, INST_READ) or self.value(Register.RESPONSE_LEVEL) != 0

    def maintain(self, code: int) -> bool:
        """Carry out INST_RESET, which finds no count of turns to clear."""
        return code == INST_RESET

    def make_middle(self) -> None:
        """Store the homing offset with which the present position reads 2048, or as near as the register allows."""
        self.memory.set(Register.HOMING_OFFSET, round(self.plant.position_ticks) % TICKS_PER_TURN - MIDDLE_TICKS)
        self._stored_eprom = self._present_eprom
        self._follow_registers()

    def encoder_ticks(self, shown_ticks: float) -> float:
        """Return the encoder's position for a PRESENT_POSITION: the nearest that the joint can reach."""
        plant = self.plant
        here = shown_ticks + self._turn_begins_at
        turns = (here, here - TICKS_PER_TURN, here + TICKS_PER_TURN)
        reachable = [ticks for ticks in turns if plant.lower_stop_ticks <= ticks <= plant.upper_stop_ticks]
        return min(reachable or turns[:1], key=lambda ticks: abs(ticks - plant.position_ticks))

    def step(self, duration_s: float) -> None:
        if not self._turn_ticks[0] <= self.plant.position_ticks < self._turn_ticks[1]:
            self._follow_drive()
        super().step(duration_s)

    def _measured(self) -> Iterable[tuple[Register, int]]:
        plant = self.plant
        driven = self._drive.torque_permille > 0.0
        return (
            (Register.PRESENT_POSITION, self.present_ticks),
            (Register.PRESENT_VELOCITY, round(plant.velocity_ticks_s)),
            (Register.PRESENT_LOAD, round(plant.duty_permille)),
            (Register.PRESENT_VOLTAGE, round(self.voltage_v / VOLT_PER_UNIT)),
            (Register.PRESENT_TEMPERATURE, round(self.motor.temperature_c)),
            (Register.STATUS, self.error),
            (Register.MOVING, int(driven and abs(plant.velocity_ticks_s) > STANDSTILL_TICKS_S)),
            (Register.GOAL_POSITION_ECHO, self._reachable_goal_ticks),
            (Register.PRESENT_CURRENT, round(plant.current_a / AMPERE_PER_UNIT)),
        )

    @property
    def _present_eprom(self) -> bytes:
        return self.memory.read(0, _EPROM_BYTES)

    @property
    def _counts_on(self) -> bool:
        return bool(self.value(Register.PHASE) & PHASE_MULTI_TURN)

    @property
    def _turn_begins_at(self) -> int:
        """Encoder position that reads as 0 in the present turn; while the position counts on, in the first one."""
        offset = self.value(Register.HOMING_OFFSET)
        turn = 0 if self._counts_on else (round(self.plant.position_ticks) - offset) // TICKS_PER_TURN
        return offset + turn * TICKS_PER_TURN

    def _thresholds_from_registers(self) -> Thresholds:
        value = self.value
        return Thresholds(
            voltage_v=(value(Register.MIN_VOLTAGE) * VOLT_PER_UNIT, value(Register.MAX_VOLTAGE) * VOLT_PER_UNIT),
            temperature_c=value(Register.MAX_TEMPERATURE),
            load_permille=value(Register.OVERLOAD_TORQUE) * PERMILLE_PER_PERCENT,
            overload_s=value(Register.PROTECTION_TIME) * PROTECTION_TIME_UNIT_S,
            current_a=value(Register.PROTECTION_CURRENT) * AMPERE_PER_UNIT,
            overcurrent_s=OVERCURRENT_TIME_S,
            latching=StatusFlag.OVERLOAD | StatusFlag.CURRENT,
        )

    def _drive_from_registers(self) -> Drive:
        lowest, highest = self.value(Register.MIN_ANGLE_LIMIT), self.value(Register.MAX_ANGLE_LIMIT)
        goal = self.value(Register.GOAL_POSITION)
        if (lowest, highest) != (0, 0):  # both 0 is multi-turn mode, without limits
            goal = max(lowest, min(highest, goal))
        self._reachable_goal_ticks = goal
        # A goal lies in the turn that is read: the servo does not take the short way across the seam.
        zero = self._turn_begins_at
        self._turn_ticks = (-math.inf, math.inf) if self._counts_on else (zero - 0.5, zero - 0.5 + TICKS_PER_TURN)
        acceleration = self.value(Register.ACCELERATION) or MAX_ACCELERATION
        torque_on = self.value(Register.TORQUE_ENABLE) == 1
        return Drive(
            goal_ticks=goal + zero,
            velocity_ticks_s=abs(self.value(Register.GOAL_VELOCITY)) or NO_LOAD_TICKS_S,
            acceleration_ticks_s2=acceleration * TICKS_S2_PER_ACCELERATION_UNIT,
            torque_permille=min(self.value(Register.TORQUE_LIMIT), self._duty_left_permille()) if torque_on else 0.0,
            p_gain=self.value(Register.P_GAIN),
        )

    def _duty_left_permille(self) -> float:
        """Return the largest duty that the errors of register UNLOADING_CONDITION leave [0.1 %]."""
        effective = self.protection.status & StatusFlag(self.value(Register.UNLOADING_CONDITION))
        if effective & ~StatusFlag.OVERLOAD:
            return 0.0
        if effective:
            return self.value(Register.PROTECTIVE_TORQUE) * PERMILLE_PER_PERCENT
        return FULL_DUTY_PERMILLE


class FeetechCodec(Codec):
    """Packets ``FF FF ID LEN INST P.. CHK`` and ``FF FF ID LEN ERR D.. CHK``."""

    header = HEADER
    word_bytes = 1
    rejection = None

    # Header, id, LEN and checksum.
    _FRAME_BYTES = 5

    def end_of_instruction(self, received: bytes, at: int) -> int | None:
        if at + self._FRAME_BYTES > len(received):
            return None
        end = at + received[at + 3] + self._FRAME_BYTES - 1
        # No servo has id 255: the header has begun a byte too early.
        return end if end <= len(received) or received[at + 2] > BROADCAST_ID else None

    def instruction(self, packet: bytes) -> Instruction | None:
        body = packet[2:-1]
        if len(body) <= LENGTH_OVERHEAD or packet[-1] != checksum(body):
            return None
        return Instruction(body[0], body[2], body[3:], len(packet))

    def status_packet(self, servo_id: int, error: int, data: bytes = b"") -> bytes:
        body = bytes([servo_id, len(data) + LENGTH_OVERHEAD, error]) + data
        return HEADER + body + bytes([checksum(body)])


FEETECH = FeetechCodec()


def emulated_feetech_arm(
    robot: RobotModel, config: EmulatedConfig, bounds: JointBounds, limits: GuardLimits, clock: Callable[[], float]
) -> EmulatedArm[FeetechServo]:
    """Build the emulated Feetech servos of an arm; raises OSError where log or control socket cannot be created."""
    population = POPULATIONS[config.population]
    servos = build_servos(config.calibration, start_pose_rad(config), population, as_read=config.resumes)
    holds = config.driven and (config.resumes or not any(population.offset_shift_ticks))
    log = WriteLog(config.write_log, append=config.resumes) if config.write_log else None
    arm = EmulatedArm(robot, config, Feetech(config.profile), servos, FEETECH, bounds, limits, clock, log, holds=holds)
    if config.control:
        # Only here: most arms take no commands, and pydantic takes its time.
        from robot.emulator.control import CommandedPort, ControlSocket

        arm.port = CommandedPort(arm.bus, clock, ControlSocket(config.control))
    return arm


def build_servos(
    calibration: Calibration, start_rad: Sequence[float], population: Population = FACTORY, *, as_read: bool = False
) -> list[FeetechServo]:
    """Build an arm's servos at a pose [rad], as true or as read; raises ValueError for a pose outside the ranges."""
    if len(start_rad) != len(calibration.joints):
        raise ValueError(f"the start pose needs {len(calibration.joints)} positions, not {len(start_rad)}")
    return [
        _servo(place, joint, position, population, as_read=as_read)
        for place, (joint, position) in enumerate(zip(calibration.joints, start_rad, strict=True))
    ]


def _servo(
    place: int, joint: JointCalibration, start_rad: float, population: Population, *, as_read: bool
) -> FeetechServo:
    if not joint.lower_rad <= start_rad <= joint.upper_rad:
        raise ValueError(
            f"{joint.joint} cannot start at {start_rad:g} rad, outside its range of "
            f"{joint.lower_rad:.3f} to {joint.upper_rad:.3f}"
        )

    def own(each: Sequence[int]) -> int:
        return each[place % len(each)]

    zero = joint.homing_offset + own(population.horn_ticks)
    offset = (joint.homing_offset if population.has_offsets else 0) + own(population.offset_shift_ticks)
    lower_stop, upper_stop = joint.range_min + zero, joint.range_max + zero
    if joint.servo.turns_freely and population.free_joint_stops_ticks is not None:
        lower_stop, upper_stop = (stop + zero for stop in population.free_joint_stops_ticks)
    start = joint.ticks_from_rad(start_rad) + (offset if as_read else zero)
    plant = Plant(max(lower_stop, min(upper_stop, start)), lower_stop, upper_stop)
    lowest, highest = population.limits_ticks or (joint.range_min, joint.range_max)
    eprom = {
        Register.ID: joint.servo_id if population.servo_id is None else population.servo_id,
        Register.MIN_ANGLE_LIMIT: lowest,
        Register.MAX_ANGLE_LIMIT: highest,
        Register.HOMING_OFFSET: offset,
        Register.FIRMWARE_MINOR: own(population.firmware),
        **population.registers,
        **(population.gripper if joint.servo.gripper else {}),
    }
    servo = FeetechServo(plant, eprom, joint=joint.joint, zero_ticks=zero)
    if joint.servo.gripper:
        servo.motor.heating = population.gripper_heating
    servo.voltage_v = population.supply_v
    servo.protection.latches = population.overload_latches
    servo.powers_up_holding = population.powers_up_holding
    servo.powers_up_unlocked = population.powers_up_unlocked
    servo.power_up()
    if population.unlocked:
        servo.set(Register.LOCK, 0)
    return servo
