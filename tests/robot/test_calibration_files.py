from __future__ import annotations

import json

import pytest

from robot.calibration import Calibration
from robot.calibration_files import find_calibration, lerobot_directories, new_calibration_path, save
from robot.errors import CalibrationError


@pytest.fixture
def home(tmp_path):
    return {"HF_LEROBOT_CALIBRATION": str(tmp_path)}


def test_a_path_is_taken_as_it_is(home):
    assert str(find_calibration("arms/left.json", home)) == "arms/left.json"


@pytest.mark.parametrize("robot", ["so_follower", "so101_follower"])
def test_an_id_is_found_under_both_names_that_lerobot_gave_the_robot(home, tmp_path, robot):
    path = tmp_path / "robots" / robot / "left.json"
    save(Calibration.nominal(), path)
    assert find_calibration("left", home) == path


def test_an_id_that_lerobot_does_not_know_is_refused_with_the_places_looked_at(home, tmp_path):
    with pytest.raises(CalibrationError, match=r"so_follower/left\.json or .*so101_follower/left\.json"):
        find_calibration("left", home)


def test_two_calibrations_of_one_id_are_refused_only_if_they_differ(home):
    first, second = (directory / "left.json" for directory in lerobot_directories(home))
    save(Calibration.nominal(), first)
    save(Calibration.nominal(), second)
    assert find_calibration("left", home) == first
    second.write_text("{}")
    with pytest.raises(CalibrationError, match="ambiguous"):
        find_calibration("left", home)


@pytest.mark.parametrize(
    ("environment", "start"),
    [
        ({"HF_LEROBOT_CALIBRATION": "/a"}, "/a/robots/"),
        ({"HF_LEROBOT_HOME": "/b"}, "/b/calibration/robots/"),
        ({"HF_HOME": "/c"}, "/c/lerobot/calibration/robots/"),
        ({"HF_LEROBOT_CALIBRATION": "/a", "HF_LEROBOT_HOME": "/b"}, "/a/robots/"),
    ],
)
def test_the_directory_follows_lerobots_environment_variables(environment, start):
    assert all(str(directory).startswith(start) for directory in lerobot_directories(environment))


def test_what_is_saved_loads_as_the_same_calibration(tmp_path):
    path = tmp_path / "new" / "arm.json"
    save(Calibration.nominal(), path)
    assert Calibration.load(path) == Calibration.nominal()
    assert list(json.loads(path.read_text())["gripper"]) == [
        "id",
        "drive_mode",
        "homing_offset",
        "range_min",
        "range_max",
    ]
    assert [entry.name for entry in path.parent.iterdir()] == ["arm.json"]


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(CalibrationError, match="cannot be written"):
        save(Calibration.nominal(), tmp_path / "file" / "arm.json")


def test_a_new_calibration_of_an_id_goes_where_lerobot_looks_first(home):
    assert new_calibration_path("left", home) == lerobot_directories(home)[0] / "left.json"
    assert str(new_calibration_path("./left.json", home)) == "left.json"
