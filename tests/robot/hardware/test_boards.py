"""Boards that are plugged in, as ``serial.tools.list_ports`` lists them, and the one that is opened."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.errors import PortError
from robot.hardware import boards
from robot.hardware.boards import KNOWN_BOARDS, usb_id_text
from robot.hardware.port import resolve_port

ROOT = Path(__file__).parents[3]
CERTAIN = [board.usb_id for board in KNOWN_BOARDS if board.certain]
LESS_CERTAIN = [board.usb_id for board in KNOWN_BOARDS if not board.certain]
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


@pytest.mark.parametrize("usb_id", [board.usb_id for board in KNOWN_BOARDS], ids=usb_id_text)
def test_one_known_board_is_found_among_other_devices(plugged_in: list[ListPortInfo], usb_id: tuple[int, int]) -> None:
    plugged_in += [
        device("/dev/ttyUSB0", MODEM),
        device("/dev/ttyACM0", ARDUINO),
        device("/dev/ttyS0", None),
        device("/dev/ttyACM1", usb_id),
    ]
    assert resolve_port("auto") == "/dev/ttyACM1"


@pytest.mark.parametrize("other", LESS_CERTAIN, ids=usb_id_text)
def test_a_board_of_servo_arms_comes_before_a_chip_that_other_devices_have(
    plugged_in: list[ListPortInfo], other: tuple[int, int]
) -> None:
    plugged_in += [device("/dev/ttyACM0", other), device("/dev/ttyACM1", CERTAIN[0])]
    assert resolve_port("auto") == "/dev/ttyACM1"


def test_no_board_is_listed_after_one_that_is_less_certain() -> None:
    assert [board.usb_id for board in KNOWN_BOARDS] == CERTAIN + LESS_CERTAIN


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


def test_two_boards_without_serial_numbers_are_told_apart_by_their_sockets(
    plugged_in: list[ListPortInfo], tmp_path: Path
) -> None:
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
    known = [tuple(usb_id_text(board.usb_id).split(":")) for board in KNOWN_BOARDS]
    assert rules == rows == known
