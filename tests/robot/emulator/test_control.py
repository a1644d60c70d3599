import contextlib
import json
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from harness.waiting import TIMEOUT_S
from robot.emulator.control import (
    COMMANDS_HELP,
    MAX_COMMAND_BYTES,
    MAX_CONTROLLERS,
    CommandedPort,
    Emulation,
    LiveCommand,
    answer,
)
from robot.emulator.feetech import FEETECH, build_servos, emulated_feetech_arm
from robot.emulator.process import UsbAdapter
from robot.emulator.servo_bus import EmulatedBus, Faults, WriteLog
from robot.errors import PortError, PortLost
from robot.hardware.config import EmulatedConfig
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import Measured, StatusFlag
from robot.messages import GuardLimits
from tests.helpers.arm_rig import BOUNDS, CALIBRATION
from tests.helpers.emulator import SteppedClock
from tests.helpers.robots import nominal_calibration, so101
from tests.helpers.servo_families import run


@pytest.fixture
def emulation(tmp_path):
    log, adapter = WriteLog(tmp_path / "log"), UsbAdapter()
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


def test_every_command_is_carried_out_and_acknowledged_and_no_part_of_one_that_is_refused(emulation, command):
    faults, adapter = emulation.bus.faults, emulation.adapter
    assert command(drop=0.25, corrupt=1, offline=[3, 4]) == {"ok": True}
    assert (faults.drop, faults.corrupt, faults.offline) == (0.25, 1.0, {3, 4})
    assert command(online=[3], push={"2": 50, "elbow_flex": -7}) == {"ok": True}
    assert faults.offline == {4}
    assert [servo.plant.push_permille for servo in emulation.bus.servos] == [0, 50, -7, 0, 0, 0]
    assert "error" in command(drop=0.5, offline=[9])
    assert faults.drop == 0.25
    for on in (True, False):
        command(stall_behind_missing=on, frozen=on)
        assert (faults.stall_behind_missing, adapter.frozen) == (on, on)
    command(delay_s=0.1, supply=4.5, heat_rate=7.0, usb_frame_ms=1.0)
    assert (faults.delay_s, adapter.frame_s) == (0.1, 0.001)
    assert {(servo.voltage_v, servo.motor.rate) for servo in emulation.bus.servos} == {(4.5, 7.0)}
    command(overload_latches=[3])
    assert [servo.protection.latches for servo in emulation.bus.servos] == [False, False, True, False, False, False]
    before = adapter.port
    assert command(plugged=False) == {"ok": True, "port": before}
    assert adapter.descriptors == []
    assert command(plugged="renamed") == {"ok": True, "port": adapter.port}
    assert adapter.port != before
    assert len(adapter.descriptors) == 1


def test_every_command_is_documented_with_an_example_that_is_carried_out(emulation):
    lines = COMMANDS_HELP.split("\n\n")[1].splitlines()
    assert [next(iter(json.loads(line.split("  ")[0]))) for line in lines] == list(LiveCommand.model_fields)
    for line in lines:
        assert json.loads(answer(line.split("  ")[0].encode(), emulation))["ok"], line
        assert len(line) <= 120


def test_what_makes_no_sense_is_answered_with_field_limit_and_value(emulation):
    for line, reason in (
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
    ):
        reply = answer(line, emulation)
        assert reply.endswith(b"\n")
        assert reason in json.loads(reply)["error"]


@pytest.fixture
def servo(emulation):
    servo = emulation.bus.servos[2]
    servo.write(Register.GOAL_POSITION, Register.GOAL_POSITION.encode(2048))
    servo.write(Register.TORQUE_ENABLE, bytes([1]))
    return servo


@pytest.mark.parametrize(
    ("commands", "torque_and_goal"),
    [
        ({"power_cycle": [3]}, (0, 0)),
        ({"torque_off": [3]}, (0, 2048)),
        ({"powers_up_holding": [3], "power_cycle": [3]}, (1, 2048)),
    ],
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
    command(push={"3": 100}, jump={"3": 400}, temperature={"3": 66}, voltage={"3": 4.2}, status={"3": 2})
    assert (servo.plant.push_permille, servo.present_ticks) == (100.0, goal + 400)
    assert (servo.motor.temperature_c, servo.voltage_v) == (66.0, 4.2)
    run(servo, 0.02)
    assert servo.error == StatusFlag.ENCODER


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
    """Servos with a control socket, read cycle by cycle, and the clients that control them."""

    def __init__(self, path: Path, resources: contextlib.ExitStack) -> None:
        self._path, self._resources, self._clock = path, resources, SteppedClock()
        config = EmulatedConfig(CALIBRATION, control=path)
        self.servos = emulated_feetech_arm(so101(), config, BOUNDS, GuardLimits(), self._clock)
        self.hardware = self.servos.open()
        resources.callback(self._close)

    def cycle(self) -> Measured | None:
        self._clock.advance(0.01)
        return self.hardware.read()

    def connect(self) -> Controller:
        controller = self._resources.enter_context(contextlib.closing(Controller(self._path)))
        self.cycle()
        return controller

    def _close(self) -> None:
        """Close what a process would close at its end."""
        assert isinstance(self.servos.port, CommandedPort)
        control = self.servos.port._control
        for each in (control._listener, *control._controllers):
            each.close()


@pytest.fixture
def resources() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


@pytest.fixture
def controlled(resources, tmp_path) -> Controlled:
    return Controlled(tmp_path / "control", resources)


@pytest.mark.parametrize(
    ("pieces", "answers"),
    [
        ([b'{"offline": [3]}\n'], [{"ok": True}]),
        ([b'{"offline": [3]}\n\n{"plugged": true}\n'], [{"ok": True}, {"ok": True, "port": "simulated"}]),
        ([b'{"offl', b'ine": [3]}\n'], [{"ok": True}]),
    ],
)
def test_commands_are_carried_out_and_answered_in_their_order_in_the_next_cycle(controlled, pieces, answers):
    controller = controlled.connect()
    for piece in pieces:
        controller.send(piece)
        controlled.cycle()
    assert [controller.answer() for _ in answers] == answers
    assert controlled.servos.bus.faults.offline == {3}


def test_a_controller_without_a_line_end_or_one_too_many_is_let_go_and_those_that_go_away_make_room(controlled):
    for _ in range(MAX_CONTROLLERS):
        controlled.connect().close()
        controlled.cycle()
    controllers = [controlled.connect() for _ in range(MAX_CONTROLLERS + 1)]
    assert controllers[-1].let_go
    controllers[-2].send(b'{"plugged": false}\n')
    with pytest.raises(PortLost):
        controlled.cycle()
    with pytest.raises(PortError, match="unplugged"):
        controlled.servos.open()
    controllers[-2].send(b'{"plugged": true}\n')
    assert controlled.servos.open().read().position_rad.shape == (6,)
    assert [controllers[-2].answer()["ok"] for _ in range(2)] == [True, True]
    with contextlib.suppress(OSError):
        for _ in range(MAX_COMMAND_BYTES // 4096 + 2):
            controllers[0].send(b"x" * 4096)
            controlled.cycle()
    assert controllers[0].let_go


def test_a_socket_that_an_ended_process_has_left_is_replaced_and_a_file_left_alone(resources, tmp_path):
    left, file = tmp_path / "control", tmp_path / "file"
    with socket.socket(socket.AF_UNIX) as ended:
        ended.bind(str(left))
    Controlled(left, resources).connect()
    file.write_text("mine")
    with pytest.raises(OSError, match="in use"):
        Controlled(file, resources)
    assert file.read_text() == "mine"
