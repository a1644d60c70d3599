from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.arm import MAX_WAITING_BYTES
from robot.errors import NoReply
from robot.hardware.feetech.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES
from robot.hardware.port import LOCAL_LATENCY_S
from tests.helpers.emulator import ALL, COMMANDS, IDS, PING, REQUESTS, SYNC_READ, SteppedEmulator, packet
from tests.helpers.resources import examples

BLOCK_READ = packet(ALL, SYNC_READ, [TELEMETRY_ADDRESS, TELEMETRY_BYTES, *IDS])
STEP_S = 0.01


@pytest.fixture
def at_once() -> SteppedEmulator:
    """Servos on a wire that takes no time, as in the arm process."""
    return SteppedEmulator(wire_time=False)


@examples(40)
@given(
    st.lists(
        st.one_of(
            REQUESTS,
            st.sampled_from([0.02, 0.1, 1.0]),
            st.sampled_from([command for command in COMMANDS if "delay" not in command]),
        ),
        max_size=15,
    )
)
def test_the_packets_are_those_of_a_bus_whose_bytes_take_their_time(events: list[Any]) -> None:
    with_wire, without = SteppedEmulator(wire_time=True), SteppedEmulator(wire_time=False)
    for event in events:
        heard = []
        for emulator in (with_wire, without):
            if isinstance(event, bytes):
                emulator.port.writePort(event)
            elif isinstance(event, dict):
                emulator.command(**event)
            else:
                emulator.clock.advance(event)
            # Long enough for all that can be on the wire.
            emulator.clock.advance(2 * STEP_S)
            heard.append(emulator.port.receive(0.0))
        assert heard[0] == heard[1]


def test_replies_are_there_at_once_one_that_does_not_come_is_not_waited_for_and_no_time_passes(at_once):
    started_s = at_once.clock()
    at_once.port.writePort(BLOCK_READ)
    assert len(at_once.port.receive(1.0)) == 6 * (TELEMETRY_BYTES + 6)
    with pytest.raises(NoReply):
        at_once.open_bus().ping(9)
    assert at_once.clock() == started_s
    # Nor do USB frames delay a reply.
    at_once.clock.advance(0.0001)
    at_once.command(usb_frame_ms=1)
    assert len(at_once.open_bus().sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES)) == 6


def test_with_wire_time_replies_and_silence_are_waited_for_as_on_a_serial_port(emulator):
    started_s = emulator.clock()
    emulator.port.writePort(packet(1, PING))
    assert len(emulator.port.receive(1.0)) == 6
    assert emulator.clock() - started_s == pytest.approx(12 * 10e-6 + 20e-6)
    started_s = emulator.clock()
    assert emulator.port.receive(0.25) == b""
    assert emulator.clock() - started_s == pytest.approx(0.25)
    started_s = emulator.clock()
    with pytest.raises(NoReply):
        emulator.open_bus().ping(9, attempts=1)
    assert LOCAL_LATENCY_S < emulator.clock() - started_s < 0.01


def test_unexpected_bytes_are_discarded_and_counted_and_a_closed_port_has_none_left(at_once):
    at_once.port.writePort(packet(1, PING))
    at_once.port.clearPort()
    assert at_once.port.discarded_bytes == 6
    assert at_once.port.receive(0.0) == b""
    at_once.port.writePort(packet(1, PING))
    at_once.port.closePort()
    assert at_once.port.receive(0.0) == b""


def test_a_frozen_adapter_is_silent_and_keeps_no_more_than_a_pseudo_terminal(at_once):
    ping = packet(1, PING)
    at_once.command(frozen=True)
    for _ in range(MAX_WAITING_BYTES):
        assert at_once.port.writePort(ping) == len(ping)
    assert at_once.port.receive(1.0) == b""
    at_once.command(frozen=False)
    assert len(at_once.port.receive(1.0)) == MAX_WAITING_BYTES // len(ping) * len(ping)
