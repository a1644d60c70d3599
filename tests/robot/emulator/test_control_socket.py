from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robot.emulator.arm import EmulatedArm
from robot.emulator.control import MAX_COMMAND_BYTES
from robot.emulator.control_socket import MAX_CONTROLLERS, CommandedPort, ControlSocket
from robot.emulator.feetech import FeetechServo, emulated_feetech_arm
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.interface import Measured
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION
from tests.helpers.emulator import SteppedClock
from tests.helpers.robots import so101

STEP_S = 0.01


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


def close(control: ControlSocket) -> None:
    control._listener.close()
    for controller in control._streams:
        controller.close()


@pytest.fixture
def make(clock: SteppedClock) -> Iterator[Callable[..., EmulatedArm[FeetechServo]]]:
    """Makes emulated servos; a process would close at its end what is closed here."""
    with contextlib.ExitStack() as made:

        def servos(**settings: object) -> EmulatedArm[FeetechServo]:
            config = EmulatedConfig(CALIBRATION, **settings)  # type: ignore[arg-type]
            one = emulated_feetech_arm(so101(), config, BOUNDS, GuardLimits(), clock)
            if one.bus.log is not None:
                made.callback(one.bus.log.close)
            assert isinstance(one.port, CommandedPort)
            made.callback(close, one.port._control)
            return one

        yield servos


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

    def __init__(self, servos: EmulatedArm[FeetechServo], clock: SteppedClock, path: Path) -> None:
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
    measured = controlled.servos.open().read()
    assert measured is not None
    assert measured.position_rad.shape == (6,)
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
