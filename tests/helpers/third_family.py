"""Third family of servos, as someone would add one: its registers, its packets, its few methods; and such servos."""

from collections.abc import Sequence

from scservo_sdk import INST_READ, INST_SYNC_READ, INST_SYNC_WRITE

from robot.calibration import JointCalibration
from robot.errors import StartupError
from robot.hardware.interface import Steps
from robot.hardware.port import BusPort
from robot.hardware.servos.bus import BROADCAST_ID, Sdk, ServoBus, StatusFrame, write_verified
from robot.hardware.servos.family import Limit, ServoFamily, ServoFound, Values, label
from robot.hardware.servos.registers import TWOS_COMPLEMENT, Area, Block, RegisterEnum, RegisterTable, Telemetry


class Register(RegisterEnum):
    """Registers: address of the first byte, size in bytes, memory area, and sign."""

    MODEL_NUMBER = 0, 2, Area.READ_ONLY
    HOMING_OFFSET = 2, 2, Area.EEPROM, TWOS_COMPLEMENT
    LOWEST_POSITION = 4, 2, Area.EEPROM
    HIGHEST_POSITION = 6, 2, Area.EEPROM
    TORQUE_ENABLE = 8, 1, Area.RAM
    TORQUE_PERCENT = 9, 1, Area.RAM
    GOAL_POSITION = 10, 2, Area.RAM
    PRESENT_POSITION = 12, 2, Area.READ_ONLY
    PRESENT_SPEED = 14, 2, Area.READ_ONLY, 15
    PRESENT_DUTY = 16, 1, Area.READ_ONLY, TWOS_COMPLEMENT
    SUPPLY = 17, 1, Area.READ_ONLY
    TEMPERATURE = 18, 1, Area.READ_ONLY
    ERROR = 19, 1, Area.RAM


TABLE = RegisterTable(Register)

MODEL = 16
FULL_PERCENT = 100

# Packet: header, id, number of bytes that follow, command or error, data, sum.
HEADER = 0x55
OVERHEAD = 5


def packet(servo_id: int, command: int, data: Sequence[int] = ()) -> list[int]:
    body = [servo_id, len(data) + 2, command, *data]
    return [HEADER, *body, sum(body) & 0xFF]


class PlainPackets:
    """What a maker's SDK is for other families."""

    def txPacket(self, port: BusPort, txpacket: list[int]) -> int:  # noqa: N802 - the SDK's name
        port.clearPort()
        port.writePort(txpacket)
        return 0

    def getTxRxResult(self, result: int) -> str:  # noqa: N802 - the SDK's name
        return str(result)


class ThirdBus(ServoBus):
    """Bus of the third family."""

    registers = TABLE

    def _make_sdk(self) -> Sdk:
        return PlainPackets()

    def _packet(self, servo_id: int, instruction: int, parameters: Sequence[int]) -> list[int]:
        return packet(servo_id, instruction, parameters)

    def _parse_replies(self, received: bytes, ids: Sequence[int], data_length: int) -> dict[int, StatusFrame]:
        size = data_length + OVERHEAD
        packets = [received[at : at + size] for at in range(0, len(received), size)]
        return {
            reply[1]: StatusFrame(reply[1], reply[3], reply[4:-1])
            for reply in packets
            if len(reply) == size and reply[1] in ids and sum(reply[1:-1]) & 0xFF == reply[-1]
        }

    def _reply_bytes(self, data_length: int, replies: int) -> int:
        return replies * (data_length + OVERHEAD)


class Third(ServoFamily):
    """Servos of the third family."""

    bus = ThirdBus
    registers = TABLE
    motion = telemetry = TABLE.block(Register.PRESENT_POSITION, Register.ERROR)
    read_back = (TABLE.block(Register.TORQUE_ENABLE, Register.TORQUE_PERCENT),)
    goal_address = Register.GOAL_POSITION

    def check_model(self, joint: JointCalibration, model: int) -> None:
        if model != MODEL:
            raise StartupError(f"servo {label(joint)} is model {model}, not {MODEL}")

    def survey_blocks(self, joint: JointCalibration) -> Sequence[Block[Register]]:
        return (TABLE.block(Register.HOMING_OFFSET, Register.PRESENT_POSITION),)

    def check_settings(self, joint: JointCalibration, values: Values) -> None:
        """Any settings will do."""

    def position_limits_ticks(self, values: Values) -> tuple[int, int]:
        return values[Register.LOWEST_POSITION], values[Register.HIGHEST_POSITION]

    def max_voltage_v(self, values: Values) -> float:
        return 8.4

    def free_speed_rad_s(self, joint: JointCalibration) -> float:
        return 5.0

    def parse_telemetry(self, frame: StatusFrame, joint: JointCalibration) -> Telemetry:
        values = self.motion.parse(frame.data)
        return Telemetry(
            position_ticks=values[Register.PRESENT_POSITION],
            velocity_ticks_s=values[Register.PRESENT_SPEED],
            load=values[Register.PRESENT_DUTY] / FULL_PERCENT,
            current_a=float("nan"),
            voltage_v=values[Register.SUPPLY] / 10.0,
            temperature_c=values[Register.TEMPERATURE],
            status=values[Register.ERROR],
        )

    def limit(self, joint: JointCalibration, values: Values, share: float) -> Limit:
        return Limit(Register.TORQUE_PERCENT, round(share * FULL_PERCENT))

    def clear_error(self, bus: ServoBus, joint: JointCalibration) -> Steps[None]:
        yield from write_verified(bus, joint.servo_id, Register.TORQUE_ENABLE, 0)
        yield from write_verified(bus, joint.servo_id, Register.ERROR, 0)

    def has_restarted(self, found: ServoFound, values: Values, limit: Limit) -> bool:
        return values[Register.TORQUE_PERCENT] == FULL_PERCENT != limit.value


AFTER_POWER_UP = {
    Register.MODEL_NUMBER: MODEL,
    Register.TORQUE_ENABLE: 0,
    Register.TORQUE_PERCENT: FULL_PERCENT,
    Register.GOAL_POSITION: 0,
    Register.SUPPLY: 74,
    Register.TEMPERATURE: 30,
}


class ThirdServos:
    """Servos that are at their goals at once, and the port to them."""

    port_name, baudrate, is_using = "third", 115_200, False
    latency_s, quiet_s, discarded_bytes = 0.0, 0.0, 0

    def __init__(self, joints: Sequence[JointCalibration], at_rad: float) -> None:
        self.memory = {joint.servo_id: bytearray(len(Register) + 10) for joint in joints}
        for joint in joints:
            self.power_up(joint.servo_id)
            self.set(joint.servo_id, Register.LOWEST_POSITION, joint.range_min)
            self.set(joint.servo_id, Register.HIGHEST_POSITION, joint.range_max)
            self.set(joint.servo_id, Register.PRESENT_POSITION, joint.ticks_from_rad(at_rad))
        self._input = b""

    def power_up(self, servo_id: int) -> None:
        for register, value in AFTER_POWER_UP.items():
            self.set(servo_id, register, value)

    def value(self, servo_id: int, register: Register) -> int:
        return register.decode(bytes(self.memory[servo_id][register : register + register.size]))

    def set(self, servo_id: int, register: Register, value: int) -> None:
        self._write(servo_id, register, register.encode(value))

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name, as below
        self._input = b""

    def closePort(self) -> None:  # noqa: N802
        self._input = b""

    def receive(self, timeout_s: float, /) -> bytes:
        data, self._input = self._input, b""
        return data

    def writePort(self, packet: Sequence[int], /) -> int:  # noqa: N802
        _, servo_id, _, command, address, *data = packet[:-1]
        if command == INST_SYNC_READ:
            for each in data[1:]:
                self._reply(each, bytes(self.memory[each][address : address + data[0]]))
        elif command == INST_SYNC_WRITE:
            for at in range(1, len(data), data[0] + 1):
                self._write(data[at], address, bytes(data[at + 1 : at + 1 + data[0]]))
        elif command == INST_READ:
            self._reply(servo_id, bytes(self.memory[servo_id][address : address + data[0]]))
        elif servo_id == BROADCAST_ID:
            for each in self.memory:
                self._write(each, address, bytes(data))
        else:
            self._write(servo_id, address, bytes(data))
            self._reply(servo_id)
        return len(packet)

    def _reply(self, servo_id: int, data: bytes = b"") -> None:
        self._input += bytes(packet(servo_id, 0, data))

    def _write(self, servo_id: int, address: int, data: bytes) -> None:
        self.memory[servo_id][address : address + len(data)] = data
        if self.value(servo_id, Register.TORQUE_ENABLE):
            at, goal = Register.PRESENT_POSITION, Register.GOAL_POSITION
            self.memory[servo_id][at : at + 2] = self.memory[servo_id][goal : goal + 2]
