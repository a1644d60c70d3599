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
from robot.hardware.port import LOCAL_LATENCY_S, NETWORK_LATENCY_S, TERMINAL_LATENCY_S, _claim, _refusal, open_port
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


@pytest.fixture
def port(line):
    opened = open_port(line[1], BAUDRATE)
    yield opened
    opened.closePort()


def test_a_port_that_does_not_exist_or_is_busy_and_a_rate_no_servo_knows_are_refused(line, port, tmp_path):
    path = str(tmp_path / "ttyACM0")
    with pytest.raises(PortError, match=f"{path} does not exist"):
        open_port(path, BAUDRATE)
    with pytest.raises(PortBusy, match=f"{line[1]} is in use"):
        open_port(line[1], BAUDRATE)
    port.closePort()
    open_port(line[1], BAUDRATE).closePort()
    with pytest.raises(ValueError, match="921600"):
        open_port(line[1], 921_600)


def test_a_missing_permission_names_the_group_that_owns_the_device(monkeypatch):
    for number, names, advice in (
        (987, {987: "uucp"}, "sudo usermod -aG uucp $USER"),
        (987, {}, "--group-add 987"),
        (0, {0: "root"}, "sudo usermod -aG dialout $USER"),
    ):
        with monkeypatch.context() as patched:
            patched.setattr(os, "stat", lambda _path: os.stat_result((0o20660, 0, 0, 1, 0, number, 0, 0, 0, 0)))  # noqa: B023
            patched.setattr(grp, "getgrgid", lambda gid: grp.struct_group((names[gid], "x", gid, [])))  # noqa: B023
            said = str(_refusal("/dev/ttyACM0", errno.EACCES, "Permission denied"))
        assert all(words in said for words in (advice, "/dev/ttyACM0", "udev")), said


def test_bytes_pass_both_ways_unaltered_and_those_that_are_cleared_are_counted(line, port):
    # A program is behind a pseudo terminal.
    assert port.latency_s == TERMINAL_LATENCY_S > NETWORK_LATENCY_S > LOCAL_LATENCY_S
    every_byte = bytes(range(256))
    assert port.writePort(list(every_byte)) == 256
    assert os.read(line[0], 512) == every_byte
    os.write(line[0], every_byte)
    assert port.receive(1.0) == every_byte
    os.write(line[0], b"stale")
    port.clearPort()
    assert (port.discarded_bytes, port.receive(0.0)) == (5, b"")
    # A device that takes no bytes is lost, and not waited for.
    with pytest.raises(PortLost, match="timeout"):
        port.writePort(bytes(100_000))


def test_an_unplugged_port_is_lost_to_reader_and_writer_and_so_is_a_closed_one_rather_than_another_file(line, port):
    master, path, descriptors = line
    os.close(master)
    descriptors.discard(master)
    for words in (path, "not open"):
        with pytest.raises(PortLost, match=words):
            port.receive(1.0)
        with pytest.raises(PortLost, match=words):
            port.writePort([1, 2, 3])
        port.closePort()


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


def test_a_port_without_file_descriptor_is_refused():
    with pytest.raises(PortError, match="port loop:// has no file descriptor: of URLs, give socket://host:port"):
        open_port("loop://", BAUDRATE)


def is_claimed(descriptor):
    return fcntl.ioctl(descriptor, TIOCGEXCL, bytes(4)) != bytes(4)


def test_a_claim_keeps_out_programs_that_ignore_the_lock_but_would_outlive_the_owner_of_a_pseudo_terminal(line):
    open_port(line[1], BAUDRATE).closePort()
    descriptor = os.open(line[1], os.O_RDWR | os.O_NOCTTY)
    assert not is_claimed(descriptor)
    _claim(descriptor)
    assert is_claimed(descriptor)
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


def refusal(port: str = "auto") -> str:
    with pytest.raises(PortError) as refused:
        resolve_port(port)
    return str(refused.value)


def link(name: Path, path: Path) -> None:
    """Give a device a name that stays."""
    name.parent.mkdir(exist_ok=True)
    path.touch()
    name.symlink_to(path)


def test_a_known_board_is_found_among_others_and_one_of_servo_arms_first(plugged_in: list[ListPortInfo]) -> None:
    others = device("/dev/ttyUSB0", MODEM), device("/dev/ttyACM0", ARDUINO), device("/dev/ttyS0", None)
    for usb_id in CERTAIN + LESS_CERTAIN:
        plugged_in[:] = [*others, device("/dev/ttyACM1", usb_id)]
        assert resolve_port("auto") == "/dev/ttyACM1", usb_id
    for other in LESS_CERTAIN:
        plugged_in[:] = [device("/dev/ttyACM0", other), device("/dev/ttyACM1", CERTAIN[0])]
        assert resolve_port("auto") == "/dev/ttyACM1", other


@pytest.mark.parametrize("pair", [(CERTAIN[0], CERTAIN[0]), (CERTAIN[0], CERTAIN[1]), tuple(LESS_CERTAIN[:2])])
def test_two_boards_are_refused_with_the_names_that_stay_and_serial_numbers_or_sockets(
    plugged_in: list[ListPortInfo], pair: tuple[tuple[int, int], ...], tmp_path: Path
) -> None:
    names, by_socket = tmp_path / "NAMES_BY_DEVICE", tmp_path / "NAMES_BY_SOCKET"
    for number, usb_id in enumerate(pair):
        path = tmp_path / f"ttyACM{number}"
        link(names / f"usb-arm-{number}", path)
        link(by_socket / f"usb-0:{number}", path)
        plugged_in.append(device(str(path), usb_id, number=f"5A7A00{number}"))
    # A name before the arm's whose device is gone.
    (names / "usb-absent").symlink_to(tmp_path / "ttyACM9")
    for number, usb_id in enumerate(pair):
        assert f"{names}/usb-arm-{number} ({usb_id_text(usb_id)}, USB serial number 5A7A00{number})" in refusal()
    assert f"name one, as in --serial {names}/usb-arm-0" in refusal()
    (names / "usb-arm-0").unlink()
    for number, board in enumerate(plugged_in):
        board.serial_number = None
        assert f"{by_socket}/usb-0:{number} ({usb_id_text(pair[number])}, no USB serial number)" in refusal()
    plugged_in[:] = [device(str(tmp_path / "ttyACM1"), pair[1], number="5A7A001")]
    assert resolve_port("auto") == str(names / "usb-arm-1")


def test_any_board_is_found_by_its_usb_id_and_one_that_is_not_there_is_named(plugged_in: list[ListPortInfo]) -> None:
    plugged_in += [device("/dev/ttyACM1", CERTAIN[0], product="USB Single Serial")]
    assert "port 0403:6001 is the USB id of no serial device here: " in refusal("usb:0403:6001")
    assert "ttyACM1 (1a86:55d3" in refusal("usb:0403:6001")
    plugged_in += [device("/dev/ttyUSB0", (0x0403, 0x6001))]
    for port in ("usb:0403:6001", "0403:6001", "USB:0403:6001"):
        assert resolve_port(port) == "/dev/ttyUSB0"


def test_without_a_known_board_the_others_are_named_and_how_to_take_one(plugged_in: list[ListPortInfo]) -> None:
    # The machine's own ports are no USB devices, and are always there.
    own, uno = device("/dev/ttyS0", None), device("/dev/ttyACM0", ARDUINO, product="Uno")
    plugged_in += [own, uno, device("/dev/ttyUSB0", MODEM)]
    assert "found no known servo board" in refusal()
    assert "/dev/ttyACM0 (2341:0043, Uno), /dev/ttyUSB0 (12d1:1001, without a name)" in refusal()
    assert "name it, as in --serial 2341:0043" in refusal()
    assert "ttyS0" not in refusal()


@pytest.mark.usefixtures("plugged_in")
def test_with_nothing_plugged_in_the_advice_is_the_machines(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for file, content, advice in (
        ("KERNEL_RELEASE", "6.6.87.2-microsoft-standard-WSL2", "usbipd attach --wsl --busid"),
        ("KERNEL_RELEASE", "6.12.0-amd64", "a cable that carries data"),
        ("BOARD_MODEL", "Raspberry Pi 5 Model B Rev 1.0\0", "--serial /dev/serial0"),
    ):
        (tmp_path / file).write_text(content)
        assert "no USB serial device is plugged in" in refusal()
        assert advice in refusal()
    monkeypatch.setattr(boards, "CONTAINER_MARKS", (tmp_path,))
    assert "docker run --device /dev/ttyACM0" in refusal()


def test_the_page_about_hardware_lists_the_known_boards_and_a_udev_rule_for_each() -> None:
    page = (ROOT / "docs" / "hardware.md").read_text()
    rules = re.findall(r'ATTRS\{idVendor\}=="(\w{4})", ATTRS\{idProduct\}=="(\w{4})"', page)
    rows = re.findall(r"^\| `(\w{4}):(\w{4})` \|", page, re.MULTILINE)
    assert rules == rows == [tuple(usb_id_text(usb_id).split(":")) for usb_id in CERTAIN + LESS_CERTAIN]


CALIBRATION = nominal_calibration()
SERVOS = tuple(joint.joint for joint in CALIBRATION.joints)
POSE = {"elbow_flex": 0.4}


def test_simulated_joints_resume_where_they_were_left_and_real_ones_stay_by_themselves() -> None:
    robot = so101()
    for kind in ("feetech", "dynamixel"):
        real, emulated = SerialConfig(CALIBRATION, "/dev/arm", kind), EmulatedConfig(CALIBRATION, kind=kind, drop=0.1)
        assert real.joint_names(robot) == emulated.joint_names(robot) == SERVOS
        assert emulated.resumed(POSE, driven=True) == replace(emulated, start_rad=POSE, driven=True, resumes=True)
        assert real.resumed(POSE, driven=True) == real
    ideal = IdealConfig(0.2)
    assert ideal.joint_names(robot) == tuple(joint.name for joint in robot.movable_joints)
    assert ideal.resumed(POSE, driven=False) == IdealConfig(0.2, start_rad=POSE, driven=False)
    assert replace(emulated, rate=10.0).resumed(POSE, ClockReading(7.0, 2007.0), driven=True).clock == (7.0, 2007.0)
    assert emulated.resumed(POSE, ClockReading(7.0, 2007.0), driven=True).clock is None
