"""Symptoms of real arms, from what happens to the sentence that names it, as docs/troubleshooting.md quotes it.

The page is read by these tests: a sentence that the program does not say fails here. ``TRAPS.md`` lists all of them.
"""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo
from websockets.sync.client import ClientConnection, connect

from harness.clients import call_on
from harness.emulator import RunningEmulator
from harness.server import ROOT, RunningServer, ServerOnBus, server_on_bus
from harness.waiting import TIMEOUT_S, wait_until
from robot.calibration import save
from robot.commissioning.scan import explain_missing, scan
from robot.errors import PortError, PortLost
from robot.hardware import boards
from robot.hardware.boards import resolve_port
from robot.hardware.config import SerialConfig
from robot.hardware.feetech.family import PHASE_MULTI_TURN
from robot.hardware.feetech.registers import GOAL_ADDRESS, Register
from robot.hardware.interface import StatusFlag
from robot.hardware.port import _refusal
from robot.messages import Order
from server.arm.interface import LEVEL_ERROR, LEVEL_OK
from server.commands.terminal import ExitCode
from tests.helpers.arm_rig import CALIBRATION, ArmRig
from tests.helpers.emulator import SteppedEmulator, goal_block
from tests.helpers.motions import smooth_move
from tests.helpers.robots import SO101_SERVOS
from tests.server.commands.conftest import Run, armbridge, emulator  # noqa: F401 - fixtures

PAGE = ROOT / "docs" / "troubleshooting.md"
TABLE = ROOT / "tests" / "TRAPS.md"

LIFT, ELBOW, ROLL, GRIPPER = 2, 3, 5, 6


def sections() -> dict[str, str]:
    """The symptoms of the page: heading and text of each."""
    part = PAGE.read_text().split("\n## By symptom\n")[1].split("\n## ")[0]
    return dict(re.findall(r"^### (.+)\n((?:(?!### ).*\n?)*)", part, re.MULTILINE))


SYMPTOMS = sections()


def sentences(symptom: str) -> list[str]:
    """What the program says of a symptom, with an ellipsis for every value."""
    said = SYMPTOMS[symptom].split("* **It says**")[1].split("\n* ")[0]
    return re.findall(r"`([^`]+)`", said)


def assert_said(symptom: str, text: str) -> None:
    """Assert that a text contains what the page quotes for a symptom."""
    quoted = sentences(symptom)
    assert quoted
    for sentence in quoted:
        pattern = ".+?".join(re.escape(part) for part in sentence.split("…"))
        assert re.search(pattern, text, re.DOTALL), f"{symptom}: {sentence!r} is not in {text!r}"


def test_every_symptom_says_what_is_seen_why_and_what_to_do() -> None:
    assert len(SYMPTOMS) > 20
    for symptom, text in SYMPTOMS.items():
        assert re.findall(r"^\* \*\*(.+?)\*\*", text, re.MULTILINE) == ["It says", "Why", "Do"], symptom


def test_every_symptom_is_in_the_table_of_traps_with_a_test() -> None:
    rows = re.findall(r"^\| \[(.+?)\]\(\S+?\) \|.*\| `([\w/.]+\.py)::(\w+)`", TABLE.read_text(), re.MULTILINE)
    assert {symptom for symptom, _, _ in rows} == set(SYMPTOMS)


# The board and its port.


def device(path: str, vid: int, pid: int) -> ListPortInfo:
    info = ListPortInfo(path)
    info.vid, info.pid, info.product = vid, pid, "Serial"
    return info


@pytest.mark.parametrize(
    ("symptom", "devices"),
    [
        ("The board is not found", []),
        ("The board is not found", [device("/dev/ttyACM0", 0x2341, 0x0043)]),
        ("Two boards are plugged in", [device("/dev/ttyACM0", 0x1A86, 0x55D3), device("/dev/ttyUSB0", 0x1A86, 0x7523)]),
    ],
)
def test_no_board_or_two_are_told_with_what_is_plugged_in(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, symptom: str, devices: list[ListPortInfo]
) -> None:
    monkeypatch.setattr(list_ports, "comports", lambda: devices)
    for name in ("NAMES_BY_DEVICE", "NAMES_BY_SOCKET", "KERNEL_RELEASE", "BOARD_MODEL"):
        monkeypatch.setattr(boards, name, tmp_path / name)
    with pytest.raises(PortError) as refused:
        resolve_port("auto")
    assert_said(symptom, str(refused.value))


@pytest.mark.parametrize(
    ("symptom", "number", "words"),
    [("The port may not be opened", 13, "Permission denied"), ("The port is in use", 16, "Device or resource busy")],
)
def test_a_port_that_cannot_be_opened_says_why(symptom: str, number: int, words: str) -> None:
    assert_said(symptom, str(_refusal("/dev/ttyACM0", number, words)))


# An arm process on emulated servos, which it takes for real ones.


@pytest.fixture
def servos() -> SteppedEmulator:
    return SteppedEmulator(wire_time=False)


# The offsets of this calibration are known: those of a flawless arm.
CALIBRATED = SerialConfig(replace(CALIBRATION, offsets_known=True), "/dev/arm")


def refused_at_start(servos: SteppedEmulator) -> str:
    """What an arm says that cannot be taken over as it is found."""
    rig = ArmRig(servos, hardware=CALIBRATED)
    rig.until(lambda: rig.supervisor.fault is not None or any(getattr(each, "reason", "") for each in rig.sent))
    return f"{rig.supervisor.fault or ''} {rig.state.reason}"


def fault_of(rig: ArmRig) -> str:
    rig.until(lambda: rig.supervisor.fault is not None, timeout_s=60.0)
    return str(rig.supervisor.fault)


def warnings(servos: SteppedEmulator) -> str:
    """What an arm that can be driven warns of."""
    rig = ArmRig(servos).started()
    rig.run(1.2)
    return "\n".join(warning.sentence for joint in rig.health.joints for warning in joint.warnings)


def store(servos: SteppedEmulator, register: Register, value: int, *ids: int) -> None:
    """Leave a setting in servos, as another program does."""
    writer = servos.open_bus()
    for each in ids:
        # Not acknowledged: a servo replies by its new id, and at its new rate.
        for written, content in ((Register.LOCK, 0), (register, value)):
            writer.sync_write(written, {each: written.encode(content)})
    for each in range(1, 7):
        writer.sync_write(Register.LOCK, {each: Register.LOCK.encode(1)})


def ticks(joint: str, position_rad: float) -> int:
    return next(each for each in CALIBRATION.joints if each.joint == joint).ticks_from_rad(position_rad)


# Ends of the elbow's range, of which one leaves the arm outside.
BEFORE_REST, NARROW = ticks("elbow_flex", -0.5), ticks("elbow_flex", 1.0)


def test_an_unplugged_board_is_a_lost_port(servos: SteppedEmulator) -> None:
    rig = ArmRig(servos).started()
    servos.command(plugged=False)
    with pytest.raises(PortLost) as lost:
        rig.run(1.0)
    assert_said("The port vanishes while the arm runs", str(lost.value))


def test_a_servo_of_another_model_is_named_with_what_to_write_into_robot_toml(servos: SteppedEmulator) -> None:
    servos.servo_bus.servos[LIFT - 1].set(Register.MODEL_NUMBER, 2307)
    assert_said("A servo is of another model", refused_at_start(servos))


@pytest.mark.parametrize(
    ("symptom", "register", "value", "servo", "told"),
    [
        ("A servo is in another operating mode", Register.OPERATING_MODE, 1, ELBOW, refused_at_start),
        ("A joint stands outside its range", Register.MAX_ANGLE_LIMIT, BEFORE_REST, ELBOW, refused_at_start),
        ("The arm is two degrees low", Register.P_GAIN, 8, LIFT, warnings),
        ("The joints are weak, slow or uneven", Register.MAX_TORQUE, 300, LIFT, warnings),
        ("The servos hold another calibration's limits", Register.MAX_ANGLE_LIMIT, NARROW, ELBOW, warnings),
        ("A joint's position leaps by a turn", Register.PHASE, 12 | PHASE_MULTI_TURN, ROLL, warnings),
    ],
)
def test_a_setting_that_another_program_has_left_is_refused_or_a_warning(
    servos: SteppedEmulator,
    symptom: str,
    register: Register,
    value: int,
    servo: int,
    told: Callable[[SteppedEmulator], str],
) -> None:
    store(servos, register, value, servo)
    assert_said(symptom, told(servos))


@pytest.mark.parametrize(
    ("symptom", "servo", "joint", "stop_rad", "goal_rad"),
    [
        ("A joint turns the wrong way, or gears crack at the first motion", ELBOW, "elbow_flex", 0.3, 1.0),
        ("wrist_roll stops before its limit", ROLL, "wrist_roll", 2.2, 2.6),
    ],
)
def test_a_joint_that_meets_a_stop_pushes_in_vain(
    servos: SteppedEmulator, symptom: str, servo: int, joint: str, stop_rad: float, goal_rad: float
) -> None:
    rig = ArmRig(servos).started()
    servos.command(obstacle={str(servo): ticks(joint, stop_rad)})
    rig.execute(smooth_move({joint: (0.0, goal_rad)}, 2.0))
    assert_said(symptom, fault_of(rig))


def test_a_hot_gripper_is_a_warning_first_and_then_a_fault(servos: SteppedEmulator) -> None:
    rig = ArmRig(servos).started()
    servos.command(temperature={str(GRIPPER): 57})
    rig.run(1.2)
    assert any("warm: 57 degC" in warning.sentence for joint in rig.health.joints for warning in joint.warnings)
    servos.command(temperature={str(GRIPPER): 66})
    assert_said("The gripper is hot", fault_of(rig))


def test_an_arm_that_lerobot_has_driven_is_unlocked_and_otherwise_well() -> None:
    told = warnings(SteppedEmulator("--population", "lerobot", wire_time=False))
    assert_said("The EPROM is unlocked", told)
    assert set(told.splitlines()) == set(sentences("The EPROM is unlocked"))


@pytest.mark.parametrize("population", ["clone", "lerobot"])
def test_an_overload_left_by_another_program_is_cleared_by_the_reset_or_asks_for_a_power_cut(population: str) -> None:
    servos = SteppedEmulator("--population", population, wire_time=False)
    # That program closes the gripper on something hard until its servo protects itself.
    writer = servos.open_bus()
    servos.command(obstacle={str(GRIPPER): ticks("gripper", 0.5)})
    writer.write(GRIPPER, Register.TORQUE_ENABLE, 1)
    writer.sync_write(GOAL_ADDRESS, {GRIPPER: goal_block(ticks("gripper", 1.2), 1000)})
    servos.run(4.0)
    assert writer.read(GRIPPER, Register.STATUS) == StatusFlag.OVERLOAD
    servos.command(obstacle={str(GRIPPER): None})
    rig = ArmRig(servos)
    assert_said("The gripper stops after two seconds", fault_of(rig))
    rig.run(3.0)
    if population == "clone":
        assert_said("A servo answers every instruction with an error", rig.order(Order.RESET_FAULT).message)
        servos.command(power_cycle=[GRIPPER])
        rig.run(1.0)
    assert rig.order(Order.RESET_FAULT).done


# Commands on the emulated servos.


def test_commands_name_a_silent_bus_a_loose_cable_and_what_keeps_an_arm_stiff(
    emulator: SteppedEmulator,  # noqa: F811 - the fixture
    armbridge: Run,  # noqa: F811 - the fixture
) -> None:
    store(emulator, Register.TORQUE_ENABLE, 1, *range(1, 7))
    relaxed = armbridge("relax")
    assert relaxed.returncode == ExitCode.DONE
    assert_said("The arm drops when the server ends, or stays stiff", relaxed.stderr)
    emulator.command(offline=[4, 5, 6])
    assert_said("Servos from one joint on are silent", armbridge("scan").stderr)
    emulator.command(online=[4, 5, 6])
    store(emulator, Register.BAUD_RATE, 1, *range(1, 7))
    answer = armbridge("scan")
    assert answer.returncode == ExitCode.PROBLEMS
    assert_said("After a power cycle nothing answers", answer.stderr)
    assert "servo 3 listens at 500000 baud" in armbridge("scan", "--all-bauds").stderr


def test_new_servos_of_one_id_collide_and_one_alone_is_told_to_be_new() -> None:
    kit = SteppedEmulator("--population", "kit")

    def told() -> str:
        return "\n".join(explain_missing(scan(kit.open_bus(), range(1, 7)), SO101_SERVOS))

    assert_said("Replies are garbled", told())
    assert "power supply" not in told()
    kit.command(unplug=[1, 2, 3, 4, 5])
    assert_said("All servos answer as id 1", told())


# A server on emulated servos behind a serial port, as people start it.


def test_a_server_whose_servos_another_program_has_shifted_refuses_to_enable_them(
    start_terminal: Callable[..., RunningEmulator], tmp_path: Path
) -> None:
    joints = [replace(each, homing_offset=23) if each.joint == "elbow_flex" else each for each in CALIBRATION.joints]
    file = tmp_path / "my_arm.json"
    save(replace(CALIBRATION, joints=tuple(joints)), file)
    port = start_terminal().port
    with RunningServer(f"--port 0 --serial {port} --calibration {file}") as server, connect(server.url) as client:
        assert_said("The zero has shifted", enabling(client))
        # Refused for the same reason after a reset, which asks the servos anew.
        call_on(client, "/arm/reset_fault")
        assert_said("The zero has shifted", enabling(client))


def enabling(client: ClientConnection) -> str:
    """Return why torque is refused, once the servos have been checked."""
    answer: dict[str, Any] = {}

    def are_checked() -> bool:
        answer.update(call_on(client, "/arm/enable"))
        return "still being checked" not in answer["message"]

    wait_until(are_checked)
    assert not answer["success"]
    return str(answer["message"])


# A server and its simulated arm: what a client reads of a fault, and how it gets out of it.


@pytest.fixture(scope="module")
def simulation() -> Iterator[ServerOnBus]:
    with server_on_bus() as running:
        yield running


@pytest.mark.parametrize(
    ("symptom", "commands", "remedy"),
    [
        ("The gripper is hot", {"temperature": {"6": 66}}, {"temperature": {"6": 40}}),
        ("A 7.4 V servo has 12 V", {"supply": 12.0}, {"supply": 5.0}),
        ("The supply is too weak", {"supply": 4.2}, {"supply": 5.0}),
        ("One servo falls silent", {"offline": [ELBOW]}, {"online": [ELBOW]}),
        ("A servo restarts while the arm moves", {"power_cycle": [ELBOW]}, {"push": {"3": 0}}),
        ("The gripper stops after two seconds", {"status": {"6": int(StatusFlag.OVERLOAD)}}, {"status": {"6": 0}}),
    ],
)
def test_a_client_reads_the_sentence_and_after_the_remedy_resets_the_fault(
    simulation: ServerOnBus, symptom: str, commands: dict[str, object], remedy: dict[str, object]
) -> None:
    url = simulation.server.url
    with connect(url) as watching, connect(url) as calling:
        watching.send(json.dumps({"op": "subscribe", "topic": "/arm/state"}))
        await_state(watching, LEVEL_OK)
        simulation.emulator.command(**commands)
        assert_said(symptom, await_state(watching, LEVEL_ERROR))
        simulation.emulator.command(**remedy)
        wait_until(
            lambda: call_on(calling, "/arm/reset_fault")["success"] and call_on(calling, "/arm/enable")["success"]
        )


def await_state(client: ClientConnection, level: int) -> str:
    """Return what the arm says in the first state of a level."""
    while True:
        operation = json.loads(client.recv(timeout=TIMEOUT_S))
        if operation["op"] == "publish" and operation["msg"]["level"] == level:
            return str(operation["msg"]["message"])
