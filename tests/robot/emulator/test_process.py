from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
from dataclasses import fields, replace

import pytest
import serial

from robot.emulator.adapter import InProcessPort
from robot.emulator.control import Emulation
from robot.emulator.process import Control, UsbAdapter, add_options, build_bus, configure
from robot.emulator.servo_bus import Faults, Reply
from robot.hardware.feetech.registers import Register


@pytest.fixture
def adapter(tmp_path):
    adapter = UsbAdapter(tmp_path / "arm")
    yield adapter
    adapter.unplug()


@pytest.fixture
def client(adapter):
    with serial.Serial(adapter.port, 1_000_000, timeout=0) as line:
        yield line


def test_every_byte_passes_unaltered(adapter):
    client = os.open(adapter.port, os.O_RDWR | os.O_NOCTTY)
    every_byte = bytes(range(256))
    adapter.take([reply(1.0, every_byte)])
    adapter.deliver(1.0)
    assert os.read(client, 512) == every_byte
    os.write(client, every_byte)
    assert adapter.read() == every_byte
    assert adapter.read() == b""
    os.close(client)


def test_bytes_that_are_not_read_are_lost_without_a_wait(adapter):
    for at_s in range(100):
        adapter.take([reply(at_s, bytes(4096))])
        adapter.deliver(at_s)


@pytest.mark.parametrize(("set_to", "seen"), [(1_000_000, 1_000_000), (115_200, 115_200), (9600, 0)])
def test_the_baud_rate_is_the_one_that_the_client_sets(adapter, set_to, seen):
    with serial.Serial(adapter.port, set_to):
        assert adapter.baudrate == seen


def test_a_file_in_the_place_of_the_link_is_left_alone(tmp_path):
    link = tmp_path / "link"
    link.write_text("mine")
    with pytest.raises(FileExistsError):
        UsbAdapter(link)
    assert link.read_text() == "mine"


def reply(due_s, data):
    return Reply(due_s - 1e-5 * len(data), 1e-5, due_s, due_s, data)


BURST = [reply(1.0004, b"one"), reply(1.0012, b"two")]


def test_a_burst_is_given_as_a_whole_when_its_last_byte_is_due_and_does_not_wait_for_the_next(adapter, client):
    adapter.take(BURST)
    adapter.take([reply(9.0, b"late")])
    adapter.deliver(1.0011)
    assert client.read(9) == b""
    adapter.deliver(1.0012)
    assert client.read(9) == b"onetwo"


def test_with_frames_bytes_are_given_at_the_end_of_theirs(adapter, client):
    adapter.frame_s = 0.001
    adapter.take(BURST)
    adapter.deliver(1.0009)
    assert client.read(9) == b""
    adapter.deliver(1.0011)
    assert client.read(9) == b"one"
    adapter.deliver(1.0019)
    assert client.read(9) == b""
    adapter.deliver(1.0021)
    assert client.read(9) == b"two"


def test_the_wait_lasts_until_the_next_bytes_are_due(adapter):
    assert adapter.wait_s(1.0, 0.02) == 0.02
    adapter.take(BURST)
    assert adapter.wait_s(1.0, 0.02) == pytest.approx(0.0012)
    assert adapter.wait_s(5.0, 0.02) == 0.0
    adapter.frozen = True
    assert adapter.wait_s(5.0, 0.02) == 0.02


def test_a_frozen_adapter_takes_and_gives_nothing_until_it_goes_on(adapter, client):
    adapter.frozen = True
    adapter.take(BURST)
    client.write(b"late")
    adapter.deliver(9.0)
    assert client.read(9) == b""
    assert adapter.descriptors == []
    adapter.frozen = False
    adapter.deliver(9.0)
    assert client.read(9) == b"onetwo"
    assert len(adapter.descriptors) == 1
    assert adapter.read() == b"late"


def test_an_adapter_that_is_pulled_takes_port_and_link_away(adapter, client, tmp_path):
    adapter.take(BURST)
    adapter.unplug()
    assert not (tmp_path / "arm").is_symlink()
    with pytest.raises(serial.SerialException):
        client.read(1)
    assert adapter.descriptors == []
    assert (adapter.read(), adapter.baudrate) == (b"", 0)
    adapter.take(BURST)
    adapter.deliver(9.0)
    adapter.unplug()


@pytest.mark.parametrize("renamed", [False, True])
def test_an_adapter_that_comes_back_has_dropped_its_queue_and_the_link_leads_there(adapter, tmp_path, renamed):
    before = adapter.port
    adapter.take(BURST)
    adapter.unplug()
    adapter.plug_in(renamed=renamed)
    if renamed:
        assert adapter.port != before
    assert str((tmp_path / "arm").readlink()) == adapter.port
    with serial.Serial(str(tmp_path / "arm"), timeout=0) as line:
        adapter.deliver(9.0)
        assert line.read(9) == b""
    there, descriptors = adapter.port, adapter.descriptors
    adapter.plug_in(renamed=True)
    assert (adapter.port, adapter.descriptors) == (there, descriptors)


@pytest.mark.parametrize("essential", [True, False])
def test_only_an_essential_controller_that_is_gone_ends_the_emulator(essential):
    reader, writer = os.pipe()
    control = Control(reader, writer, essential=essential)
    assert control.wanted
    assert control.descriptors == [reader]
    os.close(writer)
    control.handle(None)
    os.close(reader)
    assert control.wanted is not essential
    assert control.descriptors == []


def parser():
    parser = argparse.ArgumentParser()
    add_options(parser)
    return parser


@contextlib.contextmanager
def built(*arguments):
    options = parser().parse_args(arguments)
    with contextlib.ExitStack() as resources:
        bus = build_bus(options, resources, 0.0)
        configure(options, Emulation(bus, InProcessPort(bus, lambda: 0.0)))
        yield bus


def test_without_options_there_is_an_arm_without_faults():
    chance = random.Random()
    with built() as bus:
        assert [servo.servo_id for servo in bus.servos] == [1, 2, 3, 4, 5, 6]
        assert replace(bus.faults, random=chance) == Faults(random=chance)
        assert {servo.plant.gravity_permille != 0.0 for servo in bus.servos[1:4]} == {True}


def test_every_fault_that_strikes_by_chance_is_an_option():
    for field in fields(Faults):
        if field.type == "float":
            with built("--" + field.name.replace("_", "-"), "0.25") as bus:
                assert getattr(bus.faults, field.name) == 0.25, field.name


def test_the_servos_are_of_the_kind_asked_for():
    with built("--supply", "4.8", "--heat-rate", "9", "--overload-latches", "--powers-up-holding") as bus:
        for servo in bus.servos:
            assert (servo.voltage_v, servo.motor.rate, servo.protection.latches) == (4.8, 9.0, True)
            assert servo.value(Register.TORQUE_ENABLE) == 1
            assert servo.value(Register.GOAL_POSITION) == servo.present_ticks


def test_the_bus_is_as_asked_for(tmp_path):
    log = tmp_path / "log"
    with built("--stall-behind-missing", "--delay-s", "0.1", "--write-log", str(log)) as bus:
        assert bus.faults.stall_behind_missing
        assert bus.faults.delay_s == 0.1
        bus.record_command({})
    assert json.loads(log.read_text())["command"] == {}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--start=a"], "not a list of numbers"),
        (["--drop", "2"], "drop: must be less than or equal to 1, not 2.0"),
        (["--supply", "nan"], "supply: must be a finite number, not nan"),
        (["--heat-rate=-1"], "heat_rate: must be greater than or equal to 0, not -1.0"),
    ],
)
def test_options_that_cannot_be_are_refused_in_a_sentence(capsys, arguments, sentence):
    with pytest.raises(SystemExit):
        parser().parse_args(arguments)
    assert sentence in capsys.readouterr().err
