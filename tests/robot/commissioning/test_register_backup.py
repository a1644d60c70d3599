from __future__ import annotations

import json
from datetime import UTC, datetime

import pytest

from robot.commissioning.register_backup import BackupFile, SavedServo, match_saved, read_backup, read_registers
from robot.errors import BackupError
from robot.hardware.feetech.registers import LAYOUT, Register
from robot.hardware.interface import run_to_end

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def servo(servo_id=1, new_id=6, **values):
    registers = {Register.ID: servo_id, **{Register[name]: value for name, value in values.items()}}
    return SavedServo("gripper", servo_id, new_id, 1_000_000, registers)


def test_every_documented_register_is_read_as_the_servo_has_it(bus, emulator):
    registers = run_to_end(read_registers(bus, 3), emulator.run)
    assert registers.keys() == LAYOUT.keys()
    assert registers == {register: bus.read(3, register) for register in LAYOUT}


def test_what_is_saved_reads_back_and_grows_servo_by_servo(tmp_path):
    backup = BackupFile(tmp_path / "new" / "kit.json", "so101")
    assert backup.empty
    first, second = servo(HOMING_OFFSET=-40), servo(new_id=5)
    backup.save(first, NOW)
    assert read_backup(backup.path) == (first,)
    backup.save(second, NOW)
    assert read_backup(backup.path) == (first, second)


def test_people_can_read_the_file(tmp_path):
    backup = BackupFile(tmp_path / "kit.json", "so101")
    backup.save(servo(P_GAIN=32), NOW)
    content = json.loads(backup.path.read_text())
    assert (content["robot"], content["saved_at"]) == ("so101", "2026-01-02T03:04:05+00:00")
    assert content["servos"][0]["registers"]["P_GAIN"] == 32


def test_a_file_that_is_there_is_never_overwritten(tmp_path):
    file = tmp_path / "kit.json"
    early = BackupFile(file, "so101")
    file.write_text("mine")
    with pytest.raises(BackupError, match="never overwritten"):
        BackupFile(file, "so101")
    with pytest.raises(BackupError, match="cannot be written"):
        early.save(servo(), NOW)
    assert file.read_text() == "mine"


def test_a_file_that_cannot_be_written_is_an_error_before_anything_else_happens(tmp_path):
    (tmp_path / "folder").write_text("")
    with pytest.raises(BackupError, match="cannot be written"):
        BackupFile(tmp_path / "folder" / "kit.json", "so101").save(servo(), NOW)


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
    backup = BackupFile(tmp_path / "kit.json", "so101")
    backup.save(servo(P_GAIN=32), NOW)
    backup.path.write_text(backup.path.read_text().replace(old, new))
    with pytest.raises(BackupError, match=said):
        read_backup(backup.path)


def test_a_backup_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(BackupError, match="cannot be read"):
        read_backup(tmp_path / "none.json")


def test_servos_are_recognised_by_the_ids_that_they_got():
    kit = [servo(1, new_id) for new_id in (6, 5, 1)]
    assert match_saved(kit, [1, 5, 9]) == {1: kit[2], 5: kit[1]}


def test_a_servo_whose_setup_was_broken_off_is_recognised_by_its_old_id():
    broken_off = servo(1, 6)
    assert match_saved([broken_off], [1]) == {1: broken_off}


def test_another_servo_with_the_old_id_is_not_taken_for_the_one_that_has_got_its_new_one():
    gripper = servo(1, 6)
    assert match_saved([gripper], [1, 6]) == {6: gripper}


def test_new_servos_that_cannot_be_told_apart_are_not_mixed_up():
    assert match_saved([servo(1, 6), servo(1, 5)], [1]) == {}


def test_of_two_visits_to_a_servo_the_state_before_the_first_counts():
    first, again = servo(1, 6, P_GAIN=32), servo(6, 6, P_GAIN=16)
    assert match_saved([first, again], [6]) == {6: first}
