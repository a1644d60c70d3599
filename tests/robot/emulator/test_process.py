import contextlib
import json
import os
import random
import re
import select
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import pytest
import serial

from harness.waiting import TIMEOUT_S
from robot.calibration import MAX_TICK, Calibration, save
from robot.emulator import process
from robot.emulator.arm import InProcessPort
from robot.emulator.control import Controller, Emulation, LiveCommand, answer, check
from robot.emulator.feetech import FEETECH, FeetechServo, build_servos
from robot.emulator.process import REHEARSALS, Rehearsal, TimedCommand, UsbAdapter
from robot.emulator.servo_bus import EmulatedBus, Faults, Reply
from robot.errors import CalibrationError
from tests.helpers.emulator import options_parser
from tests.helpers.robots import nominal_calibration
from tests.helpers.servo_families import FEETECH as FEETECH_FAMILY


@pytest.fixture
def adapter(tmp_path):
    adapter = UsbAdapter(tmp_path / "arm")
    yield adapter
    adapter.unplug()


@pytest.fixture
def client(adapter):
    with serial.Serial(adapter.port, 1_000_000, timeout=0) as line:
        yield line


def test_every_byte_passes_unaltered_and_those_that_are_not_read_are_lost_without_a_wait(adapter):
    # Opened without any settings: the terminal itself must be raw.
    client = os.open(adapter.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    every_byte = bytes(range(256))
    adapter.take([reply(1.0, every_byte)])
    adapter.deliver(1.0)
    assert os.read(client, 512) == every_byte
    os.write(client, every_byte)
    assert (adapter.read(), adapter.read()) == (every_byte, b"")
    for at_s in range(2, 100):
        adapter.take([reply(at_s, bytes(4096))])
        adapter.deliver(at_s)
    os.close(client)


def test_the_baud_rate_is_that_of_the_client_and_a_file_in_the_place_of_the_link_is_left_alone(adapter, tmp_path):
    for set_to, seen in ((1_000_000, 1_000_000), (115_200, 115_200), (9600, 0)):
        with serial.Serial(adapter.port, set_to):
            assert adapter.baudrate == seen
    link = tmp_path / "link"
    link.write_text("mine")
    with pytest.raises(FileExistsError):
        UsbAdapter(link)
    assert link.read_text() == "mine"


def reply(due_s, data):
    return Reply(due_s - 1e-5 * len(data), 1e-5, due_s, due_s, data)


BURST = [reply(1.0004, b"one"), reply(1.0012, b"two")]


def test_a_burst_is_given_as_a_whole_when_its_last_byte_is_due_and_with_frames_at_the_end_of_theirs(adapter, client):
    adapter.take(BURST)
    adapter.take([reply(9.0, b"late")])
    for now_s, received in ((1.0011, b""), (1.0012, b"onetwo"), (9.0, b"late")):
        adapter.deliver(now_s)
        assert client.read(9) == received
    adapter.frame_s = 0.001
    adapter.take(BURST)
    for now_s, received in ((1.0009, b""), (1.0011, b"one"), (1.0019, b""), (1.0021, b"two")):
        adapter.deliver(now_s)
        assert client.read(9) == received


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


@pytest.mark.parametrize("renamed", [False, True])
def test_an_adapter_that_is_pulled_takes_port_link_and_queue_away(adapter, client, tmp_path, renamed):
    before = adapter.port
    adapter.take(BURST)
    adapter.unplug()
    assert not (tmp_path / "arm").is_symlink()
    with pytest.raises(serial.SerialException):
        client.read(1)
    assert (adapter.descriptors, adapter.read(), adapter.baudrate) == ([], b"", 0)
    adapter.take(BURST)
    adapter.deliver(9.0)
    adapter.unplug()
    adapter.plug_in(renamed=renamed)
    assert not renamed or adapter.port != before
    assert str((tmp_path / "arm").readlink()) == adapter.port
    with serial.Serial(str(tmp_path / "arm"), timeout=0) as line:
        adapter.deliver(9.0)
        assert line.read(9) == b""
    there, descriptors = adapter.port, adapter.descriptors
    adapter.plug_in(renamed=True)
    assert (adapter.port, adapter.descriptors) == (there, descriptors)


class SteppedHost:
    """Time that passes while an emulator waits, and a host that sends it a byte now and then."""

    def __init__(self, line: serial.Serial, sends_at_s: list[float]) -> None:
        self.now_s = 0.0
        self._line, self._sends_at_s = line, sends_at_s

    def monotonic(self) -> float:
        return self.now_s

    def select(self, watched: list[int], *_: object) -> tuple[list[int], list[int], list[int]]:
        self.now_s += TICK_S
        if not self._sends_at_s or self.now_s < self._sends_at_s[0]:
            return [], [], []
        self._sends_at_s.pop(0)
        self._line.write(b"x")
        return select.select(watched, [], [], TIMEOUT_S)


def test_an_emulator_whose_controller_has_ended_serves_on_until_the_bus_is_silent(adapter, client, monkeypatch):
    host, controller = SteppedHost(client, [0.5, 1.4]), Controller(-1, -1)
    controller.gone = True
    monkeypatch.setattr(process, "time", host)
    monkeypatch.setattr(process, "select", host)
    process.serve(bus_of(), adapter, controller, Rehearsal(), essential=True)
    assert host.now_s == pytest.approx(1.4 + process.LINGER_S, abs=2 * TICK_S)


@contextlib.contextmanager
def built(*arguments):
    options = options_parser().parse_args(arguments)
    with contextlib.ExitStack() as resources:
        bus = process.build_bus(options, resources, 0.0)
        process.configure(options, Emulation(bus, InProcessPort(bus, lambda: 0.0)))
        yield bus


def test_without_options_there_is_an_arm_without_faults_and_every_fault_that_strikes_by_chance_is_an_option():
    chance = random.Random()
    with built() as bus:
        assert [servo.servo_id for servo in bus.servos] == [1, 2, 3, 4, 5, 6]
        assert replace(bus.faults, random=chance) == Faults(random=chance)
        assert {servo.plant.gravity_permille != 0.0 for servo in bus.servos[1:4]} == {True}
    for field in fields(Faults):
        if field.type == "float":
            with built("--" + field.name.replace("_", "-"), "0.25") as bus:
                assert getattr(bus.faults, field.name) == 0.25, field.name


def test_servos_and_bus_are_as_asked_for(tmp_path):
    log = tmp_path / "log"
    with built("--supply", "4.8", "--heat-rate", "9", "--delay-s", "0.1", "--write-log", str(log)) as bus:
        for servo in bus.servos:
            assert (servo.voltage_v, servo.motor.rate) == (4.8, 9.0)
        assert bus.faults.delay_s == 0.1
        bus.record_command({})
    assert json.loads(log.read_text())["command"] == {}


def test_options_that_cannot_be_are_refused_in_a_sentence(capsys):
    for arguments, sentence, error in (
        (["--start=a"], "not a list of numbers", SystemExit),
        (["--drop", "2"], "drop: must be less than or equal to 1, not 2.0", SystemExit),
        (["--supply", "nan"], "supply: must be a finite number, not nan", SystemExit),
        (["--start=0,0,0"], "needs 6 positions, not 3", ValueError),
        (["--start=0,9,0,0,0,0"], "shoulder_lift cannot start at 9 rad", ValueError),
        (["--calibration", "/nowhere.json"], "/nowhere.json: cannot be read", CalibrationError),
        (["--write-log", "/nowhere/log"], "/nowhere/log", OSError),
    ):
        with pytest.raises(error) as refused:
            process.run(options_parser().parse_args(arguments))
        assert sentence in capsys.readouterr().err + str(refused.value)


TICK_S = 0.02
START_S = 100.0
ELBOW = 2

NOMINAL = nominal_calibration()
# The middle of a joint is not that of the encoder, and no two ranges are alike.
MEASURED = Calibration(
    tuple(
        joint
        if joint.servo.turns_freely
        else replace(joint, homing_offset=150 * k - 300, range_min=joint.range_min + 60, range_max=joint.range_max - 20)
        for k, joint in enumerate(NOMINAL.joints)
    )
)
ARMS = pytest.mark.parametrize("calibration", [NOMINAL, MEASURED])

HOLD = TimedCommand(0.0, {"hand": {"3": 2000}})
LET_GO = TimedCommand(2.0, {"hand": {"3": None}})


def bus_of(calibration: Calibration = NOMINAL) -> EmulatedBus[FeetechServo]:
    return EmulatedBus(build_servos(calibration, [0.0] * len(calibration.joints)), FEETECH, Faults(), 0.0)


def played(
    commands: Sequence[TimedCommand], calibration: Calibration, elbow_ticks: int | None = None
) -> Iterator[tuple[float, tuple[FeetechServo, ...]]]:
    """Play commands to servos, whose elbow may hold a goal, on a clock of their own; yield its time and the servos."""
    bus = bus_of(calibration)
    emulation = Emulation(bus, InProcessPort(bus, lambda: 0.0))
    rehearsal = Rehearsal(commands)
    if elbow_ticks is not None:
        for register, value in (("GOAL_POSITION", elbow_ticks), ("TORQUE_LIMIT", 800), ("TORQUE_ENABLE", 1)):
            FEETECH_FAMILY.write(bus.servos[ELBOW], register, value)
    rehearsal.start(0.0)
    for tick in range(round((commands[-1].at_s + 2.0) / TICK_S)):
        now_s = tick * TICK_S
        bus.advance(now_s)
        for due in rehearsal.commands_due(now_s):
            assert json.loads(answer(json.dumps(due.command).encode(), emulation)) == {"ok": True}
        yield now_s, bus.servos


def test_every_command_is_due_once_at_its_time_from_the_first_start() -> None:
    rehearsal = Rehearsal([HOLD, LET_GO])
    assert rehearsal.commands_due(START_S) == []
    rehearsal.start(START_S)
    rehearsal.start(START_S + 1.0)
    assert rehearsal.commands_due(START_S) == [HOLD]
    assert rehearsal.commands_due(START_S + 1.99) == []
    assert rehearsal.commands_due(START_S + 2.0) == [LET_GO]
    assert rehearsal.commands_due(START_S + 1000.0) == []


def test_a_script_is_read_line_by_line_and_refused_without_any(tmp_path: Path) -> None:
    file = tmp_path / "script.jsonl"
    file.write_text('{"at_s": 0, "hand": {"3": 2000}}\n\n{"at_s": 2, "hand": {"3": null}, "drop": 0.5}\n{"at_s": 2.5}')
    let_go, nothing = TimedCommand(2.0, {"hand": {"3": None}, "drop": 0.5}), TimedCommand(2.5, {})
    assert process.read_script(file, bus_of()) == (HOLD, let_go, nothing)
    file.write_text("\n")
    with pytest.raises(ValueError, match=re.escape(f"{file}: the script has no commands")):
        process.read_script(file, bus_of())


def test_a_line_that_cannot_be_is_refused_with_file_and_number(tmp_path: Path) -> None:
    for line, error_text in (
        ('{"at_s": 1, "hand": {"3": 1900}}', "at_s: must be more than the 1 of the line before, not 1"),
        ('{"at_s": 2, "hand": {"3": 5000}}', "hand.3: must be less than or equal to 4095, not 5000"),
        ('{"at_s": 2, "explode": 1}', "unknown command 'explode'"),
        ('{"at_s": -1}', "at_s: must be greater than or equal to 0, not -1"),
        ('{"at_s": 90000}', "at_s: must be less than or equal to 86400, not 90000"),
        ('{"at_s": NaN}', "at_s: must be a finite number, not nan"),
        ('{"at_s": "2"}', "at_s: must be a valid number, not '2'"),
        ('{"drop": 0.5}', "at_s: is missing"),
        ("[2]", "a command is a JSON object, not [2]"),
        ('{"at_s" 2}', "no JSON at column 9: Expecting ':' delimiter"),
    ):
        file = tmp_path / "script.jsonl"
        file.write_text(f'{{"at_s": 1}}\n\n{line}\n')
        with pytest.raises(ValueError, match="^" + re.escape(f"{file}, line 3: {error_text}")):
            process.read_script(file, bus_of())


@ARMS
@pytest.mark.parametrize("name", REHEARSALS)
def test_the_commands_of_a_rehearsal_make_sense_and_have_increasing_times(name: str, calibration: Calibration) -> None:
    commands = REHEARSALS[name](calibration)
    for timed in commands:
        check(LiveCommand, timed.command, bus_of(calibration).servos)
    assert all(before.at_s < after.at_s for before, after in pairwise(commands))


@ARMS
def test_a_sweep_holds_the_middle_and_then_brings_every_joint_to_both_stops_and_back(calibration: Calibration) -> None:
    middle = [(joint.range_min + joint.range_max) // 2 for joint in calibration.joints]
    (free,) = [k for k, joint in enumerate(calibration.joints) if joint.servo.turns_freely]
    lowest, highest = [MAX_TICK] * 6, [0] * 6
    *_, let_go = commands = process.sweep(calibration)
    for now_s, servos in played(commands, calibration):
        present = [servo.present_ticks for servo in servos]
        if 1.0 <= now_s < process.LEAD_S or let_go.at_s - 0.1 < now_s < let_go.at_s:
            assert present == middle
        # calibrate takes the middle of a joint that turns freely from wherever the arm is when Enter is pressed.
        assert abs(present[free] - MAX_TICK / 2) <= 1.0
        lowest, highest = list(map(min, lowest, present)), list(map(max, highest, present))
    for joint, low, high in zip(calibration.joints, lowest, highest, strict=True):
        if not joint.servo.turns_freely:
            assert (low, high) == (joint.range_min, joint.range_max)
    assert all(servo.plant.hand_ticks is None for servo in servos)


def test_a_joint_that_holds_gives_way_to_a_push_and_comes_back_and_stalls_at_an_obstacle_until_it_is_gone() -> None:
    start, end = (timed.at_s for timed in process.push(NOMINAL))
    away = {}
    for now_s, servos in played(process.push(NOMINAL), NOMINAL, 2047):
        away[round(now_s, 2)] = abs(servos[ELBOW].present_ticks - 2047)
    assert away[start - 1.0] <= 5
    assert 20 <= away[end - 1.0] <= 50
    assert away[end + 1.0] <= 5
    start, end = (timed.at_s for timed in process.stall(NOMINAL))
    ticks = {}
    for now_s, servos in played(process.stall(NOMINAL), NOMINAL, 2047):
        if abs(now_s - start - 1.0) < TICK_S / 2:
            FEETECH_FAMILY.write(servos[ELBOW], "GOAL_POSITION", 2373)
        ticks[round(now_s, 2)] = servos[ELBOW].present_ticks
    (obstacle,) = process.stall(NOMINAL)[0].command["obstacle"].values()
    assert ticks[start + 2.5] == obstacle < 2373 - 60
    assert ticks[end + 1.0] == pytest.approx(2373, abs=5)


def rehearsed(*arguments: str) -> Rehearsal:
    """The rehearsal that a command line asks for."""
    return process.build_rehearsal(options_parser().parse_args(arguments), bus_of())


def test_a_rehearsal_is_that_of_the_emulated_arm(tmp_path: Path) -> None:
    save(MEASURED, tmp_path / "arm.json")
    for name in REHEARSALS:
        assert rehearsed("--rehearse", name).commands == REHEARSALS[name](NOMINAL)
        measured = rehearsed("--rehearse", name, "--calibration", str(tmp_path / "arm.json"))
        assert measured.commands == REHEARSALS[name](MEASURED)
    assert rehearsed().commands == ()
