import errno
import fcntl
import grp
import os
import pty
import re
import socket
import tty
from dataclasses import replace
from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.errors import PortBusy, PortError, PortLost
from robot.hardware import boards
from robot.hardware.boards import SERVO_BOARDS, SHARED_CHIPS, resolve_port, usb_id_text
from robot.hardware.config import ClockReading, EmulatedConfig, IdealConfig, SerialConfig
from robot.hardware.port import (
    LOCAL_LATENCY_S,
    NETWORK_LATENCY_S,
    TERMINAL_LATENCY_S,
    _claim,
    _refusal,
    open_port,
)
from tests.helpers.robots import nominal_calibration, so101

BAUDRATE = 1_000_000

# Reads the flag that TIOCEXCL sets (Linux, asm-generic/ioctls.h).
TIOCGEXCL = 0x80045440


@pytest.fixture
def line():
    """The master of a pseudo terminal, and the path of its raw slave, which stays open here."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    descriptors = {master, slave}
    yield master, os.ttyname(slave), descriptors
    for descriptor in descriptors:
        os.close(descriptor)


def test_a_path_that_does_not_exist_is_named(tmp_path):
    path = str(tmp_path / "ttyACM0")
    with pytest.raises(PortError, match=f"{path} does not exist"):
        open_port(path, BAUDRATE)


def test_a_port_that_another_has_open_is_busy(line):
    _, path, _ = line
    first = open_port(path, BAUDRATE)
    with pytest.raises(PortBusy, match=f"{path} is in use"):
        open_port(path, BAUDRATE)
    first.closePort()
    open_port(path, BAUDRATE).closePort()


@pytest.mark.parametrize(
    ("number", "names", "advice"),
    [
        (987, {987: "uucp"}, "sudo usermod -aG uucp $USER"),
        (987, {}, "--group-add 987"),
        (0, {0: "root"}, "sudo usermod -aG dialout $USER"),
    ],
)
def test_a_missing_permission_names_the_group_that_owns_the_device(monkeypatch, number, names, advice):
    with monkeypatch.context() as patched:
        patched.setattr(os, "stat", lambda _path: os.stat_result((0o20660, 0, 0, 1, 0, number, 0, 0, 0, 0)))
        patched.setattr(grp, "getgrgid", lambda gid: grp.struct_group((names[gid], "x", gid, [])))
        refusal = _refusal("/dev/ttyACM0", errno.EACCES, "Permission denied")
    said = str(refusal)
    assert advice in said
    assert "/dev/ttyACM0" in said
    assert "udev" in said


def test_a_baud_rate_no_servo_knows_is_refused(line):
    with pytest.raises(ValueError, match="921600"):
        open_port(line[1], 921_600)


def test_bytes_pass_both_ways_unaltered(line):
    master, path, _ = line
    port = open_port(path, BAUDRATE)
    every_byte = bytes(range(256))
    assert port.writePort(list(every_byte)) == 256
    assert os.read(master, 512) == every_byte
    os.write(master, every_byte)
    assert port.receive(1.0) == every_byte
    port.closePort()


def test_clearing_throws_away_what_came_and_counts_it(line):
    master, path, _ = line
    port = open_port(path, BAUDRATE)
    os.write(master, b"stale")
    port.clearPort()
    assert port.discarded_bytes == 5
    assert port.receive(0.0) == b""
    port.closePort()


def test_an_unplugged_port_is_lost_to_reader_and_writer(line):
    master, path, descriptors = line
    port = open_port(path, BAUDRATE)
    os.close(master)
    descriptors.discard(master)
    with pytest.raises(PortLost, match=path):
        port.receive(1.0)
    with pytest.raises(PortLost, match=path):
        port.writePort([1, 2, 3])
    port.closePort()


def test_a_device_that_takes_no_bytes_is_lost_and_not_waited_for(line):
    port = open_port(line[1], BAUDRATE)
    with pytest.raises(PortLost, match="timeout"):
        port.writePort(bytes(100_000))
    port.closePort()


def test_a_closed_port_is_lost_rather_than_another_file(line):
    port = open_port(line[1], BAUDRATE)
    port.closePort()
    port.closePort()
    with pytest.raises(PortLost, match="not open"):
        port.receive(0.0)
    with pytest.raises(PortLost, match="not open"):
        port.writePort([1])


def test_a_network_port_is_used_like_a_local_one_with_more_patience(line):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_port(f"socket://127.0.0.1:{server.getsockname()[1]}", BAUDRATE)
        peer, _ = server.accept()
        with peer:
            peer.sendall(b"hello")
            assert port.receive(1.0) == b"hello"
            port.writePort(b"world")
            assert peer.recv(16) == b"world"
        with pytest.raises(PortLost, match="closed"):
            port.receive(1.0)
        assert port.latency_s == NETWORK_LATENCY_S > LOCAL_LATENCY_S
        port.closePort()


def test_a_pseudo_terminal_is_given_more_time_than_a_serial_line_for_a_program_is_behind_it(line):
    port = open_port(line[1], BAUDRATE)
    assert port.latency_s == TERMINAL_LATENCY_S > NETWORK_LATENCY_S > LOCAL_LATENCY_S
    port.closePort()


def test_a_port_without_file_descriptor_is_read_with_a_timeout_too():
    port = open_port("loop://", BAUDRATE)
    assert port.receive(0.0) == b""
    port.writePort(b"echo")
    received = b""
    while len(received) < 4:
        received += port.receive(1.0) or pytest.fail("the echo does not come")
    assert received == b"echo"
    port.closePort()


def is_claimed(descriptor):
    return fcntl.ioctl(descriptor, TIOCGEXCL, bytes(4)) != bytes(4)


def test_a_claim_keeps_out_programs_that_ignore_the_lock(line):
    descriptor = os.open(line[1], os.O_RDWR | os.O_NOCTTY)
    assert not is_claimed(descriptor)
    _claim(descriptor)
    assert is_claimed(descriptor)
    os.close(descriptor)


def test_a_pseudo_terminal_is_not_claimed_since_the_claim_would_outlive_a_dead_owner(line):
    open_port(line[1], BAUDRATE).closePort()
    descriptor = os.open(line[1], os.O_RDWR | os.O_NOCTTY)
    assert not is_claimed(descriptor)
    os.close(descriptor)


ROOT = Path(__file__).parents[3]
CERTAIN, LESS_CERTAIN = list(SERVO_BOARDS), list(SHARED_CHIPS)
MODEM, ARDUINO = (0x12D1, 0x1001), (0x2341, 0x0043)


def device(path: str, usb_id: tuple[int, int] | None, number: str | None = None, product: str = "") -> ListPortInfo:
    info = ListPortInfo(path)
    info.vid, info.pid = usb_id or (None, None)
    info.serial_number, info.product = number, product or None
    return info


@pytest.fixture
def plugged_in(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[ListPortInfo]:
    found: list[ListPortInfo] = []
    monkeypatch.setattr(list_ports, "comports", lambda: found)
    for name in ("NAMES_BY_DEVICE", "NAMES_BY_SOCKET", "KERNEL_RELEASE", "BOARD_MODEL"):
        monkeypatch.setattr(boards, name, tmp_path / name)
    monkeypatch.setattr(boards, "CONTAINER_MARKS", ())
    return found


@pytest.mark.parametrize("usb_id", CERTAIN + LESS_CERTAIN, ids=usb_id_text)
def test_one_known_board_is_found_among_other_devices(plugged_in: list[ListPortInfo], usb_id: tuple[int, int]) -> None:
    plugged_in += [
        device("/dev/ttyUSB0", MODEM),
        device("/dev/ttyACM0", ARDUINO),
        device("/dev/ttyS0", None),
        device("/dev/ttyACM1", usb_id),
    ]
    assert resolve_port("auto") == "/dev/ttyACM1"


@pytest.mark.parametrize("other", LESS_CERTAIN, ids=usb_id_text)
def test_a_board_of_servo_arms_comes_before_other_chips(plugged_in: list[ListPortInfo], other: tuple[int, int]) -> None:
    plugged_in += [device("/dev/ttyACM0", other), device("/dev/ttyACM1", CERTAIN[0])]
    assert resolve_port("auto") == "/dev/ttyACM1"


@pytest.mark.parametrize(
    "pair", [(CERTAIN[0], CERTAIN[0]), (CERTAIN[0], CERTAIN[1]), (LESS_CERTAIN[0], LESS_CERTAIN[1])]
)
def test_two_boards_are_refused_with_both_names_and_serial_numbers(
    plugged_in: list[ListPortInfo], pair: tuple[tuple[int, int], tuple[int, int]], tmp_path: Path
) -> None:
    names = tmp_path / "NAMES_BY_DEVICE"
    names.mkdir()
    for number, usb_id in enumerate(pair):
        path = tmp_path / f"ttyACM{number}"
        path.touch()
        (names / f"usb-arm-{number}").symlink_to(path)
        plugged_in.append(device(str(path), usb_id, number=f"5A7A00{number}"))
    with pytest.raises(PortError) as refused:
        resolve_port("auto")
    for number, usb_id in enumerate(pair):
        assert f"{names}/usb-arm-{number} ({usb_id_text(usb_id)}, USB serial number 5A7A00{number})" in str(
            refused.value
        )
    assert f"name one, as in --serial {names}/usb-arm-0" in str(refused.value)


def test_two_boards_without_serial_numbers_differ_by_sockets(plugged_in: list[ListPortInfo], tmp_path: Path) -> None:
    by_device, by_socket = tmp_path / "NAMES_BY_DEVICE", tmp_path / "NAMES_BY_SOCKET"
    by_device.mkdir()
    by_socket.mkdir()
    for number in (0, 1):
        path = tmp_path / f"ttyUSB{number}"
        path.touch()
        (by_socket / f"usb-0:{number}").symlink_to(path)
        plugged_in.append(device(str(path), (0x1A86, 0x7523)))
    (by_device / "usb-1a86_USB_Serial").symlink_to(tmp_path / "ttyUSB1")
    with pytest.raises(PortError) as refused:
        resolve_port("auto")
    for number in (0, 1):
        assert f"{by_socket}/usb-0:{number} (1a86:7523, no USB serial number)" in str(refused.value)


def test_a_board_has_the_name_that_stays(plugged_in: list[ListPortInfo], tmp_path: Path) -> None:
    names, path = tmp_path / "NAMES_BY_DEVICE", tmp_path / "ttyACM0"
    path.touch()
    names.mkdir()
    (names / "usb-other").symlink_to(tmp_path / "ttyACM9")
    (names / "usb-arm").symlink_to(path)
    plugged_in += [device(str(path), CERTAIN[0])]
    assert resolve_port("auto") == str(names / "usb-arm")


@pytest.mark.parametrize("port", ["usb:0403:6001", "0403:6001", "USB:0403:6001"])
def test_any_board_is_found_by_its_usb_id(plugged_in: list[ListPortInfo], port: str) -> None:
    plugged_in += [device("/dev/ttyUSB0", (0x0403, 0x6001)), device("/dev/ttyACM1", CERTAIN[0])]
    assert resolve_port(port) == "/dev/ttyUSB0"


def test_a_usb_id_that_is_not_plugged_in_is_named(plugged_in: list[ListPortInfo]) -> None:
    plugged_in += [device("/dev/ttyACM1", CERTAIN[0], product="USB Single Serial")]
    with pytest.raises(
        PortError, match=r"port 0403:6001 is the USB id of no serial device here: .*ttyACM1 \(1a86:55d3"
    ):
        resolve_port("usb:0403:6001")


def test_without_a_known_board_the_others_are_named_and_how_to_take_one(plugged_in: list[ListPortInfo]) -> None:
    # The machine's own ports are no USB devices, and are always there.
    plugged_in += [
        device("/dev/ttyS0", None),
        device("/dev/ttyACM0", ARDUINO, product="Uno"),
        device("/dev/ttyUSB0", MODEM),
    ]
    with pytest.raises(PortError, match="found no known servo board") as refused:
        resolve_port("auto")
    assert "/dev/ttyACM0 (2341:0043, Uno), /dev/ttyUSB0 (12d1:1001, without a name)" in str(refused.value)
    assert "name it, as in --serial 2341:0043" in str(refused.value)
    assert "ttyS0" not in str(refused.value)


@pytest.mark.parametrize(
    ("file", "content", "advice"),
    [
        ("KERNEL_RELEASE", "6.6.87.2-microsoft-standard-WSL2", "usbipd attach --wsl --busid"),
        ("KERNEL_RELEASE", "6.12.0-amd64", "a cable that carries data"),
        ("BOARD_MODEL", "Raspberry Pi 5 Model B Rev 1.0\0", "--serial /dev/serial0"),
    ],
)
def test_with_nothing_plugged_in_the_advice_is_that_of_the_machine(
    plugged_in: list[ListPortInfo], tmp_path: Path, file: str, content: str, advice: str
) -> None:
    (tmp_path / file).write_text(content)
    with pytest.raises(PortError, match="no USB serial device is plugged in") as refused:
        resolve_port("auto")
    assert advice in str(refused.value)


def test_within_a_container_the_advice_is_to_give_it_the_device(
    plugged_in: list[ListPortInfo], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(boards, "CONTAINER_MARKS", (tmp_path,))
    with pytest.raises(PortError, match="docker run --device /dev/ttyACM0"):
        resolve_port("auto")


def test_the_page_about_hardware_lists_the_known_boards_and_a_udev_rule_for_each() -> None:
    page = (ROOT / "docs" / "hardware.md").read_text()
    rules = re.findall(r'ATTRS\{idVendor\}=="(\w{4})", ATTRS\{idProduct\}=="(\w{4})"', page)
    rows = re.findall(r"^\| `(\w{4}):(\w{4})` \|", page, re.MULTILINE)
    known = [tuple(usb_id_text(usb_id).split(":")) for usb_id in CERTAIN + LESS_CERTAIN]
    assert rules == rows == known


CALIBRATION = nominal_calibration()
SERVOS = tuple(joint.joint for joint in CALIBRATION.joints)
POSE = {"elbow_flex": 0.4}


def test_an_arm_with_servos_has_the_joints_of_its_calibration_and_an_ideal_one_all_that_move() -> None:
    robot = so101()
    assert SerialConfig(CALIBRATION, "/dev/arm").joint_names(robot) == SERVOS
    assert EmulatedConfig(CALIBRATION).joint_names(robot) == SERVOS
    assert SerialConfig(CALIBRATION, "/dev/arm", "dynamixel").joint_names(robot) == SERVOS
    assert EmulatedConfig(CALIBRATION, kind="dynamixel").joint_names(robot) == SERVOS
    assert IdealConfig().joint_names(robot) == tuple(joint.name for joint in robot.movable_joints)


def test_simulated_joints_resume_where_they_were_left_and_real_ones_stay_by_themselves() -> None:
    feetech, dynamixel = EmulatedConfig(CALIBRATION, drop=0.1), EmulatedConfig(CALIBRATION, kind="dynamixel", drop=0.1)
    assert feetech.resumed(POSE, driven=True) == replace(feetech, start_rad=POSE, driven=True, resumes=True)
    assert dynamixel.resumed(POSE, driven=True) == replace(dynamixel, start_rad=POSE, driven=True, resumes=True)
    assert IdealConfig(0.2).resumed(POSE, driven=False) == IdealConfig(0.2, start_rad=POSE, driven=False)
    assert replace(feetech, rate=10.0).resumed(POSE, ClockReading(7.0, 2007.0), driven=True).clock == (7.0, 2007.0)
    assert feetech.resumed(POSE, ClockReading(7.0, 2007.0), driven=True).clock is None
    for real in (SerialConfig(CALIBRATION, "/dev/arm"), SerialConfig(CALIBRATION, "/dev/arm", "dynamixel")):
        assert real.resumed(POSE, driven=True) == real
