from __future__ import annotations

import errno
import fcntl
import grp
import os
import pty
import socket
import tty

import pytest

from robot.errors import PortBusy, PortLost, PortNotFound, PortPermission
from robot.hardware.port import (
    LOCAL_LATENCY_S,
    NETWORK_LATENCY_S,
    TERMINAL_LATENCY_S,
    _claim,
    _refusal,
    open_port,
)

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
    with pytest.raises(PortNotFound, match=path) as caught:
        open_port(path, BAUDRATE)
    assert caught.value.port == path


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
    assert isinstance(refusal, PortPermission)
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
