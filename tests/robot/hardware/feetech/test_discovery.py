from __future__ import annotations

from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from robot.errors import PortError
from robot.hardware.feetech import discovery
from robot.hardware.feetech.discovery import resolve_port


def adapter(device: str, vid: int = 0x1A86, pid: int = 0x55D3) -> ListPortInfo:
    info = ListPortInfo(device)
    info.vid, info.pid = vid, pid
    return info


@pytest.fixture
def plugged_in(monkeypatch: pytest.MonkeyPatch) -> list[ListPortInfo]:
    found: list[ListPortInfo] = []
    monkeypatch.setattr(list_ports, "comports", lambda: found)
    return found


@pytest.mark.parametrize("port", ["/dev/ttyACM0", "socket://lab:2000"])
def test_a_named_port_is_taken_as_it_is(port: str) -> None:
    assert resolve_port(port) == port


def test_auto_finds_the_one_adapter_among_other_devices(plugged_in: list[ListPortInfo]) -> None:
    plugged_in += [adapter("/dev/ttyUSB0", vid=0x0403, pid=0x6001), adapter("/dev/ttyACM1")]
    assert resolve_port("auto") == "/dev/ttyACM1"


def test_auto_without_an_adapter_says_so(plugged_in: list[ListPortInfo]) -> None:
    with pytest.raises(PortError, match=r"found no servo adapter plugged in .*1a86:55d3"):
        resolve_port("auto")


def test_auto_with_two_adapters_asks_for_a_name(plugged_in: list[ListPortInfo]) -> None:
    plugged_in += [adapter("/dev/ttyACM0"), adapter("/dev/ttyUSB1", pid=0x7523)]
    with pytest.raises(PortError, match="ambiguous among /dev/ttyACM0, /dev/ttyUSB1"):
        resolve_port("auto")


@pytest.mark.parametrize("port", ["usb:0403:6001", "0403:6001", "USB:0403:6001"])
def test_an_adapter_is_found_by_its_usb_id(plugged_in: list[ListPortInfo], port: str) -> None:
    plugged_in += [adapter("/dev/ttyUSB0", vid=0x0403, pid=0x6001), adapter("/dev/ttyACM1")]
    assert resolve_port(port) == "/dev/ttyUSB0"


def test_a_usb_id_that_is_not_plugged_in_is_named(plugged_in: list[ListPortInfo]) -> None:
    plugged_in += [adapter("/dev/ttyACM1")]
    with pytest.raises(PortError, match=r"port usb:0403:6001 found no servo adapter .*0403:6001"):
        resolve_port("usb:0403:6001")


def test_an_adapter_is_given_the_name_that_stays(
    plugged_in: list[ListPortInfo], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    device, names = tmp_path / "ttyACM0", tmp_path / "by-id"
    device.touch()
    names.mkdir()
    (names / "usb-other").symlink_to(tmp_path / "ttyACM9")
    (names / "usb-arm").symlink_to(device)
    monkeypatch.setattr(discovery, "STABLE_NAMES", names)
    plugged_in += [adapter(str(device))]
    assert resolve_port("auto") == str(names / "usb-arm")
