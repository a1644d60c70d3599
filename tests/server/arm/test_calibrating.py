from dataclasses import replace
from pathlib import Path

import pytest

from robot.calibration import save
from robot.errors import CalibrationError, OrderRefused
from server.arm.calibrating import LEAST_STATE_RATE_HZ, calibration_file, check_state_rate
from server.arm.setup import Description
from server.config import ArmSettings
from tests.helpers.robots import nominal_calibration


@pytest.fixture
def lerobot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    save(nominal_calibration(), tmp_path / "robots" / "so_follower" / "mine.json")
    return tmp_path / "robots" / "so_follower"


def test_a_name_is_one_of_lerobots_and_without_one_the_calibration_in_use_is_written(lerobot: Path) -> None:
    description = Description.read(ArmSettings(calibration=Path("mine")))
    assert (description.calibration, description.calibration_file) == (nominal_calibration(), lerobot / "mine.json")
    assert calibration_file("other", description) == (lerobot / "other.json", False)
    for name in ("mine", ""):
        assert calibration_file(name, description) == (lerobot / "mine.json", True)


@pytest.mark.parametrize(
    ("name", "robot", "words"),
    [
        ("", "so101", "no calibration is in use: name the one to write"),
        *((name, "so101", "is no name") for name in ("a/b", "../mine", "mine.json", "-x", "x" * 65, "a b")),
        ("mine", "koch_v1_1", "has dynamixel servos"),
    ],
)
def test_a_name_leads_nowhere_else_and_one_is_needed(lerobot: Path, name: str, robot: str, words: str) -> None:
    assert lerobot.is_dir()
    with pytest.raises(CalibrationError, match=words):
        calibration_file(name, Description.read(ArmSettings(robot=robot)))


def test_an_arm_that_lerobot_does_not_know_needs_a_file() -> None:
    description = Description.read(ArmSettings())
    description = replace(description, hardware=replace(description.hardware, calibrations=()))
    with pytest.raises(CalibrationError, match="lerobot has no place for this arm"):
        calibration_file("mine", description)


def test_states_that_come_too_rarely_to_follow_a_hand_refuse_a_calibration() -> None:
    check_state_rate(LEAST_STATE_RATE_HZ)
    with pytest.raises(OrderRefused, match=r"arm\.joint_state_rate_hz must be at least 10 Hz to calibrate, not 5"):
        check_state_rate(5.0)
