from __future__ import annotations

from datetime import UTC, datetime

import pytest

from robot.commissioning.register_backup import BackupFile, SavedServo, match_saved, read_backup
from robot.errors import BackupError
from robot.hardware.feetech.registers import Register

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)


def servo(servo_id=1, new_id=6, **values):
    registers = {Register.ID: servo_id, **{Register[name]: value for name, value in values.items()}}
    return SavedServo(joint="gripper", servo_id=servo_id, new_id=new_id, baudrate=1_000_000, registers=registers)


def test_what_is_saved_reads_back_and_grows_servo_by_servo(tmp_path):
    backup = BackupFile(tmp_path / "new" / "kit.json", "so101")
    assert backup.empty
    first, second = servo(HOMING_OFFSET=-40), servo(new_id=5)
    backup.save(first, NOW)
    assert read_backup(backup.path) == (first,)
    backup.save(second, NOW)
    assert read_backup(backup.path) == (first, second)


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


BECAME_6, BECAME_5, KEPT_1 = (servo(1, new_id) for new_id in (6, 5, 1))


@pytest.mark.parametrize(
    ("saved", "found_ids", "matched"),
    [
        ([BECAME_6, BECAME_5, KEPT_1], [1, 5, 9], {1: KEPT_1, 5: BECAME_5}),
        ([BECAME_6], [1], {1: BECAME_6}),
        ([BECAME_6], [1, 6], {6: BECAME_6}),
        ([BECAME_6, BECAME_5], [1], {}),
        ([BECAME_6, servo(6, 6, P_GAIN=16)], [6], {6: BECAME_6}),
    ],
    ids=["by new ids", "by the old id after a setup broken off", "not by it else", "none of two alike", "first visit"],
)
def test_servos_are_recognised_by_the_ids_that_they_got(saved, found_ids, matched):
    assert match_saved(saved, found_ids) == matched
