from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.control import MAX_COMMAND_BYTES
from robot.emulator.in_process import MAX_CONTROLLERS, MAX_WAITING_BYTES, CommandedPort, ControlSocket, EmulatedServos
from robot.errors import NoReply, PortError, PortLost, StartupError
from robot.hardware.config import EmulatedConfig
from robot.hardware.feetech.registers import TELEMETRY_ADDRESS, TELEMETRY_BYTES, Register
from robot.hardware.interface import Measured, run_to_end
from robot.hardware.port import LOCAL_LATENCY_S
from robot.hardware.servos.hardware import ServoHardware
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION, NAMES
from tests.helpers.emulator import ALL, COMMANDS, IDS, PING, REQUESTS, SYNC_READ, SteppedClock, SteppedEmulator, packet
from tests.helpers.resources import examples
from tests.helpers.robots import so101
from tests.helpers.server import read_write_log

BLOCK_READ = packet(ALL, SYNC_READ, [TELEMETRY_ADDRESS, TELEMETRY_BYTES, *IDS])
STEP_S = 0.01


# The port.


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


def test_a_delayed_reply_comes_late_and_holds_up_those_behind_it(at_once):
    at_once.command(delay=1.0, delay_s=0.03)
    at_once.port.writePort(packet(1, PING))
    assert at_once.port.receive(1.0) == b""
    at_once.command(delay=0.0)
    at_once.clock.advance(0.02)
    at_once.port.writePort(packet(2, PING))
    assert at_once.port.receive(1.0) == b""
    at_once.clock.advance(0.011)
    heard = at_once.port.receive(1.0)
    assert [heard[2], heard[8]] == [1, 2]


def test_unexpected_bytes_are_discarded_and_counted_and_a_closed_port_has_none_left(at_once):
    at_once.port.writePort(packet(1, PING))
    at_once.port.clearPort()
    assert at_once.port.discarded_bytes == 6
    assert at_once.port.receive(0.0) == b""
    at_once.port.writePort(packet(1, PING))
    at_once.port.closePort()
    assert at_once.port.receive(0.0) == b""


def test_a_frozen_adapter_is_silent_and_passes_on_what_waits_when_it_is_thawed(at_once):
    bus = at_once.open_bus()
    at_once.port.writePort(packet(1, PING))
    at_once.command(frozen=True)
    assert at_once.port.receive(1.0) == b""
    at_once.command(frozen=False)
    assert len(at_once.port.receive(1.0)) == 6
    at_once.command(frozen=True)
    assert bus.sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES) == {}
    with pytest.raises(NoReply):
        bus.write(1, Register.TORQUE_LIMIT, 300)
    at_once.command(frozen=False)
    assert bus.read(1, Register.TORQUE_LIMIT) == 300


def test_a_frozen_adapter_keeps_no_more_than_a_pseudo_terminal(at_once):
    ping = packet(1, PING)
    at_once.command(frozen=True)
    for _ in range(MAX_WAITING_BYTES):
        assert at_once.port.writePort(ping) == len(ping)
    at_once.command(frozen=False)
    assert len(at_once.port.receive(1.0)) == MAX_WAITING_BYTES // len(ping) * len(ping)


@pytest.mark.parametrize("frozen", [False, True])
def test_an_adapter_that_is_plugged_in_again_has_dropped_its_queue(at_once, frozen):
    at_once.command(frozen=frozen)
    at_once.port.writePort(packet(1, PING))
    at_once.command(plugged=False)
    at_once.command(frozen=False)
    at_once.command(plugged=True)
    at_once.port.check()
    assert at_once.port.receive(1.0) == b""


def test_an_unplugged_adapter_is_lost_to_reader_and_writer_and_cannot_be_opened(at_once):
    at_once.command(plugged=False)
    with pytest.raises(PortLost, match="simulated"):
        at_once.port.receive(0.0)
    with pytest.raises(PortLost, match="simulated"):
        at_once.open_bus().ping(1)
    with pytest.raises(PortError, match="unplugged"):
        at_once.port.check()


def test_the_servos_keep_their_registers_while_the_adapter_is_unplugged(at_once):
    bus = at_once.open_bus()
    bus.write(1, Register.TORQUE_LIMIT, 321)
    at_once.command(plugged=False)
    assert at_once.command(plugged="renamed") == {"ok": True, "port": "simulated"}
    assert bus.read(1, Register.TORQUE_LIMIT) == 321


def test_frames_of_usb_hold_replies_up_where_time_passes_on_the_wire(emulator):
    emulator.command(usb_frame_ms=1)
    emulator.port.writePort(packet(1, PING))
    assert len(emulator.port.receive(1.0)) == 6
    assert emulator.clock() == pytest.approx(100.001)


def test_usb_frames_delay_nothing_without_wire_time(at_once):
    at_once.clock.advance(0.0001)
    at_once.command(usb_frame_ms=1)
    assert len(at_once.open_bus().sync_read(IDS, TELEMETRY_ADDRESS, TELEMETRY_BYTES)) == 6


# The arm's servos as a source of hardware.


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


def close(control: ControlSocket) -> None:
    control._selector.close()
    control._listener.close()
    for controller in control._buffers:
        controller.close()


@pytest.fixture
def make(clock: SteppedClock) -> Iterator[Callable[..., EmulatedServos]]:
    """Makes emulated servos; what a process would close at its end is closed here."""
    with contextlib.ExitStack() as made:

        def servos(**settings: object) -> EmulatedServos:
            config = EmulatedConfig(CALIBRATION, **settings)  # type: ignore[arg-type]
            one = EmulatedServos(so101(), config, BOUNDS, GuardLimits(), clock)
            if one.bus._log is not None:
                made.callback(one.bus._log.close)
            if isinstance(one._port, CommandedPort):
                made.callback(close, one._port._control)
            return one

        yield servos


def read(hardware: object) -> Measured:
    assert isinstance(hardware, ServoHardware)
    measured = hardware.read()
    assert measured is not None
    return measured


@pytest.mark.parametrize(
    ("start_rad", "stands_rad"),
    [
        ({}, {}),
        ({"shoulder_lift": -0.5, "gripper": 0.3}, {"shoulder_lift": -0.5, "gripper": 0.3}),
        ({"shoulder_pan": 9.0}, {"shoulder_pan": CALIBRATION.joints[0].upper_rad}),
    ],
    ids=["in the middle", "where they are put", "inside the mechanical stops"],
)
def test_servos_start_relaxed_where_they_are_put(make, start_rad, stands_rad):
    hardware = make(start_rad=start_rad).open()
    assert read(hardware).position_rad == pytest.approx([stands_rad.get(name, 0.0) for name in NAMES], abs=0.002)
    assert not run_to_end(hardware.driven()).any()


def test_driven_servos_start_with_torque_on_and_stay_where_they_are(make, clock):
    hardware = make(start_rad={"shoulder_lift": -0.5}, driven=True).open()
    before = read(hardware).position_rad
    assert run_to_end(hardware.driven()).all()
    for _ in range(50):
        clock.advance(STEP_S)
        after = read(hardware).position_rad
    assert after == pytest.approx(before, abs=0.03)


def test_servos_with_a_shifted_zero_start_relaxed_and_are_refused_torque(make):
    hardware = make(population="ros2_driver", driven=True).open()
    run_to_end(hardware.survey())
    assert not run_to_end(hardware.driven()).any()
    with pytest.raises(StartupError, match="the zero has shifted since the calibration at shoulder_pan"):
        run_to_end(hardware.enable(range(6)))


def test_servos_that_are_found_again_are_where_they_were_read(make):
    first = make(population="ros2_driver", start_rad={"elbow_flex": 0.5})
    seen = dict(zip(NAMES, read(first.open()).position_rad.tolist(), strict=True))
    again = make(population="ros2_driver", start_rad=seen, resumes=True)
    assert read(again.open()).position_rad == pytest.approx(list(seen.values()), abs=0.002)


def test_servos_go_on_while_the_hardware_is_closed(make, clock):
    servos = make()
    hardware = servos.open()
    run_to_end(hardware.survey())
    run_to_end(hardware.enable(range(6)), clock.advance)
    hardware.close()
    assert run_to_end(servos.open().driven()).all()


def test_the_hardware_knows_that_its_servos_are_emulated(make):
    servos = make()
    servos.bus.faults.offline = {3}
    with pytest.raises(Exception, match=r"no answer from elbow_flex \(id 3\)$"):
        run_to_end(servos.open().survey())


def lost_replies(servos: EmulatedServos, clock: SteppedClock) -> list[int]:
    """Replies that are missing in each of some cycles."""
    hardware = servos.open()
    counters = hardware.counters
    assert counters is not None
    lost = []
    for _ in range(50):
        clock.advance(STEP_S)
        before = counters.timeouts
        hardware.read()
        lost.append(counters.timeouts - before)
    return lost


def test_replies_are_lost_or_damaged_as_often_as_configured_and_the_same_way_for_the_same_seed(make, clock):
    assert sum(lost_replies(make(), clock)) == 0
    assert 10 < sum(lost_replies(make(corrupt=0.1), clock)) < 60
    first, again, other = (lost_replies(make(drop=0.1, seed=seed), clock) for seed in (3, 3, 4))
    assert 10 < sum(first) < 60
    assert first == again != other


def test_every_write_is_on_record(make, clock, write_log):
    hardware = make(write_log=write_log).open()
    run_to_end(hardware.switch_off())
    assert read_write_log(write_log) == []
    run_to_end(hardware.survey())
    run_to_end(hardware.enable([0]), clock.advance)
    assert {servo for entry in read_write_log(write_log) for servo in entry["data"]} == {"1"}


@pytest.mark.parametrize(("resumes", "lines"), [(False, []), (True, ["{}"])])
def test_only_servos_that_were_there_before_go_on_with_their_record(make, write_log, resumes, lines):
    write_log.write_text("{}\n")
    make(write_log=write_log, resumes=resumes)
    assert write_log.read_text().splitlines() == lines


# The control socket.


class Controller:
    """Somebody who sends live commands."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.connect(str(path))
        self.socket.settimeout(30.0)
        self._lines = self.socket.makefile("rb")

    def send(self, line: bytes) -> None:
        self.socket.sendall(line)

    def answer(self) -> dict[str, object]:
        answered: dict[str, object] = json.loads(self._lines.readline())
        return answered

    @property
    def let_go(self) -> bool:
        """True once the emulator has closed the line."""
        with contextlib.suppress(ConnectionError):
            return self._lines.readline() == b""
        return True

    def close(self) -> None:
        self._lines.close()
        self.socket.close()


class Controlled:
    """Servos with a control socket, read cycle by cycle."""

    def __init__(self, servos: EmulatedServos, clock: SteppedClock, path: Path) -> None:
        self.servos = servos
        self.hardware = servos.open()
        self.path = path
        self._clock = clock

    def cycle(self) -> Measured | None:
        self._clock.advance(STEP_S)
        return self.hardware.read()


@pytest.fixture
def controlled(make, clock, tmp_path) -> Controlled:
    path = tmp_path / "control"
    return Controlled(make(control=path), clock, path)


@pytest.fixture
def connect(controlled) -> Iterator[Callable[[], Controller]]:
    with contextlib.ExitStack() as open_lines:

        def controller() -> Controller:
            made = Controller(controlled.path)
            open_lines.callback(made.close)
            controlled.cycle()
            return made

        yield controller


@pytest.mark.parametrize(
    ("pieces", "answers"),
    [
        ([b'{"offline": [3]}\n'], [{"ok": True}]),
        ([b'{"offline": [3]}\n\n{"plugged": true}\n'], [{"ok": True}, {"ok": True, "port": "simulated"}]),
        ([b'{"offl', b'ine": [3]}\n'], [{"ok": True}]),
    ],
    ids=["one", "several together", "one in pieces"],
)
def test_commands_are_carried_out_and_answered_in_their_order_in_the_next_cycle(controlled, connect, pieces, answers):
    controller = connect()
    for piece in pieces:
        controller.send(piece)
        controlled.cycle()
    assert [controller.answer() for _ in answers] == answers
    assert controlled.servos.bus.faults.offline == {3}


def test_a_command_that_makes_no_sense_is_answered_with_the_reason(controlled, connect):
    controller = connect()
    controller.send(b'{"explode": 1}\n')
    controlled.cycle()
    assert "unknown command" in str(controller.answer()["error"])


def test_several_controllers_are_served(controlled, connect):
    controllers = [connect(), connect()]
    for number, controller in enumerate(controllers):
        controller.send(b'{"offline": [%d]}\n' % (3 + number))
    controlled.cycle()
    assert [controller.answer() for controller in controllers] == [{"ok": True}] * 2
    assert controlled.servos.bus.faults.offline == {3, 4}


def test_a_controller_that_goes_away_makes_room_for_others(controlled, connect):
    for _ in range(MAX_CONTROLLERS):
        connect().close()
        controlled.cycle()
    stays = connect()
    stays.send(b'{"offline": [3]}\n')
    controlled.cycle()
    assert stays.answer() == {"ok": True}


def test_a_controller_that_sends_no_line_end_is_let_go(controlled, connect):
    controller = connect()
    sent = 0
    with contextlib.suppress(OSError):
        while sent <= MAX_COMMAND_BYTES + 4096:
            controller.send(b"x" * 4096)
            sent += 4096
            controlled.cycle()
    assert controller.let_go


def test_more_controllers_than_can_be_wanted_are_let_go(controlled, connect):
    controllers = [connect() for _ in range(MAX_CONTROLLERS + 1)]
    assert controllers[-1].let_go
    controllers[-2].send(b'{"offline": [3]}\n')
    controlled.cycle()
    assert controllers[-2].answer() == {"ok": True}


def test_an_adapter_is_pulled_and_plugged_in_by_commands(controlled, connect):
    controller = connect()
    controller.send(b'{"plugged": false}\n')
    with pytest.raises(PortLost):
        controlled.cycle()
    with pytest.raises(PortError, match="unplugged"):
        controlled.servos.open()
    controller.send(b'{"plugged": true}\n')
    assert read(controlled.servos.open()).position_rad.shape == (6,)
    assert [controller.answer()["ok"], controller.answer()["ok"]] == [True, True]


def test_a_socket_that_an_ended_process_has_left_is_replaced(make, tmp_path):
    path = tmp_path / "control"
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(path))
    make(control=path)
    with contextlib.closing(Controller(path)):
        pass


def test_a_file_in_the_place_of_the_socket_is_left_alone(make, tmp_path):
    path = tmp_path / "control"
    path.write_text("mine")
    with pytest.raises(OSError, match="in use"):
        make(control=path)
    assert path.read_text() == "mine"


def test_a_live_command_is_on_record_among_the_writes(make, clock, tmp_path, write_log):
    path = tmp_path / "control"
    controlled = Controlled(make(control=path, write_log=write_log), clock, path)
    with contextlib.closing(Controller(path)) as controller:
        controlled.cycle()
        controller.send(b'{"push": {"2": 50}}\n')
        controlled.cycle()
    (line,) = read_write_log(write_log)
    assert (line["command"], line["t"]) == ({"push": {"2": 50}}, pytest.approx(clock()))
