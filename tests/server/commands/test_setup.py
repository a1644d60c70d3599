"""Setup of new kits, played through the command: a person reads what it says, plugs servos in and types."""

import functools
import os
import re
import signal
from collections.abc import Callable

import pytest

from robot.commissioning.setup import ServoLine
from robot.hardware.feetech.registers import Register
from robot.hardware.interface import run_to_end
from server import cli
from server.commands import options as command_options
from server.commands.terminal import ExitCode, Terminal
from tests.helpers.emulator import SteppedEmulator
from tests.helpers.kit import KIT, Kit, set_registers
from tests.helpers.robots import SO101_SERVOS

JOINTS = [servo.joint for servo in SO101_SERVOS]

FINISHED = {Register.RETURN_DELAY: 0, Register.P_GAIN: 32}


# What is said, by the name of the reaction to it.
PATTERNS = {"plug": r"Plug in the servo of (\w+)", "confirm": r"\[y/N\]"}

# Far more than any visit says.
MOST_HEARD = 200


class Person(Terminal):
    """Terminal with somebody at it, who does something about what is said and types an answer to each question.

    Args:
        reactions: what is typed when a text with a pattern comes, or what to do then, which returns it.
    """

    def __init__(self, reactions: dict[str, Callable[[str], str] | str]) -> None:
        read_end, self._write_end = os.pipe()
        super().__init__(read_end)
        self.reactions = reactions
        self.heard: list[str] = []

    def err(self, text: str) -> None:
        super().err(text)
        self.heard.append(text)
        for pattern, react in self.reactions.items():
            found = re.search(pattern, text)
            if found and len(self.heard) < MOST_HEARD:
                os.write(self._write_end, (react if isinstance(react, str) else react(found[1])).encode())
                return
        if any(re.search(pattern, text) for pattern in PATTERNS.values()):
            self.hang_up()

    def hang_up(self) -> None:
        """End the input: a question that nobody answers must not wait for ever."""
        if self._write_end >= 0:
            os.close(self._write_end)
            self._write_end = -1

    def leave(self) -> None:
        self.hang_up()
        os.close(self._input)

    @property
    def said(self) -> str:
        return "\n".join(self.heard)


@pytest.fixture
def kit(start_emulator: Callable[..., SteppedEmulator]) -> Kit:
    return Kit(start_emulator(*KIT))


@pytest.fixture
def run_setup(kit, monkeypatch, tmp_path):
    """Runs ``armbridge setup`` with a person at the terminal; returns the exit code and the person."""
    wait = {"wait": kit.emulator.run}
    monkeypatch.setattr("server.commands.setup.ServoLine", functools.partial(ServoLine, **wait))
    monkeypatch.setattr("robot.hardware.feetech.bus.Bus.open", lambda _port, baudrate: kit.open(baudrate))
    monkeypatch.setattr("server.commands.arm.run_to_end", functools.partial(run_to_end, **wait))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))

    def run(*options: str, **reactions: Callable[[str], str] | str) -> tuple[int, Person]:
        person = Person({PATTERNS[name]: react for name, react in reactions.items()})
        monkeypatch.setattr(command_options, "Terminal", lambda: person)
        try:
            return cli.main(["setup", "--serial", "/dev/stepped", *options]), person
        finally:
            person.leave()

    return run


AGREE, REFUSE = "y\n", "n\n"


@pytest.fixture
def asked() -> list[str]:
    """The joints whose servos were asked for, in their order."""
    return []


@pytest.fixture
def plug(kit, asked):
    """Plugs in the servo that is asked for, and no other, and presses Enter."""

    def plug(joint: str, *places: int) -> str:
        asked.append(joint)
        kit.plug(*(places or [JOINTS.index(joint)]))
        return "\n"

    return plug


@pytest.fixture
def plug_once(plug, asked):
    """Does so for the first servo, and then presses Ctrl-C."""

    def plug_once(joint: str) -> str:
        if asked:
            raise KeyboardInterrupt
        return plug(joint)

    return plug_once


def ids(kit: Kit) -> list[int]:
    return [servo.value(Register.ID) for servo in kit.servos]


def test_a_kit_out_of_the_box_becomes_an_arm(run_setup, kit, plug, tmp_path):
    code, person = run_setup(plug=plug, confirm=AGREE)
    assert (code, ids(kit)) == (ExitCode.DONE, [1, 2, 3, 4, 5, 6])
    assert all(kit.held(place).items() >= FINISHED.items() for place in range(6))
    assert next(text for text in person.heard if "step" in text) == "\nstep 1 of 6: gripper, id 6"
    assert all(f"step {step} of 6" in person.said for step in range(1, 7))
    (backup,) = (tmp_path / "armbridge").glob("registers_*.json")
    assert str(backup) in person.heard[-1]


def test_nothing_is_written_without_a_yes_to_what_is_shown(run_setup, kit, plug, tmp_path):
    before = kit.held(5)
    code, person = run_setup("--joint", "gripper", plug=plug, confirm=REFUSE)
    assert (code, kit.held(5)) == (ExitCode.PROBLEMS, before)
    assert "left as they are: gripper" in person.said
    assert list(tmp_path.rglob("registers_*.json")) == []
    shown = person.heard[person.heard.index(next(text for text in person.heard if "[y/N]" in text)) - 1]
    assert re.search(r"gripper +1 +RETURN_DELAY +250 +0\n", shown)
    assert re.search(r"gripper +1 +ID +1 +6$", shown)


@pytest.mark.parametrize(
    ("first", "says"),
    [
        (lambda kit: kit.plug(4, 5), "several servos with the id 1 answer at once"),
        (lambda kit: kit.emulator.command(plugged=False), ""),
    ],
    ids=["two servos", "an adapter that is unplugged"],
)
def test_a_servo_is_asked_for_again_until_it_alone_is_on_the_wire(run_setup, kit, plug, asked, first, says):
    def plug_rightly_later(joint: str) -> str:
        kit.emulator.command(plugged=True)
        typed = plug(joint)
        if len(asked) == 1:
            first(kit)
        return typed

    code, person = run_setup("--joint", "gripper", "--yes", plug=plug_rightly_later)
    assert (code, asked) == (ExitCode.DONE, ["gripper", "gripper"])
    assert says in person.said
    assert ids(kit) == [1, 1, 1, 1, 1, 6]


def test_a_servo_left_plugged_in_does_not_become_the_next_one(run_setup, kit, plug, asked):
    def leave(joint: str) -> str:
        # The first time that the wrist is asked for, the gripper's is still there.
        return plug(joint, 5 if asked in ([], ["gripper"]) else 4)

    code, person = run_setup("--joint", "gripper", "--joint", "wrist_roll", "--yes", plug=leave)
    assert (code, asked) == (ExitCode.DONE, ["gripper", "wrist_roll", "wrist_roll"])
    assert "only servo 6 (gripper) answers" in person.said
    assert ids(kit) == [1, 1, 1, 1, 5, 6]


def arm_of(kit: Kit) -> None:
    """Make the kit an arm whose servos have their ids, and nothing else right."""
    for place, servo in enumerate(SO101_SERVOS):
        set_registers(kit.servos[place], {Register.ID: servo.servo_id})
    kit.plug(*range(6))


def test_two_servos_of_one_id_are_parted_by_the_name_of_a_joint(run_setup, kit, plug):
    arm_of(kit)
    set_registers(kit.servos[3], {Register.ID: 3})
    kit.plug(*range(6))
    code, person = run_setup("--joint", "wrist_flex", plug=plug, confirm=AGREE)
    assert "several servos with the id 3 answer at once" in person.said
    assert (code, ids(kit)) == (ExitCode.DONE, [1, 2, 3, 4, 5, 6])


def test_a_calibrated_servo_is_never_offered_to_another_joint_though_it_is_named_alone(run_setup, kit, plug_once):
    set_registers(kit.servos[3], {Register.ID: 3, Register.MIN_ANGLE_LIMIT: 763, Register.MAX_ANGLE_LIMIT: 3332})
    _, person = run_setup("--joint", "wrist_flex", plug=plug_once)
    assert "reset it with Feetech's FD program" in person.said
    assert "[y/N]" not in person.said


def test_ctrl_c_in_the_middle_is_said_and_the_next_run_goes_on(run_setup, kit, plug):
    def interrupt(joint: str) -> str:
        if joint == "wrist_flex":
            raise KeyboardInterrupt
        return plug(joint)

    code, person = run_setup("--yes", plug=interrupt)
    assert code == ExitCode.FAILED
    assert "run the command again to go on" in person.said
    assert ids(kit) == [1, 1, 1, 1, 5, 6]
    code, person = run_setup("--yes", plug=plug)
    assert code == ExitCode.DONE
    assert person.said.count("is in order: nothing to write") == 2
    assert ids(kit) == [1, 2, 3, 4, 5, 6]


def test_servos_that_are_done_and_connected_are_not_asked_for_again(run_setup, kit, plug, asked):
    for place, servo_id in ((4, 5), (5, 6)):
        set_registers(kit.servos[place], {Register.ID: servo_id, Register.RETURN_DELAY: 0})
    kit.plug(4, 5)
    chain = {"plug": lambda joint: plug(joint, *range(JOINTS.index(joint), 6))}
    assert run_setup("--yes", **chain)[0] == ExitCode.DONE
    assert asked == ["wrist_flex", "elbow_flex", "shoulder_lift", "shoulder_pan"]
    assert ids(kit) == [1, 2, 3, 4, 5, 6]


def test_a_new_servo_that_is_connected_at_the_start_is_not_taken_for_the_last_one(run_setup, kit, plug, asked):
    for servo in kit.servos:
        set_registers(servo, {Register.RETURN_DELAY: 0})
    kit.plug(5)
    assert run_setup("--yes", plug=plug)[0] == ExitCode.DONE
    assert asked == JOINTS[::-1]


def test_a_servo_unplugged_while_it_is_written_is_asked_for_again(run_setup, kit, plug, asked, monkeypatch):
    port = kit.emulator.port
    write_port, once = type(port).writePort, iter([True])

    def write_until_unlocked(packet):
        if kit.servos[5].value(Register.LOCK) == 0 and next(once, False):
            kit.plug()
        return write_port(port, packet)

    monkeypatch.setattr(port, "writePort", write_until_unlocked, raising=False)
    code, person = run_setup("--joint", "gripper", "--yes", plug=plug)
    assert (code, asked) == (ExitCode.DONE, ["gripper", "gripper"])
    assert "gave no valid reply" in person.said
    assert kit.servos[5].value(Register.LOCK) == 1
    assert ids(kit) == [1, 1, 1, 1, 1, 6]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize(("register", "value"), [(Register.ID, 6), (Register.BAUD_RATE, 0)])
def test_a_signal_while_a_servo_takes_a_new_id_or_baud_rate_leaves_it_locked(
    run_setup, kit, plug, monkeypatch, register, value, number
):
    set_registers(kit.servos[5], {Register.BAUD_RATE: 1})
    port, once = kit.emulator.port, iter([True])
    receive = type(port).receive

    def receive_until_taken(timeout_s):
        if kit.servos[5].value(register) == value and kit.servos[5].value(Register.LOCK) == 0 and next(once, False):
            signal.raise_signal(number)
        return receive(port, timeout_s)

    monkeypatch.setattr(port, "receive", receive_until_taken, raising=False)
    code, person = run_setup("--joint", "gripper", "--yes", plug=plug)
    assert (code, next(once, None)) == (ExitCode.FAILED, None)
    assert "run the command again to go on" in person.said
    assert kit.servos[5].value(Register.LOCK) == 1


def test_an_arm_that_holds_is_lowered_and_written_with_the_profile_that_was_asked_for(run_setup, kit):
    arm_of(kit)
    kit.servos[2].hold()
    code, person = run_setup("--registers", "--profile", "lerobot", "--yes")
    assert code == ExitCode.DONE
    assert person.heard.index("relaxing: support the arm ...") < person.heard.index("torque is off on all servos")
    assert kit.servos[2].value(Register.TORQUE_ENABLE) == 0
    assert [kit.held(place)[Register.P_GAIN] for place in range(6)] == [16] * 6
    assert [kit.held(place)[Register.OVERLOAD_TORQUE] for place in range(6)] == [80] * 5 + [25]


def test_of_an_arm_with_its_ids_only_the_settings_are_brought_into_order_and_what_is_amiss_is_named(run_setup, kit):
    arm_of(kit)
    kit.plug(0, 1, 2, 3, 4)
    kit.emulator.command(supply=12.0)
    code, person = run_setup("--registers", "--yes")
    assert code == ExitCode.PROBLEMS
    assert "no answer from servo 6 (gripper)" in person.said
    assert "12.0 V and is made for 4.0 to 8.0 V" in person.said
    assert [kit.held(place)[Register.RETURN_DELAY] for place in range(6)] == [0] * 5 + [250]
    assert "5 of 5: wrist_roll (id 5): written and read back RETURN_DELAY" in person.said
    kit.plug(*range(6))
    kit.emulator.command(supply=6.0)
    code, person = run_setup(confirm=AGREE)
    assert code == ExitCode.DONE
    assert "gripper (id 6): written and read back RETURN_DELAY" in person.said
    assert all(kit.held(place).items() >= FINISHED.items() for place in range(6))
    # There is nothing left to ask.
    for options in ((), ("--registers",)):
        assert run_setup(*options)[0] == ExitCode.DONE


def test_a_restored_servo_has_its_settings_back_and_keeps_its_id_unless_it_is_alone(run_setup, kit, plug, tmp_path):
    before = kit.held(5)
    file = str(tmp_path / "before.json")
    run_setup("--joint", "gripper", "--joint", "wrist_roll", "--yes", "--backup", file, plug=plug)
    kit.plug(4, 5)
    after, options = kit.held(5), ("--restore", file)
    code, person = run_setup(*options, confirm=REFUSE)
    assert (code, kit.held(5)) == (ExitCode.PROBLEMS, after)
    assert re.search(r"gripper +6 +RETURN_DELAY +0 +250\n", person.said)
    code, person = run_setup(*options, confirm=AGREE)
    assert (code, ids(kit)[4:]) == (ExitCode.DONE, [5, 6])
    assert {**kit.held(5), Register.ID: 1} == before
    assert "gripper) keeps its id" in person.said
    kit.plug(5)
    assert run_setup(*options, "--backup", str(tmp_path / "more.json"), confirm=AGREE)[0] == ExitCode.DONE
    assert kit.held(5) == before


@pytest.mark.parametrize(
    ("backup", "says"), [("mine.json", "never overwritten"), ("mine.json/backup", "cannot be written")]
)
def test_a_servo_whose_registers_cannot_be_saved_is_not_written(run_setup, kit, plug, tmp_path, backup, says):
    (tmp_path / "mine.json").write_text("mine")
    code, person = run_setup("--joint", "gripper", "--yes", "--backup", str(tmp_path / backup), plug=plug)
    assert (code, ids(kit)) == (ExitCode.FAILED, [1] * 6)
    assert says in person.said
    assert (tmp_path / "mine.json").read_text() == "mine"


def test_a_servo_of_an_unknown_model_is_left_alone(run_setup, kit, plug_once, monkeypatch):
    monkeypatch.setattr("robot.hardware.feetech.family.MODELS", {"sts3250": 2825})
    code, person = run_setup("--joint", "gripper", "--yes", plug=plug_once)
    assert (code, ids(kit)) == (ExitCode.FAILED, [1] * 6)
    assert "servo 1 (gripper) is model 777, not one of STS3250 (2825)" in person.said


def test_an_arm_that_cannot_be_set_up_is_left_alone(run_setup, kit):
    for options, code, words in (
        (("--registers", "--yes"), ExitCode.FAILED, "several servos with the id 1"),
        (("--robot", "koch_v1_1"), ExitCode.USAGE, "this command needs Feetech servos"),
        (("--joint", "elbow"), ExitCode.USAGE, "elbow_flex"),
    ):
        kit.plug(4, 5)
        before = [kit.held(place) for place in range(6)]
        done, person = run_setup(*options)
        assert (done, [kit.held(place) for place in range(6)]) == (code, before)
        assert words in person.said
