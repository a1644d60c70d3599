from __future__ import annotations

import pytest
from dynamixel_sdk import COMM_RX_TIMEOUT, COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler

from robot.emulator.dynamixel.in_process import DynamixelPort
from robot.errors import PortError, PortLost
from robot.hardware.dynamixel.registers import Register
from robot.hardware.interface import run_to_end
from tests.helpers.dynamixel import CALIBRATION, NAMES, SteppedDynamixels

SDK = PacketHandler(2.0)


@pytest.fixture
def dynamixels() -> SteppedDynamixels:
    return SteppedDynamixels()


@pytest.fixture
def port(dynamixels: SteppedDynamixels) -> DynamixelPort:
    return dynamixels.port


def test_the_sdk_pings_the_servos(port: DynamixelPort) -> None:
    assert SDK.ping(port, 1) == (1060, COMM_SUCCESS, 0)
    found, result = SDK.broadcastPing(port)
    assert result == COMM_SUCCESS
    assert found == {servo: [1060 if servo < 3 else 1200, 52] for servo in range(1, 7)}


def test_the_sdk_reads_and_writes_registers(port: DynamixelPort) -> None:
    assert SDK.write4ByteTxRx(port, 3, Register.GOAL_POSITION, 2100) == (COMM_SUCCESS, 0)
    assert SDK.read4ByteTxRx(port, 3, Register.GOAL_POSITION) == (2100, COMM_SUCCESS, 0)


def test_the_sdk_is_told_of_an_error(port: DynamixelPort) -> None:
    assert SDK.write1ByteTxRx(port, 3, Register.TORQUE_ENABLE, 2) == (COMM_SUCCESS, 6)


def test_the_sdk_unstuffs_what_the_servos_stuff(port: DynamixelPort, dynamixels: SteppedDynamixels) -> None:
    dynamixels.servo(3).set(Register.GOAL_POSITION, -131073)
    assert SDK.read4ByteTxRx(port, 3, Register.GOAL_POSITION) == (2**32 - 131073, COMM_SUCCESS, 0)


def test_the_sdk_reads_and_writes_several_servos_at_once(port: DynamixelPort, dynamixels: SteppedDynamixels) -> None:
    writer = GroupSyncWrite(port, SDK, Register.GOAL_POSITION, 4)
    reader = GroupSyncRead(port, SDK, Register.GOAL_POSITION, 4)
    for servo in range(1, 7):
        assert writer.addParam(servo, list((100 * servo).to_bytes(4, "little")))
        assert reader.addParam(servo)
    assert writer.txPacket() == COMM_SUCCESS
    assert dynamixels.registers(Register.GOAL_POSITION) == [100, 200, 300, 400, 500, 600]
    assert reader.txRxPacket() == COMM_SUCCESS
    assert [reader.getData(servo, Register.GOAL_POSITION, 4) for servo in (1, 6)] == [100, 600]


def test_the_sdk_reboots_a_servo_and_waits_for_one_that_is_silent_in_vain(port: DynamixelPort) -> None:
    assert SDK.reboot(port, 3) == (COMM_SUCCESS, 0)
    assert SDK.ping(port, 3)[1] == COMM_RX_TIMEOUT


def test_servos_hear_nothing_at_another_baud_rate(port: DynamixelPort) -> None:
    assert port.setBaudRate(57_600)
    assert (port.getBaudRate(), SDK.ping(port, 3)[1]) == (57_600, COMM_RX_TIMEOUT)


def test_an_unplugged_port_is_lost_and_can_be_opened_again_when_it_is_plugged_in(
    dynamixels: SteppedDynamixels, port: DynamixelPort
) -> None:
    port.unplug()
    with pytest.raises(PortLost):
        dynamixels.open_bus().ping(3)
    with pytest.raises(PortError, match="unplugged"):
        dynamixels.source.open()
    assert not port.openPort()
    port.plug_in()
    assert port.openPort()
    assert dynamixels.source.open().joint_names == NAMES


def test_a_closed_port_forgets_what_it_has_received(port: DynamixelPort) -> None:
    port.writePort(bytes.fromhex("fffffd0003030001254e"))
    port.clearPort()
    port.closePort()
    assert (port.getBytesAvailable(), port.readPort(10), port.is_open) == (0, b"", False)
    assert port.getPortName() == "simulated"


def test_servos_start_where_they_are_told_within_their_range() -> None:
    dynamixels = SteppedDynamixels(start_rad={"elbow_flex": 0.7, "gripper": 9.0})
    measured = dynamixels.source.open()
    read = measured.read()
    assert read.position_rad[2] == pytest.approx(0.7, abs=0.002)
    assert read.position_rad[5] == pytest.approx(CALIBRATION.joints[5].upper_rad, abs=0.002)
    assert read.position_rad[[0, 1, 3, 4]] == pytest.approx(0.0, abs=0.002)


def test_servos_that_an_arm_process_left_hold_where_they_were() -> None:
    dynamixels = SteppedDynamixels(start_rad={"elbow_flex": 0.7}, driven=True)
    dynamixels.run(1.0)
    found = run_to_end(dynamixels.source.open().survey())
    assert found.driven.all()
    assert found.goal_rad[2] == pytest.approx(0.7, abs=0.002)
    assert dynamixels.registers(Register.GOAL_PWM) == [708] * 5 + [442]


def test_simulated_servos_are_enabled_with_the_calibration_that_was_assumed() -> None:
    dynamixels = SteppedDynamixels()
    hardware = dynamixels.source.open()
    run_to_end(hardware.survey())
    run_to_end(hardware.enable(range(6)), dynamixels.run)
    assert dynamixels.registers(Register.TORQUE_ENABLE) == [1] * 6


def test_the_weight_of_the_links_is_on_the_servos_and_changes_with_the_pose() -> None:
    upright = SteppedDynamixels(start_rad={"shoulder_lift": -0.485}).servo(2).plant.gravity_permille
    dynamixels = SteppedDynamixels(start_rad={"shoulder_lift": 1.0})
    stretched = dynamixels.servo(2).plant.gravity_permille
    assert abs(stretched) > 1.2 * abs(upright) > 0.0
    # A relaxed arm sinks.
    before = dynamixels.servo(2).plant.position_ticks
    dynamixels.run(1.0)
    assert (dynamixels.servo(2).plant.position_ticks - before) * stretched < 0.0


def test_faults_of_the_bus_are_those_of_the_configuration() -> None:
    faults = SteppedDynamixels(drop=0.2, corrupt=0.1).servo_bus.faults
    assert (faults.drop, faults.corrupt) == (0.2, 0.1)
