import contextlib
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from harness.server import read_write_log
from robot.commissioning import setup
from robot.errors import BackupError, PortLost, StartupError
from robot.hardware.feetech.family import check_model
from robot.hardware.feetech.profiles import FACTORY, LEROBOT
from robot.hardware.feetech.registers import Register
from tests.helpers.kit import KIT, Kit, set_registers
from tests.helpers.robots import SO101_SERVOS

PAN, LIFT, ELBOW, FLEX, ROLL, GRIPPER = SO101_SERVOS


@pytest.fixture
def kit(start_emulator):
    return Kit(start_emulator(*KIT))


def find(kit, joint):
    return setup.search(kit.line(), joint, SO101_SERVOS, lambda _text: None)


def set_up(kit, joint, profile=LEROBOT):
    """What the command does with the servo that is plugged in."""
    line = kit.line()
    servo = setup.search(line, joint, SO101_SERVOS, lambda _text: None)
    changes = setup.changes_for(servo, joint, profile)
    return setup.write(line, servo, changes) if setup.needs_writing(servo, changes) else servo


def finished(kit, place, joint):
    """Whether a servo keeps without power all that its joint needs."""
    kit.servos[place].power_up()
    kit.plug(place)
    servo = find(kit, joint)
    return servo.servo_id == joint.servo_id and not setup.needs_writing(servo, setup.changes_for(servo, joint, LEROBOT))


def test_a_servo_is_relaxed_first_only_what_differs_is_written_and_the_eprom_is_locked(start_emulator, write_log):
    kit = Kit(start_emulator(*KIT, "--write-log", str(write_log)))
    kit.plug(4)
    kit.servos[4].hold()
    before = len(read_write_log(write_log))
    set_up(kit, ROLL, FACTORY)
    written = [entry["address"] for entry in read_write_log(write_log)[before:] if entry["data"]]
    assert written[0] == Register.TORQUE_ENABLE
    assert set(written) == {Register.TORQUE_ENABLE, Register.LOCK, Register.RETURN_DELAY, Register.ID}
    assert (kit.servos[4].value(Register.TORQUE_ENABLE), kit.servos[4].value(Register.LOCK)) == (0, 1)


@pytest.mark.parametrize(("code", "servo_id"), [(0, 1), (0, 77), (1, 1), (4, 253), (7, 6)])
def test_a_servo_is_found_at_any_rate_and_id_and_counts_one_turn_and_holds_positions(kit, code, servo_id):
    strange = {Register.PHASE: 12 | 0x10, Register.OPERATING_MODE: 3, Register.RESPONSE_LEVEL: 0}
    set_registers(kit.servos[5], {**strange, Register.ID: servo_id, Register.BAUD_RATE: code})
    kit.plug(5)
    set_up(kit, GRIPPER)
    held = kit.held(5)
    assert (held[Register.PHASE], held[Register.OPERATING_MODE], held[Register.RESPONSE_LEVEL]) == (12, 0, 1)
    assert finished(kit, 5, GRIPPER)
    assert kit.servos[5].value(Register.BAUD_RATE) == 0


@pytest.mark.parametrize(
    ("fourth", "fifth", "words"),
    [
        ({}, {}, r"several servos with the id 1 .*unplug all of them but one"),
        ({Register.RETURN_DELAY: 0}, {}, "several servos with the id 1"),
        ({Register.ID: 77}, {Register.ID: 77}, "unplug all"),
        ({}, {Register.ID: 77}, "servos 1, 77 answer"),
    ],
)
def test_of_two_servos_none_is_taken_and_how_to_part_them_is_told(kit, fourth, fifth, words):
    set_registers(kit.servos[4], fourth)
    set_registers(kit.servos[5], fifth)
    kit.plug(4, 5)
    with pytest.raises(StartupError, match=words):
        find(kit, GRIPPER)


def test_silence_and_replies_that_nobody_can_read_are_explained_and_a_disturbed_servo_is_not_taken_for_two(kit):
    with pytest.raises(StartupError, match="supply"):
        find(kit, GRIPPER)
    set_registers(kit.servos[5], {Register.ID: 77})
    kit.plug(5)
    kit.emulator.command(corrupt=1.0)
    with pytest.raises(StartupError, match=r"garbled: several servos with the same id.*unplug all servos but one"):
        find(kit, GRIPPER)
    kit.emulator.command(corrupt=0.1)
    assert [find(kit, GRIPPER).servo_id for _ in range(10)] == [77] * 10


def test_a_calibrated_joint_is_never_offered_for_another_and_missing_limits_and_an_open_lock_are_mended(kit):
    set_registers(kit.servos[0], {Register.MIN_ANGLE_LIMIT: 0, Register.MAX_ANGLE_LIMIT: 0})
    kit.plug(0)
    assert set_up(kit, PAN).angle_limits_ticks == (0, 4095)
    set_registers(kit.servos[0], {Register.LOCK: 0})
    set_up(kit, PAN)
    assert kit.servos[0].value(Register.LOCK) == 1
    calibration = {Register.MIN_ANGLE_LIMIT: 900, Register.MAX_ANGLE_LIMIT: 3100, Register.HOMING_OFFSET: -40}
    set_registers(kit.servos[0], calibration)
    assert {register: set_up(kit, PAN).registers[register] for register in calibration} == calibration
    with pytest.raises(StartupError, match=r"only servo 1 \(shoulder_pan\) answers, .* has .* a calibration already"):
        set_up(kit, ELBOW)
    assert {register: kit.servos[0].value(register) for register in calibration} == calibration


def test_an_unknown_model_is_refused_with_the_way_round_and_a_supply_that_the_servo_is_not_made_for_is_said(kit):
    kit.plug(5)
    check_model(5, GRIPPER, 777)
    with pytest.raises(StartupError, match=r'model 1234.* write model = "1234" for it'):
        check_model(5, GRIPPER, 1234)
    check_model(5, replace(GRIPPER, model="1234"), 1234)
    for supply_v, words in ((5.0, ""), (12.1, "burn out"), (3.5, "too weak")):
        kit.emulator.command(supply=supply_v)
        complaint = setup.supply_complaint(find(kit, GRIPPER))
        assert words in complaint
        assert bool(words) == bool(complaint)


class Broken(BaseException):
    """Ctrl-C, or anything else that ends the command."""


def break_off(kit, packets, error):
    """Have the line fail for good with this error after so many packets."""
    port = kit.emulator.port
    sent = iter(range(packets))
    write_port = type(port).writePort

    def write_some(packet):
        if next(sent, None) is None:
            raise error
        return write_port(port, packet)

    port.writePort = write_some


@pytest.mark.parametrize(("error", "powered_down"), [(Broken(), False), (PortLost("/dev/stepped", "unplugged"), True)])
def test_a_setup_broken_off_after_any_packet_is_finished_by_the_next(kit, error, powered_down):
    servo = kit.servos[5]
    fresh = {**kit.held(5), Register.BAUD_RATE: 1}
    kit.plug(5)
    broken, packets = True, 1
    while broken:
        set_registers(servo, {register: fresh[register] for register in fresh if register >= Register.ID})
        broken = False
        break_off(kit, packets, error)
        try:
            set_up(kit, GRIPPER)
        except (Broken, PortLost):
            broken = True
        del kit.emulator.port.writePort
        if powered_down:
            servo.power_up()
        set_up(kit, GRIPPER)
        assert finished(kit, 5, GRIPPER)
        packets += 1
    assert packets > 40


def test_a_servo_that_forgets_a_value_when_its_eprom_is_locked_is_not_taken_for_done(kit, monkeypatch):
    kit.plug(5)
    servo = kit.servos[5]
    take = servo.write

    def forget(address, data):
        take(address, data)
        if address == Register.LOCK and data == b"\1":
            take(Register.P_GAIN, bytes([32]))
        return 0

    monkeypatch.setattr(servo, "write", forget)
    with pytest.raises(StartupError, match="does not keep what was written to it: it has P_GAIN 32"):
        set_up(kit, GRIPPER)


def test_an_interrupted_write_leaves_the_eprom_locked(kit):
    kit.plug(5)
    line = kit.line()
    servo = setup.search(line, GRIPPER, SO101_SERVOS, lambda _text: None)
    read = type(kit.emulator.port).receive
    unlocked = iter([False])

    def interrupt(timeout_s):
        if kit.servos[5].value(Register.LOCK) == 0:
            for _ in unlocked:
                raise Broken
        return read(kit.emulator.port, timeout_s)

    kit.emulator.port.receive = interrupt
    with contextlib.suppress(Broken):
        setup.write(line, servo, setup.changes_for(servo, GRIPPER, LEROBOT))
    assert next(unlocked, "used") == "used"
    assert kit.servos[5].value(Register.LOCK) == 1


def test_a_servo_gets_back_all_that_it_had_but_its_id_among_others_and_a_rate_that_makes_it_unreachable(kit):
    set_registers(kit.servos[5], {Register.BAUD_RATE: 1, Register.HOMING_OFFSET: 77})
    before = kit.held(5)
    kit.plug(5)
    found = find(kit, GRIPPER)
    ids = {"servo_id": found.servo_id, "new_id": GRIPPER.servo_id}
    entry = setup.SavedServo(joint="gripper", **ids, baudrate=found.baudrate, registers=dict(found.registers))
    after = set_up(kit, GRIPPER)
    changed = [change.register for change in setup.changes_back(after, entry, alone=False)]
    assert Register.RETURN_DELAY in changed
    assert Register.ID not in changed
    odd = entry.model_copy(update={"registers": {**entry.registers, Register.BAUD_RATE: 5}})
    assert Register.BAUD_RATE not in [change.register for change in setup.changes_back(after, odd, alone=True)]
    setup.write(kit.line(), after, setup.changes_back(after, entry, alone=True))
    assert kit.held(5) == before


NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def servo(servo_id=1, new_id=6, **values):
    registers = {Register.ID: servo_id, **{Register[name]: value for name, value in values.items()}}
    return setup.SavedServo(joint="gripper", servo_id=servo_id, new_id=new_id, baudrate=1_000_000, registers=registers)


def test_what_is_saved_reads_back_and_grows_servo_by_servo_and_is_never_overwritten(tmp_path):
    backup = setup.BackupFile(tmp_path / "new" / "kit.json", "so101")
    assert backup.empty
    first, second = servo(HOMING_OFFSET=-40), servo(new_id=5)
    backup.save(first, NOW)
    assert setup.read_backup(backup.path) == (first,)
    backup.save(second, NOW)
    assert setup.read_backup(backup.path) == (first, second)
    file = tmp_path / "kit.json"
    early = setup.BackupFile(file, "so101")
    with pytest.raises(BackupError, match="cannot be read"):
        setup.read_backup(file)
    file.write_text("mine")
    with pytest.raises(BackupError, match="never overwritten"):
        setup.BackupFile(file, "so101")
    with pytest.raises(BackupError, match="cannot be written"):
        early.save(servo(), NOW)
    assert file.read_text() == "mine"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"P_GAIN"', '"P_GAINS"', "no register P_GAINS"),
        ('"P_GAIN": 32', '"P_GAIN": 256', "P_GAIN must be 0 to 255, not 256"),
        ('"new_id": 6', '"new_id": 254', "new_id"),
        ("registers 1", "registers 2", "format"),
        ("}", "", "no backup of servo registers"),
    ],
)
def test_a_file_with_a_mistake_is_refused_with_its_place(tmp_path, old, new, said):
    backup = setup.BackupFile(tmp_path / "kit.json", "so101")
    backup.save(servo(P_GAIN=32), NOW)
    backup.path.write_text(backup.path.read_text().replace(old, new))
    with pytest.raises(BackupError, match=said):
        setup.read_backup(backup.path)


BECAME_6, BECAME_5, KEPT_1 = (servo(1, new_id) for new_id in (6, 5, 1))


def test_servos_are_recognised_by_the_ids_that_they_got():
    for saved, found_ids, matched in (
        ([BECAME_6, BECAME_5, KEPT_1], [1, 5, 9], {1: KEPT_1, 5: BECAME_5}),
        ([BECAME_6], [1], {1: BECAME_6}),
        ([BECAME_6], [1, 6], {6: BECAME_6}),
        ([BECAME_6, BECAME_5], [1], {}),
        ([BECAME_6, servo(6, 6, P_GAIN=16)], [6], {6: BECAME_6}),
    ):
        assert setup.match_saved(saved, found_ids) == matched
