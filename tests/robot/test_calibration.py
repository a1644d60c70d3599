import json
import math
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.calibration import (
    RAD_PER_TICK,
    Calibration,
    JointCalibration,
    find_calibration,
    lerobot_directories,
    new_calibration_path,
    reserved,
    save,
)
from robot.errors import CalibrationError
from tests.helpers.resources import shared_data
from tests.helpers.robots import SO101, SO101_SERVOS, nominal_calibration

TICKS = st.integers(0, 4095)
FOLDERS = SO101.hardware.calibrations
ELBOW = SO101_SERVOS[2]


@st.composite
def calibrated_joints(draw):
    spec = draw(st.sampled_from(SO101_SERVOS))
    range_min = draw(st.integers(0, 3000))
    range_max = draw(st.integers(range_min + 500, 4095))
    zero = draw(st.floats(-0.2, 0.2))
    return JointCalibration(spec, spec.servo_id, draw(st.integers(0, 1)), 0, range_min, range_max, zero)


def lerobot_file(tmp_path, **changes):
    table = {
        spec.joint: {"id": spec.servo_id, "drive_mode": 0, "homing_offset": 7, "range_min": 900, "range_max": 3100}
        for spec in SO101_SERVOS
    }
    for where, value in changes.items():
        joint, _, key = where.partition("__")
        if value is None:
            del table[joint]
        elif key:
            table[joint][key] = value
        else:
            table[joint] = value
    path = tmp_path / "arm.json"
    path.write_text(json.dumps(table))
    return path


@given(calibrated_joints(), TICKS)
def test_ticks_survive_the_way_to_radians_and_back(joint, ticks):
    assert joint.ticks_from_rad(joint.rad_from_ticks(ticks)) == ticks


def test_an_arm_joint_is_at_zero_in_the_middle_of_its_range_and_drive_mode_mirrors_the_gripper_alone():
    elbow = JointCalibration(ELBOW, 3, 0, 0, 793, 2995)
    assert (elbow.rad_from_ticks(1894), elbow.rad_from_ticks(1894 + 1024)) == (0.0, pytest.approx(math.pi / 2))
    assert JointCalibration(ELBOW, 3, 0, 0, 793, 2995, zero_offset_rad=0.13).rad_from_ticks(1894) == pytest.approx(0.13)
    arm = [JointCalibration(SO101_SERVOS[3], 4, mode, 0, 900, 3100) for mode in (0, 1)]
    assert arm[0].rad_from_ticks(1000) == arm[1].rad_from_ticks(1000)
    plain, mirrored = (JointCalibration(SO101_SERVOS[5], 6, mode, 0, 2030, 3454) for mode in (0, 1))
    assert plain.rad_from_ticks(2030) == mirrored.rad_from_ticks(3454) == pytest.approx(-0.174533)
    assert plain.rad_from_ticks(3454) == mirrored.rad_from_ticks(2030) == pytest.approx(1.74533)
    assert mirrored.rad_s_from_ticks_s(100.0) < 0.0


def test_the_nominal_arm_reaches_the_limits_of_the_urdf_and_is_centred():
    for joint, spec in zip(nominal_calibration().joints, SO101_SERVOS, strict=True):
        assert joint.range_min + joint.range_max == 4095
        assert joint.lower_rad <= spec.lower_rad + 1e-9
        assert joint.upper_rad >= spec.upper_rad - 1e-9
        if joint.joint != "wrist_roll":
            assert joint.upper_rad - joint.lower_rad <= spec.upper_rad - spec.lower_rad + 0.1 + 2 * RAD_PER_TICK


def test_a_file_of_lerobot_is_read_in_the_order_of_the_arm_and_a_range_of_nearly_a_turn_warned_of(tmp_path):
    calibration = Calibration.load(lerobot_file(tmp_path, elbow_flex__range_min=866), SO101_SERVOS)
    assert [joint.joint for joint in calibration.joints] == [spec.joint for spec in SO101_SERVOS]
    assert calibration.joints[2] == JointCalibration(ELBOW, 3, 0, 7, 866, 3100)
    wide = Calibration.load(lerobot_file(tmp_path, elbow_flex__range_min=10, elbow_flex__range_max=4090), SO101_SERVOS)
    assert [warning.split()[0] for warning in wide.warnings()] == ["elbow_flex"]
    # Where it is usual nobody is warned.
    assert nominal_calibration().warnings() == ()


def test_a_file_that_cannot_be_right_is_refused_with_its_field(tmp_path):
    for change, field, sentence in (
        ({"elbow_flex": None}, "elbow_flex", "missing"),
        ({"left_wheel": {}}, "left_wheel", "no such joint"),
        ({"gripper": 3}, "gripper", "must be an object"),
        ({"gripper__range_min": 3100}, "gripper.range_min", "below range_max 3100, not 3100"),
        ({"gripper__range_max": 4096}, "gripper.range_max", "0 to 4095, not 4096"),
        ({"gripper__range_max": 1.5}, "gripper.range_max", "whole number"),
        ({"gripper__drive_mode": True}, "gripper.drive_mode", "whole number"),
        ({"gripper__homing_offset": 2048}, "gripper.homing_offset", "-2047 to 2047"),
        ({"gripper__id": 254}, "gripper.id", "0 to 253"),
        ({"gripper__id": 5}, "gripper.id", "id of wrist_roll"),
    ):
        path = lerobot_file(tmp_path, **change)
        with pytest.raises(CalibrationError, match=sentence) as caught:
            Calibration.load(path, SO101_SERVOS)
        assert f"{path}{', ' if field else ''}{field}: " in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"homing_offset": [1, 2], "drive_mode": [0, 0], "start_pos": [], "end_pos": []}', "before June 2025"),
        ('{"calib_mode": ["DEGREE"]}', "before June 2025"),
        *((text, "arm.json") for text in ("", "{", "[]", "7", "\x00")),
        (None, "cannot be read"),
    ],
)
def test_a_file_of_an_old_schema_of_no_object_or_that_is_not_there_is_refused(tmp_path, text, words):
    path = tmp_path / "arm.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(CalibrationError, match=words):
        Calibration.load(path, SO101_SERVOS)


def test_the_elbow_of_every_measured_arm_spans_the_urdf_within_a_degree():
    facts = json.loads((shared_data() / "so101_facts.json").read_text())
    for name, ranges in facts["calibration_samples"]["rows"].items():
        joint = JointCalibration(ELBOW, 3, 0, 0, *ranges["elbow_flex"])
        expected = pytest.approx((ELBOW.lower_rad, ELBOW.upper_rad), abs=math.radians(1.0))
        assert (joint.lower_rad, joint.upper_rad) == expected, name


def test_a_zero_trim_moves_the_joints_it_names_and_no_other_and_one_that_makes_no_sense_is_refused():
    plain = nominal_calibration()
    joints = zip(plain.with_zero_offsets({"elbow_flex": 0.13}).joints, plain.joints, strict=True)
    moved = [new.rad_from_ticks(2000) - old.rad_from_ticks(2000) for new, old in joints]
    assert moved == pytest.approx([0.0, 0.0, 0.13, 0.0, 0.0, 0.0])
    for trim, words in (
        ({"elbow": 0.1}, "elbow: must be one of the arm's joints"),
        ({"gripper": 0.1}, "gripper: must be one of"),
        ({"elbow_flex": 0.6}, "within .*0.5 rad, not 0.6"),
        ({"elbow_flex": math.nan}, "not nan"),
    ):
        with pytest.raises(CalibrationError, match=words):
            plain.with_zero_offsets(trim)


@pytest.fixture
def home(tmp_path):
    return {"HF_LEROBOT_CALIBRATION": str(tmp_path)}


def test_an_id_is_found_under_both_names_that_lerobot_gave_the_robot_unless_two_differ(home, tmp_path):
    with pytest.raises(CalibrationError, match=r"so_follower/left\.json or .*so101_follower/left\.json"):
        find_calibration("left", FOLDERS, home)
    paths = [tmp_path / "robots" / robot / "left.json" for robot in ("so_follower", "so101_follower")]
    for path in reversed(paths):
        save(nominal_calibration(), path)
        assert find_calibration("left", FOLDERS, home) == path
    paths[1].write_text("{}")
    with pytest.raises(CalibrationError, match="ambiguous"):
        find_calibration("left", FOLDERS, home)
    # A new one goes where lerobot looks first.
    assert new_calibration_path("left", FOLDERS, home) == paths[0]
    assert str(new_calibration_path("./left.json", FOLDERS, home)) == "left.json"


def test_the_directory_follows_lerobots_environment_variables():
    for environment, start in (
        ({"HF_LEROBOT_CALIBRATION": "/a"}, "/a/robots/"),
        ({"HF_LEROBOT_HOME": "/b"}, "/b/calibration/robots/"),
        ({"HF_HOME": "/c"}, "/c/lerobot/calibration/robots/"),
        ({"HF_LEROBOT_CALIBRATION": "/a", "HF_LEROBOT_HOME": "/b"}, "/a/robots/"),
    ):
        directories = lerobot_directories(FOLDERS, environment)
        assert all(str(directory).startswith(start) for directory in directories), environment


def test_what_is_saved_loads_as_the_same_calibration_and_a_place_that_cannot_be_written_is_refused(tmp_path):
    path = tmp_path / "new" / "arm.json"
    save(nominal_calibration(), path)
    assert Calibration.load(path, SO101_SERVOS) == nominal_calibration()
    fields = ["id", "drive_mode", "homing_offset", "range_min", "range_max"]
    assert list(json.loads(path.read_text())["gripper"]) == fields
    assert [entry.name for entry in path.parent.iterdir()] == ["arm.json"]
    with pytest.raises(CalibrationError, match="cannot be written"):
        save(nominal_calibration(), path / "arm.json")
    with pytest.raises(CalibrationError, match="cannot be written"), reserved(path / "a", overwrite=True):
        pass


def test_a_file_that_is_being_calibrated_is_refused_with_the_process(tmp_path):
    path = tmp_path / "arm.json"
    with reserved(path, overwrite=False):
        refused = pytest.raises(CalibrationError, match=rf"in use by armbridge \(process {os.getpid()}\)")
        with refused, reserved(path, overwrite=True):
            pass
        save(nominal_calibration(), path)
    with pytest.raises(CalibrationError, match="is there already"), reserved(path, overwrite=False):
        pass
    with reserved(path, overwrite=True):
        pass
