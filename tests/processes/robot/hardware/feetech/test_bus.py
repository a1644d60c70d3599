"""The bus on a pseudo terminal, in real time; tests/robot has it on a line in a time of its own."""

import contextlib

import pytest

from robot.errors import PortLost
from tests.helpers.bad_lines import good_readings_on_a_bad_line, halting_for, honest, read_telemetry


def test_a_burst_that_a_pseudo_terminal_carries_over_in_two_parts_is_whole(scripted_peer):
    with contextlib.closing(scripted_peer(halting_for(0.005)).open_bus()) as bus:
        assert len(read_telemetry(bus)) == 6


def test_an_unplugged_adapter_is_lost_and_the_bus_can_still_be_closed(scripted_peer):
    peer = scripted_peer(honest)
    with contextlib.closing(peer.open_bus()) as bus:
        bus.ping(1)
        peer.unplug()
        for _ in range(2):
            with pytest.raises(PortLost):
                read_telemetry(bus)


def test_no_reading_marked_good_is_wrong_whatever_a_pseudo_terminal_does(scripted_peer):
    assert good_readings_on_a_bad_line(scripted_peer, 0) > 50
