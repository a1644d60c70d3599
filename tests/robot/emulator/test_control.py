import contextlib
import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from harness.waiting import TIMEOUT_S
from robot.emulator.arm import EmulatedArm
from robot.emulator.control import (
    COMMANDS_HELP,
    MAX_COMMAND_BYTES,
    MAX_CONTROLLERS,
    CommandedPort,
    ControlSocket,
    Emulation,
    LiveCommand,
    answer,
)
from robot.emulator.feetech import FEETECH, FeetechServo, build_servos, emulated_feetech_arm
from robot.emulator.process import UsbAdapter
from robot.emulator.servo_bus import EmulatedBus, Faults, WriteLog
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import Measured, StatusFlag
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION
from tests.helpers.emulated_family import run
from tests.helpers.emulator import SteppedClock
from tests.helpers.robots import nominal_calibration, so101


@pytest.fixture
def log_path(tmp_path):
    return tmp_path / "log"


@pytest.fixture
def emulation(log_path):
    log, adapter = WriteLog(log_path), UsbAdapter()
    servos = build_servos(nominal_calibration(), [0.0] * 6)
    yield Emulation(EmulatedBus(servos, FEETECH, Faults(), 0.0, log), adapter)
    adapter.unplug()
    log.close()


@pytest.fixture
def command(emulation):
    """Sends live commands; returns the answer."""

    def send(**commands):
        return json.loads(answer(json.dumps(commands).encode(), emulation))

    return send


def test_every_command_is_carried_out_and_acknowledged(emulation, command):
    faults = emulation.bus.faults
    assert command(drop=0.25, corrupt=1, offline=[3, 4]) == {"ok": True}
    assert (faults.drop, faults.corrupt, faults.offline) == (0.25, 1.0, {3, 4})
    assert command(online=[3], push={"2": 50, "elbow_flex": -7}) == {"ok": True}
    assert faults.offline == {4}
    assert [servo.plant.push_permille for servo in emulation.bus.servos] == [0, 50, -7, 0, 0, 0]


def test_an_adapter_comes_and_goes_and_its_name_is_reported(emulation, command):
    before = emulation.adapter.port
    assert command(plugged=False) == {"ok": True, "port": before}
    assert emulation.adapter.descriptors == []
    reply = command(plugged="renamed")
    assert reply == {"ok": True, "port": emulation.adapter.port}
    assert reply["port"] != before
    assert len(emulation.adapter.descriptors) == 1


def test_switches_reach_bus_and_adapter_and_go_on_and_off(emulation, command):
    for on in (True, False):
        command(stall_behind_missing=on, frozen=on)
        assert emulation.bus.faults.stall_behind_missing is on
        assert emulation.adapter.frozen is on


def test_every_command_is_documented_with_an_example_that_is_carried_out(emulation):
    lines = COMMANDS_HELP.split("\n\n")[1].splitlines()
    assert [next(iter(json.loads(line.split("  ")[0]))) for line in lines] == list(LiveCommand.model_fields)
    for line in lines:
        assert json.loads(answer(line.split("  ")[0].encode(), emulation))["ok"], line
        assert len(line) <= 120


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"{", "no JSON at column 2: Expecting"),
        (b"\xff", "decode"),
        (b"[]", "a command is a JSON object, not []"),
        (b'{"explode": 1}', "unknown command 'explode'; there are drop, corrupt,"),
        (b'{"drop": 1.5}', "drop: must be less than or equal to 1, not 1.5"),
        (b'{"corrupt": NaN}', "corrupt: must be a finite number, not nan"),
        (b'{"noise": true}', "noise: must be a valid number, not True"),
        (b'{"offline": [7]}', "offline.0: must be a servo id out of 1, 2, 3, 4, 5, 6, or a joint's name, not 7"),
        (b'{"delay_s": 1' + b"0" * 400 + b"}", "delay_s: must be a valid number, not 1000"),
        (b'{"online": [[]]}', "online.0: must be a servo id out of"),
        (b'{"offline": 3}', "offline: must be a valid list, not 3"),
        (
            b'{"unplug": ["thumb"]}',
            "unplug.0: must be a number out of 1, 2, 3, 4, 5, 6, or a joint's name, not 'thumb'",
        ),
        (b'{"hand": {"7": 2000}}', "hand.7: must be a servo id out of"),
        (b'{"hand": {"1": 5000}}', "hand.1: must be less than or equal to 4095, not 5000"),
        (b'{"frozen": 1}', "frozen: must be a valid boolean, not 1"),
        (b'{"plugged": "elsewhere"}', "plugged: must be True, False or 'renamed', not 'elsewhere'"),
    ],
)
def test_what_makes_no_sense_is_answered_with_field_limit_and_value(emulation, line, reason):
    reply = answer(line, emulation)
    assert reply.endswith(b"\n")
    assert reason in json.loads(reply)["error"]


def test_no_part_of_a_refused_command_is_carried_out(emulation, command):
    assert "error" in command(drop=0.5, offline=[9])
    assert emulation.bus.faults.drop == 0.0


@pytest.fixture
def servo(emulation):
    servo = emulation.bus.servos[2]
    servo.write(Register.GOAL_POSITION, Register.GOAL_POSITION.encode(2048))
    servo.write(Register.TORQUE_ENABLE, bytes([1]))
    return servo


def test_numbers_go_where_they_belong(emulation, command):
    command(delay_s=0.1, supply=4.5, heat_rate=7.0, usb_frame_ms=1.0)
    assert emulation.bus.faults.delay_s == 0.1
    assert emulation.adapter.frame_s == 0.001
    assert {(servo.voltage_v, servo.motor.rate) for servo in emulation.bus.servos} == {(4.5, 7.0)}


@pytest.mark.parametrize(
    ("commands", "torque_and_goal"),
    [
        ({"power_cycle": [3]}, (0, 0)),
        ({"torque_off": [3]}, (0, 2048)),
        ({"powers_up_holding": [3], "power_cycle": [3]}, (1, 2048)),
    ],
    ids=["a power cycle forgets both", "torque off behind the driver's back", "a servo that powers up holding"],
)
def test_torque_and_goal_of_a_servo_after_commands(command, servo, commands, torque_and_goal):
    command(**commands)
    assert (servo.value(Register.TORQUE_ENABLE), servo.value(Register.GOAL_POSITION)) == torque_and_goal


@pytest.mark.parametrize(("name", "offset", "at", "goal"), [("obstacle", -40, 2100, 2400), ("hand", 40, 1900, 2048)])
def test_an_obstacle_or_a_hand_is_at_a_present_position_until_it_ends(command, servo, name, offset, at, goal):
    servo.write(Register.HOMING_OFFSET, Register.HOMING_OFFSET.encode(offset))
    command(**{name: {"3": at}})
    servo.write(Register.GOAL_POSITION, Register.GOAL_POSITION.encode(goal))
    run(servo, 1.0)
    assert servo.present_ticks == at
    command(**{name: {"3": None}})
    run(servo, 1.0)
    assert servo.present_ticks == goal


def test_the_rest_reaches_the_servo(command, servo):
    before = servo.present_ticks
    command(push={"3": 100}, jump={"3": 400}, temperature={"3": 66}, voltage={"3": 4.2}, status={"3": 2})
    assert servo.plant.push_permille == 100.0
    assert servo.present_ticks == before + 400
    assert (servo.motor.temperature_c, servo.voltage_v) == (66.0, 4.2)
    run(servo, 0.02)
    assert servo.error == StatusFlag.ENCODER


# The socket.


STEP_S = 0.01


@pytest.fixture
def clock() -> SteppedClock:
    return SteppedClock()


def close(control: ControlSocket) -> None:
    control._listener.close()
    for controller in control._controllers:
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
        self.socket.settimeout(TIMEOUT_S)
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
