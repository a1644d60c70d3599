import importlib.util
import shutil
import socket
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import ValidationError

from robot.calibration import Calibration, save
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


def test_a_parameter_the_robot_does_not_have_is_named() -> None:
    for name, value, words in (
        ("group_name", "leg", "'leg'.*arm, gripper"),
        ("end_effector_link", "toe", "'toe'.*gripper_frame_link"),
        ("planning_frame", "world", "'base_link'.*'world'"),
    ):
        with pytest.raises(ConfigurationError, match=rf"moveit\.{name}.*{words}"):
            check_parameters(MoveItParameters.model_validate({name: value}), so101())


def described(folder: Path, urdf: str, srdf: str) -> dict[str, Path]:
    """The settings of a robot whose description is written to files."""
    paths = {"urdf": folder / "arm.urdf", "srdf": folder / "arm.srdf"}
    paths["urdf"].write_text(urdf)
    paths["srdf"].write_text(srdf)
    return paths


@pytest.fixture
def ideal(tmp_path: Path) -> dict[str, Path]:
    """The settings of an arm that no servos are known of."""
    return described(tmp_path, robots.SEVEN_JOINT_URDF, robots.SEVEN_JOINT_SRDF)


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    save(nominal_calibration(), tmp_path / "calibration.json")
    return tmp_path / "calibration.json"


@pytest.mark.parametrize("on_servos", ["serial", "calibration"])
def test_a_robot_without_the_calibrated_joints_is_refused(tmp_path: Path, calibration: Path, on_servos: str) -> None:
    twisted = (text.replace("wrist_roll", "wrist_twist") for text in (so101().urdf, so101().srdf))
    hardware = {"serial": "/dev/arm", "calibration": calibration}
    with pytest.raises(ConfigurationError, match="'wrist_roll'"):
        Description.read(ArmSettings(**described(tmp_path, *twisted), **{on_servos: hardware[on_servos]}))


def test_another_description_alone_is_an_ideal_arm_which_has_no_servos_to_trim(ideal: dict[str, Path]) -> None:
    settings = Settings(arm=ArmSettings(**ideal, ideal_lag_s=0.1))
    read = Description.read(settings.arm)
    config = arm_config(settings, read)
    assert (read.calibration, read.calibration_file) == (None, None)
    assert config.hardware == IdealConfig(0.1, driven=True)
    assert config.hardware.joint_names(read.robot) == ("a1", "a2", "a3", "a4", "a5", "a6", "a7")
    with pytest.raises(ConfigurationError, match=r"arm\.zero_offset_rad\.a1: the ideal arm has no servos"):
        Description.read(ArmSettings(**ideal, zero_offset_rad={"a1": 0.1}))


@pytest.mark.parametrize("named", [{}, {"robot": "fetch"}])
def test_the_packages_of_the_meshes_are_looked_for_in_the_folders_of_the_settings(
    ideal: dict[str, Path], tmp_path: Path, named: dict[str, str]
) -> None:
    settings = ArmSettings(**(named or ideal), package_path=[tmp_path])
    assert tmp_path in Description.read(settings).robot.package_directories


def hardware_of(**settings: Any) -> HardwareConfig:
    made = Settings(**settings)
    return arm_config(made, Description.read(made.arm)).hardware


def test_a_port_means_servos_there_and_none_emulated_ones_with_faults(tmp_path: Path, calibration: Path) -> None:
    nominal, files = nominal_calibration(), described(tmp_path, so101().urdf, so101().srdf)
    assert hardware_of(arm=ArmSettings(serial="/dev/arm")) == SerialConfig(nominal, "/dev/arm")
    assert hardware_of(arm=ArmSettings(serial="auto", **files)) == SerialConfig(nominal, "auto")
    assert hardware_of() == EmulatedConfig(nominal, driven=True)
    faults = {"drop": 0.1, "corrupt": 0.2, "seed": 3, "write_log": tmp_path / "log", "control": tmp_path / "control"}
    for arm in (ArmSettings(), ArmSettings(**files, calibration=calibration)):
        hardware = hardware_of(arm=arm, emulator=EmulatorSettings(**faults))
        assert hardware == EmulatedConfig(nominal, driven=True, **faults)


def test_the_servos_should_have_the_settings_of_the_arms_own_profile(tmp_path: Path) -> None:
    robot = str(shutil.copytree(built_in("so101").folder, tmp_path / "arm"))
    file = tmp_path / "arm" / "robot.toml"
    text = f"{file.read_text()}\n[hardware.profile]\n"
    file.write_text(f'{text}base = "lerobot"\nregisters = {{ P_GAIN = 20 }}\n')
    for serial in ("/dev/arm", None):
        hardware = hardware_of(arm=ArmSettings(robot=robot, serial=serial))
        assert isinstance(hardware, SerialConfig | EmulatedConfig)
        assert hardware.profile is not None
        expected = hardware.profile.expected(gripper=True)
        assert (expected[Register.P_GAIN], expected[Register.MAX_TORQUE]) == (20, 500)
    file.write_text(f"{text}registers = {{ P_GANE = 20 }}\n")
    with pytest.raises(ConfigurationError, match=r"hardware\.profile\.registers\.P_GANE: there is no such setting"):
        hardware_of(arm=ArmSettings(robot=robot))


def test_physics_moves_every_kind_of_simulated_arm_and_no_real_one() -> None:
    for robot, kind in (("so101", EmulatedConfig), ("koch_v1_1", EmulatedConfig), ("fetch", IdealConfig)):
        hardware = hardware_of(arm=ArmSettings(robot=robot), simulation=PHYSICS)
        assert isinstance(hardware, kind)
        assert hardware.physics
        assert hardware_of(arm=ArmSettings(robot=robot)) == replace(hardware, physics=False)
    with pytest.raises(ValidationError, match="simulation: there is no simulated arm beside the arm at /dev/arm"):
        Settings(arm=ArmSettings(serial="/dev/arm"), simulation=PHYSICS)


def test_only_an_only_simulated_arm_is_faster_than_time_and_only_physics_has_a_world() -> None:
    hardware = hardware_of(simulation=SimulationSettings(rate=8.0))
    assert isinstance(hardware, EmulatedConfig)
    assert hardware.rate == 8.0
    with pytest.raises(ValidationError, match=r"simulation\.rate: must be 1 with several arms, not 8"):
        Settings.model_validate({"arms": {"left": {}}, "simulation": {"rate": 8.0}})
    with pytest.raises(ValidationError, match=r"world: cubes needs physics: set simulation\.kind to physics"):
        SimulationSettings(world="cubes")


def test_physics_without_mujoco_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(ConfigurationError, match=r"physics needs MuJoCo: pip install 'armbridge\[physics\]'"):
        hardware_of(simulation=PHYSICS)


def test_a_koch_has_dynamixel_servos_on_a_port_and_emulated(tmp_path: Path) -> None:
    nominal = Calibration.nominal(dynamixel.SERVOS)
    on_port = hardware_of(arm=ArmSettings(robot="koch_v1_1", serial="/dev/arm"))
    assert on_port == SerialConfig(nominal, "/dev/arm", "dynamixel", 1_000_000)
    assert not nominal.zero_is_known
    emulated = hardware_of(arm=ArmSettings(robot="koch_v1_1"), emulator=EmulatorSettings(drop=0.1, corrupt=0.2, seed=3))
    assert emulated == EmulatedConfig(nominal, kind="dynamixel", drop=0.1, corrupt=0.2, seed=3, driven=True)
    # A calibration may have whole turns in its homing offsets.
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
def test_an_option_that_the_emulated_arm_has_not_is_refused(ideal: dict[str, Path], name: str) -> None:
    emulator = EmulatorSettings(**{name: BUS_OPTIONS[name]})
    with pytest.raises(ConfigurationError, match=rf"emulator\.{name}: the ideal arm .* has no servo bus"):
        hardware_of(arm=ArmSettings(**ideal), emulator=emulator)
    if name in ("write_log", "control", "population"):
        with pytest.raises(
            ConfigurationError, match=rf"emulator\.{name}: emulated Dynamixel servos have nothing that '"
        ):
            hardware_of(arm=ArmSettings(robot="koch_v1_1"), emulator=emulator)


def test_every_population_can_be_set() -> None:
    assert set(get_args(EmulatorSettings.model_fields["population"].annotation)) == set(POPULATIONS)


@pytest.mark.parametrize("enabled", [True, False])
def test_simulated_joints_start_with_torque_if_the_arm_is_to_hold(ideal: dict[str, Path], *, enabled: bool) -> None:
    for files in ({}, ideal):
        hardware = hardware_of(arm=ArmSettings(start_enabled=enabled, **files))
        assert isinstance(hardware, EmulatedConfig | IdealConfig)
        assert hardware.driven is enabled


def test_an_unusable_place_is_named_with_its_setting(tmp_path: Path) -> None:
    for name, place, words in (
        ("write_log", ".", r"write_log: .* is a directory"),
        ("write_log", "none/log", r"write_log: .*none is no directory"),
        ("control", "none/socket", r"control: .*none is no directory"),
        ("control", "taken", r"control: .*taken exists, and is no socket"),
        ("control", "a" * 107, r"control: the path of a Unix socket has at most 107 bytes, not"),
    ):
        (tmp_path / "taken").touch()
        with pytest.raises(ConfigurationError, match=rf"emulator\.{words}"):
            hardware_of(emulator=EmulatorSettings(**{name: tmp_path / place}))


def test_a_socket_that_a_server_has_left_is_no_hindrance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with socket.socket(socket.AF_UNIX) as left:
        left.bind("left.socket")
    hardware = hardware_of(emulator=EmulatorSettings(control=Path("left.socket")))
    assert isinstance(hardware, EmulatedConfig)
    assert hardware.control == Path("left.socket")


def test_a_trim_of_a_zero_moves_the_limits_of_its_joint() -> None:
    at_rad = []
    for trims_rad in ({}, {"elbow_flex": 0.02}):
        calibration = Description.read(ArmSettings(zero_offset_rad=trims_rad)).calibration
        assert calibration is not None
        at_rad.append(calibration.joints[2].rad_from_ticks(2000))
    assert at_rad[1] == pytest.approx(at_rad[0] + 0.02)


def test_the_arm_process_gets_what_is_set() -> None:
    policies = {"on_exit": EndState.RELAX, "on_emergency_stop": EmergencyPolicy.HOLD}
    settings = ArmSettings(watchdog_s=1.5, guards=GuardSettings(stall_time_s=0.5), **policies)
    config = arm_config(Settings(arm=settings), Description.read(settings))
    assert config.guard_limits == GuardLimits(stall_time_s=0.5)
    shared = {field.name for field in fields(config)} & set(ArmSettings.model_fields) - {"calibration", "robot"}
    assert shared >= {"watchdog_s", *policies}
    assert {name: getattr(config, name) for name in shared} == {name: getattr(settings, name) for name in shared}
