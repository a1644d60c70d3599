"""The maker's own SDK on emulated Dynamixel servos: a second opinion on their packets."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler

from robot.emulator.adapter import InProcessPort
from robot.hardware.dynamixel.registers import Register
from tests.helpers.dynamixel import SteppedDynamixels

SDK = PacketHandler(2.0)


class SdkPort:
    """The methods of ``dynamixel_sdk``'s ``PortHandler`` on an in-process port, whose replies are there at once."""

    is_using = False

    def __init__(self, port: InProcessPort) -> None:
        self._port = port
        self._input = b""

    def clearPort(self) -> None:  # noqa: N802 - the SDK's name
        self._input = b""

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802 - the SDK's name
        sent = self._port.writePort(packet)
        self._input += self._port.receive(0.0)
        return sent

    def readPort(self, length: int) -> bytes:  # noqa: N802 - the SDK's name
        data, self._input = self._input[:length], self._input[length:]
        return data

    def getBaudRate(self) -> int:  # noqa: N802 - the SDK's name
        return self._port.baudrate

    def setPacketTimeout(self, packet_length: int) -> None: ...  # noqa: N802 - the SDK's name

    def setPacketTimeoutMillis(self, msec: float) -> None: ...  # noqa: N802 - the SDK's name

    def isPacketTimeout(self) -> bool:  # noqa: N802 - the SDK's name
        return not self._input


@pytest.fixture
def dynamixels() -> SteppedDynamixels:
    return SteppedDynamixels()


@pytest.fixture
def port(dynamixels: SteppedDynamixels) -> SdkPort:
    return SdkPort(dynamixels.port)


def test_the_sdk_pings_the_servos(port: SdkPort) -> None:
    assert SDK.ping(port, 1) == (1060, COMM_SUCCESS, 0)
    found, result = SDK.broadcastPing(port)
    assert result == COMM_SUCCESS
    assert found == {servo: [1060 if servo < 3 else 1200, 52] for servo in range(1, 7)}


def test_the_sdk_reads_and_writes_registers_and_reports_errors(port: SdkPort) -> None:
    assert SDK.write4ByteTxRx(port, 3, Register.GOAL_POSITION, 2100) == (COMM_SUCCESS, 0)
    assert SDK.read4ByteTxRx(port, 3, Register.GOAL_POSITION) == (2100, COMM_SUCCESS, 0)
    assert SDK.write1ByteTxRx(port, 3, Register.TORQUE_ENABLE, 2) == (COMM_SUCCESS, 6)


def test_the_sdk_unstuffs_what_the_servos_stuff(port: SdkPort, dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3).set(Register.GOAL_POSITION, -131073)
    assert SDK.read4ByteTxRx(port, 3, Register.GOAL_POSITION) == (2**32 - 131073, COMM_SUCCESS, 0)


def test_the_sdk_reads_and_writes_several_servos_at_once(port: SdkPort, dynamixels: SteppedDynamixels) -> None:
    writer = GroupSyncWrite(port, SDK, Register.GOAL_POSITION, 4)
    reader = GroupSyncRead(port, SDK, Register.GOAL_POSITION, 4)
    for servo in range(1, 7):
        assert writer.addParam(servo, list((100 * servo).to_bytes(4, "little")))
        assert reader.addParam(servo)
    assert writer.txPacket() == COMM_SUCCESS
    assert dynamixels.registers(Register.GOAL_POSITION) == [100, 200, 300, 400, 500, 600]
    assert reader.txRxPacket() == COMM_SUCCESS
    assert [reader.getData(servo, Register.GOAL_POSITION, 4) for servo in (1, 6)] == [100, 600]


def test_the_sdk_reboots_a_servo_and_waits_for_one_that_is_silent_in_vain(port: SdkPort) -> None:
    assert SDK.reboot(port, 3) == (COMM_SUCCESS, 0)
    assert SDK.ping(port, 3)[1] == COMM_RX_TIMEOUT
