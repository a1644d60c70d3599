import contextlib
import importlib.util
import os
import shutil
import socket
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import ValidationError

from robot.calibration import Calibration, JointCalibration, new_calibration_path, save
from robot.description.robot_folder import built_in
from robot.emulator.populations import POPULATIONS
from robot.hardware.config import EmulatedConfig, HardwareConfig, IdealConfig, SerialConfig
from robot.hardware.feetech.registers import Register
from robot.messages import EmergencyPolicy, EndState, GuardLimits
from server.arm.setup import Description, arm_config, check_parameters
from server.config import ArmSettings, EmulatorSettings, GuardSettings, Settings, SimulationSettings
from server.errors import ConfigurationError
from server.moveit.parameters import MoveItParameters
from tests.helpers import dynamixel, robots
from tests.helpers.robots import nominal_calibration, so101

PHYSICS = SimulationSettings(kind="physics")

WRONG = {
    "group": (MoveItParameters(group_name="leg"), r"moveit\.group_name.*'leg'.*arm, gripper"),
    "link": (MoveItParameters(end_effector_link="toe"), r"moveit\.end_effector_link.*'toe'.*gripper_frame_link"),
    "frame": (MoveItParameters(planning_frame="world"), r"moveit\.planning_frame.*'base_link'.*'world'"),
}


@pytest.mark.parametrize(("parameters", "words"), WRONG.values(), ids=WRONG.keys())
def test_a_parameter_the_robot_does_not_have_is_named(parameters: MoveItParameters, words: str) -> None:
    with pytest.raises(ConfigurationError, match=words):
        check_parameters(parameters, so101())


def described(folder: Path, urdf: str, srdf: str) -> dict[str, Path]:
    """The settings of a robot whose description is written to files."""
    paths = {"urdf": folder / "arm.urdf", "srdf": folder / "arm.srdf"}
    paths["urdf"].write_text(urdf)
    paths["srdf"].write_text(srdf)
    return paths


def calibrated(folder: Path) -> Path:
    """A calibration file."""
    save(nominal_calibration(), folder / "calibration.json")
    return folder / "calibration.json"


@pytest.mark.parametrize("on_servos", ["serial", "calibration"])
def test_a_robot_without_the_calibrated_joints_is_refused(tmp_path: Path, on_servos: str) -> None:
    builtin = so101()
    twisted = (text.replace("wrist_roll", "wrist_twist") for text in (builtin.urdf, builtin.srdf))
    files = described(tmp_path, *twisted)
    hardware = {"serial": "/dev/arm"} if on_servos == "serial" else {"calibration": calibrated(tmp_path)}
    with pytest.raises(ConfigurationError, match="'wrist_roll'"):
        Description.read(ArmSettings(**files, **hardware))


def test_another_description_alone_is_an_ideal_arm(tmp_path: Path) -> None:
    files = described(tmp_path, robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)
    settings = Settings(arm=ArmSettings(**files, ideal_lag_s=0.1))
    read = Description.read(settings.arm)
    config = arm_config(settings, read)
    assert (read.calibration, read.calibration_file) == (None, None)
    assert config.hardware == IdealConfig(0.1, driven=True)
    assert config.hardware.joint_names(read.robot) == ("a1", "a2", "a3", "a4", "a5", "a6", "a7")


def hardware_of(**settings: Any) -> HardwareConfig:
    made = Settings(**settings)
    return arm_config(made, Description.read(made.arm)).hardware


def test_a_port_means_servos_there(tmp_path: Path) -> None:
    nominal = nominal_calibration()
    assert hardware_of(arm=ArmSettings(serial="/dev/arm")) == SerialConfig(nominal, "/dev/arm")
    files = described(tmp_path, so101().urdf, so101().srdf)
    assert hardware_of(arm=ArmSettings(serial="auto", **files)) == SerialConfig(nominal, "auto")


def own_profile(folder: Path, profile: str) -> Path:
    copied = folder / "arm"
    shutil.copytree(built_in("so101").folder, copied)
    file = copied / "robot.toml"
    file.write_text(f"{file.read_text()}\n[hardware.profile]\n{profile}\n")
    return copied


@pytest.mark.parametrize("serial", ["/dev/arm", None])
def test_the_servos_should_have_the_settings_of_the_arms_own_profile(tmp_path: Path, serial: str | None) -> None:
    robot = own_profile(tmp_path, 'base = "lerobot"\nregisters = { P_GAIN = 20 }')
    hardware = hardware_of(arm=ArmSettings(robot=str(robot), serial=serial))
    assert isinstance(hardware, SerialConfig | EmulatedConfig)
    assert hardware.profile is not None
    assert hardware.profile.expected(gripper=True)[Register.P_GAIN] == 20
    assert hardware.profile.expected(gripper=True)[Register.MAX_TORQUE] == 500


def test_a_setting_that_servos_do_not_have_is_refused_with_its_place(tmp_path: Path) -> None:
    robot = own_profile(tmp_path, "registers = { P_GANE = 20 }")
    with pytest.raises(ConfigurationError, match=r"hardware\.profile\.registers\.P_GANE: there is no such setting"):
        hardware_of(arm=ArmSettings(robot=str(robot)))


def test_no_port_means_emulated_servos_with_the_faults_that_are_set(tmp_path: Path) -> None:
    assert hardware_of() == EmulatedConfig(nominal_calibration(), driven=True)
    places = {"write_log": tmp_path / "writes.jsonl", "control": tmp_path / "control"}
    emulator = EmulatorSettings(drop=0.1, corrupt=0.2, seed=3, **places)
    wanted = EmulatedConfig(nominal_calibration(), drop=0.1, corrupt=0.2, seed=3, driven=True, **places)
    assert hardware_of(emulator=emulator) == wanted
    files = described(tmp_path, so101().urdf, so101().srdf)
    assert hardware_of(arm=ArmSettings(**files, calibration=calibrated(tmp_path)), emulator=emulator) == wanted


def test_physics_moves_every_kind_of_simulated_arm_and_no_real_one() -> None:
    for robot, kind in (("so101", EmulatedConfig), ("koch_v1_1", EmulatedConfig), ("fetch", IdealConfig)):
        hardware = hardware_of(arm=ArmSettings(robot=robot), simulation=PHYSICS)
        assert isinstance(hardware, kind)
        assert hardware.physics
        assert hardware_of(arm=ArmSettings(robot=robot)) == replace(hardware, physics=False)
    with pytest.raises(ValidationError, match="simulation: there is no simulated arm beside the arm at /dev/arm"):
        Settings(arm=ArmSettings(serial="/dev/arm"), simulation=PHYSICS)


def test_only_an_only_simulated_arm_is_faster_than_time() -> None:
    hardware = hardware_of(simulation=SimulationSettings(rate=8.0))
    assert isinstance(hardware, EmulatedConfig)
    assert hardware.rate == 8.0
    with pytest.raises(ValidationError, match=r"simulation\.rate: must be 1 with several arms, not 8"):
        Settings.model_validate({"arms": {"left": {}}, "simulation": {"rate": 8.0}})


def test_a_light_simulation_has_no_world() -> None:
    with pytest.raises(ValidationError, match=r"world: cubes needs physics: set simulation\.kind to physics"):
        SimulationSettings(world="cubes")


def test_physics_without_mujoco_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(ConfigurationError, match=r"physics needs MuJoCo: pip install 'armbridge\[physics\]'"):
        hardware_of(simulation=PHYSICS)


def test_a_koch_has_dynamixel_servos_on_a_port_and_emulated() -> None:
    servos = dynamixel.SERVOS
    nominal = Calibration.nominal(servos)
    on_port = hardware_of(arm=ArmSettings(robot="koch_v1_1", serial="/dev/arm"))
    assert on_port == SerialConfig(nominal, "/dev/arm", "dynamixel", 1_000_000)
    assert isinstance(on_port, SerialConfig)
    assert not on_port.calibration.zero_is_known
    emulated = hardware_of(arm=ArmSettings(robot="koch_v1_1"), emulator=EmulatorSettings(drop=0.1, corrupt=0.2, seed=3))
    assert emulated == EmulatedConfig(nominal, kind="dynamixel", drop=0.1, corrupt=0.2, seed=3, driven=True)


@pytest.mark.parametrize("name", ["write_log", "control", "population"])
def test_an_option_that_emulated_dynamixel_servos_do_not_have_is_refused(name: str) -> None:
    emulator = EmulatorSettings(**{name: BUS_OPTIONS[name]})
    with pytest.raises(ConfigurationError, match=rf"emulator\.{name}: emulated Dynamixel servos have nothing that '"):
        hardware_of(arm=ArmSettings(robot="koch_v1_1"), emulator=emulator)


def test_every_population_can_be_set() -> None:
    assert set(get_args(EmulatorSettings.model_fields["population"].annotation)) == set(POPULATIONS)


def test_a_calibration_of_a_koch_may_have_whole_turns_in_its_homing_offsets(tmp_path: Path) -> None:
    joints = tuple(replace(joint, homing_offset=-7000) for joint in dynamixel.CALIBRATION.joints)
    save(Calibration(joints), tmp_path / "koch.json")
    on_port = hardware_of(arm=ArmSettings(robot="koch_v1_1", serial="/dev/arm", calibration=tmp_path / "koch.json"))
    assert isinstance(on_port, SerialConfig)
    assert on_port.calibration.joints == joints
    assert on_port.calibration.zero_is_known


BUS_OPTIONS = {
    "drop": 0.1,
    "corrupt": 0.1,
    "seed": 1,
    "population": "clone",
    "write_log": Path("writes.jsonl"),
    "control": Path("control"),
}


@pytest.mark.parametrize("name", EmulatorSettings.model_fields)
def test_an_option_of_the_emulated_servos_is_refused_for_an_ideal_arm(tmp_path: Path, name: str) -> None:
    files = described(tmp_path, robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)
    with pytest.raises(ConfigurationError, match=rf"emulator\.{name}: the ideal arm .* has no servo bus"):
        hardware_of(arm=ArmSettings(**files), emulator=EmulatorSettings(**{name: BUS_OPTIONS[name]}))


def test_a_trim_of_a_zero_is_refused_for_an_ideal_arm(tmp_path: Path) -> None:
    files = described(tmp_path, robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)
    with pytest.raises(ConfigurationError, match=r"arm\.zero_offset_rad\.a1: the ideal arm has no servos"):
        Description.read(ArmSettings(**files, zero_offset_rad={"a1": 0.1}))


@pytest.mark.parametrize("enabled", [True, False])
def test_simulated_joints_start_with_torque_on_where_the_arm_is_to_hold(tmp_path: Path, *, enabled: bool) -> None:
    files = described(tmp_path, robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)
    for hardware in (
        hardware_of(arm=ArmSettings(start_enabled=enabled)),
        hardware_of(arm=ArmSettings(start_enabled=enabled, **files)),
    ):
        assert isinstance(hardware, EmulatedConfig | IdealConfig)
        assert hardware.driven is enabled


def joints_of(settings: ArmSettings) -> tuple[JointCalibration, ...]:
    """The calibrated joints of an arm that has servos."""
    calibration = Description.read(settings).calibration
    assert calibration is not None
    return calibration.joints


PLACES = {
    "log in the place of a directory": ("write_log", ".", r"write_log: .* is a directory"),
    "log in no directory": ("write_log", "none/log", r"write_log: .*none is no directory"),
    "socket in no directory": ("control", "none/socket", r"control: .*none is no directory"),
    "socket in the place of a file": ("control", "taken", r"control: .*taken exists, and is no socket"),
    "socket with a long name": ("control", "a" * 107, r"control: the path of a Unix socket has at most 107 bytes, not"),
}


@pytest.mark.parametrize(("name", "place", "words"), PLACES.values(), ids=PLACES.keys())
def test_an_unusable_place_is_named_with_its_setting(tmp_path: Path, name: str, place: str, words: str) -> None:
    (tmp_path / "taken").touch()
    with pytest.raises(ConfigurationError, match=rf"emulator\.{words}"):
        hardware_of(emulator=EmulatorSettings(**{name: tmp_path / place}))


def test_a_socket_that_an_ended_server_has_left_is_no_hindrance(tmp_path: Path) -> None:
    path = Path("left.socket")
    with contextlib.chdir(tmp_path):
        with socket.socket(socket.AF_UNIX) as left:
            left.bind(str(path))
        hardware = hardware_of(emulator=EmulatorSettings(control=path))
    assert isinstance(hardware, EmulatedConfig)
    assert hardware.control == path


def test_a_trim_of_a_zero_moves_the_limits_of_its_joint() -> None:
    plain = joints_of(ArmSettings())[2]
    trimmed = joints_of(ArmSettings(zero_offset_rad={"elbow_flex": 0.02}))[2]
    assert trimmed.rad_from_ticks(2000) == pytest.approx(plain.rad_from_ticks(2000) + 0.02)


def test_a_calibration_is_found_by_its_id_in_lerobot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    file = new_calibration_path("my_arm", robots.SO101.hardware.calibrations, os.environ)
    save(nominal_calibration(), file)
    read = Description.read(ArmSettings(calibration=Path("my_arm")))
    assert (read.calibration, read.calibration_file) == (nominal_calibration(), file)


def test_the_arm_process_gets_what_is_set() -> None:
    guards = GuardSettings(stall_time_s=0.5)
    settings = ArmSettings(
        watchdog_s=1.5, on_exit=EndState.RELAX, on_emergency_stop=EmergencyPolicy.HOLD, guards=guards
    )
    config = arm_config(Settings(arm=settings), Description.read(settings))
    assert (config.watchdog_s, config.on_exit) == (1.5, EndState.RELAX)
    assert config.on_emergency_stop is EmergencyPolicy.HOLD
    assert config.guard_limits == GuardLimits(stall_time_s=0.5)
    shared = {field.name for field in fields(config)} & set(ArmSettings.model_fields) - {"calibration", "robot"}
    assert {name: getattr(config, name) for name in shared} == {name: getattr(settings, name) for name in shared}
