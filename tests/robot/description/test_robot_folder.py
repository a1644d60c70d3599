import tempfile
from importlib import metadata
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.description import model, robot_folder
from robot.description.forward_kinematics import ForwardPlacements
from robot.description.model import RobotModel
from robot.description.robot_file import MAX_BYTES, read
from robot.description.robot_folder import PACKAGE, _robots, _urdfs, find_example
from robot.description.servo_table import ZeroTick
from robot.errors import DescriptionError, RobotFileError
from tests.helpers.robots import SEVEN_JOINT_SRDF, SEVEN_JOINT_URDF, so101

SERVOS = "".join(
    f'[[hardware.servos]]\njoint = "a{number}"\nid = {number}\nmodel = "STS3215"\n' for number in range(1, 8)
)


def arm_folder(folder: Path, toml: str = "", **files: str) -> Path:
    """A folder of the arm with seven joints."""
    arm = folder / "seven"
    arm.mkdir()
    (arm / "seven.urdf").write_text(SEVEN_JOINT_URDF)
    (arm / "seven.srdf").write_text(SEVEN_JOINT_SRDF)
    (arm / "robot.toml").write_text(toml)
    for name, text in files.items():
        (arm / name.replace("__", ".")).write_text(text)
    return arm


def test_the_file_s_tables_reach_the_model_and_an_empty_file_takes_the_only_urdf_and_srdf(tmp_path: Path) -> None:
    view = "view = [0.5, 0, 1, 0, 0, 0]\n"
    folder = arm_folder(
        tmp_path,
        '[robot]\ntitle = "Seven"\n[planning]\ntip = "hand"\n[gripper]\njoints = ["a7"]\nopen = 1.0\nclosed = 0.0\n'
        "[joints.a1]\nmax_velocity = 0.5\nmax_jerk = 9.0\n[held_joints]\na6 = 0.3\n"
        f"[cameras.top]\n{view}[cameras.hand]\nframe = 'hand'\nwidth = 640\n{view}",
    )
    found = robot_folder.load(folder)
    arm = found.model
    assert (found.title, arm.tip_link) == ("Seven", "hand")
    assert (arm.gripper.joints, arm.gripper.open, arm.gripper.closed) == (("a7",), 1.0, 0.0)
    assert (arm.joints["a1"].max_velocity, arm.joints["a1"].max_jerk) == (0.5, 9.0)
    assert "a6" not in [joint.name for joint in arm.movable_joints]
    assert "a6" not in arm.groups["arm"].joints
    # A camera is on the root link unless it names another.
    shown = {name: (each.frame, each.width) for name, each in found.cameras.items()}
    assert shown == {"top": ("pedestal", 320), "hand": ("hand", 640)}
    (folder / "robot.toml").write_text("")
    found = robot_folder.load(folder)
    assert (found.name, found.title, found.hardware.kind) == ("seven", "seven", "ideal")
    assert (found.model.default_group, found.model.tip_link) == ("arm", "tool")


def test_servos_have_the_limits_of_their_joints_and_their_zero(tmp_path: Path) -> None:
    servos = SERVOS.replace("id = 2\n", "id = 2\nsign = -1\nzero = { tick = 1000, angle_rad = 0.5 }\n")
    toml = f'[gripper]\njoints = ["a7"]\nopen = 1.0\nclosed = 0.0\n[hardware]\nkind = "feetech"\n{servos}'
    found = robot_folder.load(arm_folder(tmp_path, toml)).hardware.servos
    assert [servo.joint for servo in found] == [f"a{number}" for number in range(1, 8)]
    assert (found[1].sign, found[1].zero, found[1].needs_calibration) == (-1, ZeroTick(1000, 0.5), False)
    assert (found[0].lower_rad, found[0].model, found[0].needs_calibration) == (-2.9, "sts3215", True)
    assert [servo.joint for servo in found if servo.gripper] == ["a7"]


@given(st.floats(-1.9, 1.9), st.floats(-1.9, 1.9), st.floats(-1.9, 1.9))
def test_a_held_joint_places_the_links_as_it_does_where_it_is_driven_there(a2: float, a4: float, a7: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        arm = arm_folder(Path(folder), f"[held_joints]\na2 = {a2!r}\na7 = {a7!r}\n")
        held = robot_folder.load(arm).model
        (arm / "robot.toml").write_text("")
        free = robot_folder.load(arm).model
    rest = {joint.name: 0.1 for joint in free.movable_joints} | {"a4": a4}
    expected = ForwardPlacements(free).transforms({**rest, "a2": a2, "a7": a7})
    placed = ForwardPlacements(held).transforms({name: rest[name] for name in rest if name not in ("a2", "a7")})
    for link, transform in expected.items():
        assert np.allclose(placed[link], transform, atol=1e-9)


LIMITS_YAML = """
joint_limits:
  a1: {has_velocity_limits: true, max_velocity: 0.7, has_acceleration_limits: false, max_acceleration: 9.0}
  a2: {has_velocity_limits: false, max_velocity: 0.1, has_jerk_limits: true, max_jerk: 30,
       has_position_limits: true, min_position: -1.0, max_position: 1.0}
"""


def test_moveit_s_limits_are_read_and_give_way_to_the_file_s(tmp_path: Path) -> None:
    toml = '[robot]\njoint_limits = "limits.yaml"\n[joints.a1]\nmax_acceleration = 2.0\n'
    arm = robot_folder.load(arm_folder(tmp_path, toml, limits__yaml=LIMITS_YAML)).model
    first, second = arm.joints["a1"], arm.joints["a2"]
    assert (first.max_velocity, first.max_acceleration) == (0.7, 2.0)
    assert (second.max_velocity, second.max_jerk, second.lower, second.upper) == (2.0, 30.0, -1.0, 1.0)


WRONG = {
    "no file": ('[robot]\nurdf = "eight.urdf"', "robot.urdf: there is no file .*eight.urdf"),
    "gripper": ('[gripper]\njoints=["claw"]\nopen=1\nclosed=0', r"gripper.joints\[0\]: .* no movable joint 'claw'"),
    "servo": (
        f'[hardware]\nkind = "feetech"\n{SERVOS.replace("a3", "knee")}',
        r"hardware.servos\[2\].joint: the URDF has no movable joint 'knee', but a1",
    ),
    "no servo": (
        '[hardware]\nkind = "feetech"\n[[hardware.servos]]\njoint = "a1"\nid = 1\nmodel = "sts3215"',
        r"hardware.servos: joint 'a2' has no servo: give it one, or a place in \[held_joints\]",
    ),
    "held": ("[held_joints]\na1 = 7.0", r"held_joints.a1: must be from -2.9 to 2.9, not 7"),
    "group": ('[planning]\ngroup = "leg"', "planning.group: the SRDF has no group 'leg', but arm"),
    "tip": ('[planning]\ntip = "toe"', "planning.tip: the URDF has no link 'toe'"),
    "park": ('[planning]\npark = "bed"', "planning.park: the SRDF has no state 'bed', but "),
    "frame": ('[planning]\nframe = "world"', "planning.frame: must be the root link 'pedestal', not 'world'"),
    "camera": ('[cameras.top]\nframe="hat"\nview=[0,0,1,0,0,0]', "cameras.top.frame: the URDF has no link 'hat'"),
    "hulls": ('[robot]\nhulls = "hulls.json"', r"hulls.json cannot be read"),
    "yaml": ('[robot]\njoint_limits = "limits.yaml"', r"limits.yaml cannot be read"),
}


@pytest.mark.parametrize(("toml", "sentence"), WRONG.values(), ids=WRONG)
def test_what_does_not_fit_the_description_is_named(tmp_path: Path, toml: str, sentence: str) -> None:
    with pytest.raises(DescriptionError, match=sentence):
        robot_folder.load(arm_folder(tmp_path, toml))


def test_all_problems_of_the_files_are_told_at_once_and_what_is_missing_or_no_number_is_named(tmp_path: Path) -> None:
    folder = arm_folder(tmp_path, '[robot]\nurdf = "eight.urdf"\nhulls = "hulls.json"\njoint_limits = "limits.yaml"')
    assert len(robot_folder.problems(str(folder))) == 3
    (folder / "robot.toml").write_text('[robot]\njoint_limits = "limits.yaml"')
    (folder / "limits.yaml").write_text("joint_limits: {a1: {has_velocity_limits: true, max_velocity: fast}}")
    (problem,) = robot_folder.problems(str(folder))
    assert problem.endswith("joint_limits.a1.max_velocity must be a number, not 'fast' (at most 1e+06)")
    (folder / "robot.toml").write_text("")
    (folder / "seven.urdf").unlink()
    (problem,) = robot_folder.problems(str(folder))
    assert problem == "robot.urdf: is missing, and the folder has no .urdf file: name one"


ALIASES = "a0: &a0 [1]\n" + "".join(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(30))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("limits.yaml", f"{ALIASES}joint_limits: {{a1: *a30}}", "joint_limits.a1 must be a mapping, not [["),
        (
            "limits.yaml",
            f"joint_limits: {{a1: {{has_velocity_limits: true, max_velocity: {10**400}}}}}",
            "joint_limits.a1.max_velocity must be a number, not 1000",
        ),
        ("limits.yaml", "[" * 10_000, "limits.yaml cannot be read: maximum recursion depth exceeded"),
        ("hulls.json", "[" * 100_000, "hulls.json cannot be read: maximum recursion depth exceeded"),
        (
            "hulls.json",
            '{"links": {"hand": {"vertices": [[NaN, 0, 0]], "triangles": []}}}',
            "hulls.json must have vertices and triangles for each link: a vertex has a coordinate that is no finite",
        ),
        ("robot.toml", f"a = {'[' * 10_000}", "is no TOML: maximum recursion depth exceeded"),
    ],
    ids=["aliases", "a number of 400 digits", "deep YAML", "deep JSON", "no number", "deep TOML"],
)
def test_a_hostile_file_is_refused_in_one_sentence(tmp_path: Path, name: str, content: str, words: str) -> None:
    key = {"limits.yaml": "joint_limits", "hulls.json": "hulls"}.get(name, "title")
    folder = arm_folder(tmp_path, f'[robot]\n{key} = "{name}"')
    (folder / name).write_text(content)
    (problem,) = robot_folder.problems(str(folder))
    assert words in problem
    assert len(problem) < 1000


def test_a_built_in_arm_is_found_by_its_name_and_a_folder_by_its_path_or_with_another_urdf(tmp_path: Path) -> None:
    assert robot_folder.resolve("so101").model.links == so101().links
    assert robot_folder.resolve(str(arm_folder(tmp_path))).model.name == "seven"
    for name, words in (
        ("so102", r"'so102' is no folder, and no built-in arm .*so101"),
        (str(tmp_path), r"has no robot\.toml: armbridge robot import URDF drafts one"),
    ):
        with pytest.raises(DescriptionError, match=words):
            robot_folder.resolve(name)
    # Another URDF has no hulls.
    found = robot_folder.built_in("so101")
    urdf, srdf = tmp_path / "a.urdf", tmp_path / "a.srdf"
    urdf.write_text(found.model.urdf.replace('velocity="1.2"', 'velocity="10"'))
    srdf.write_text(found.model.srdf)
    other = robot_folder.load(found.folder, urdf=urdf, srdf=srdf)
    assert (other.model.hulls, other.model.parts) == ({}, {})
    assert other.hardware == found.hardware
    assert other.model.joints["shoulder_lift"].max_velocity == 1.2


def problems(folder: Path, text: str) -> tuple[str, ...]:
    path = folder / "robot.toml"
    path.write_text(text)
    with pytest.raises(RobotFileError) as refused:
        read(path)
    return refused.value.problems


MANY_CAMERAS = "".join(f"[cameras.a{n}]\nview = [0, 0, 1, 0, 0, 0]\n" for n in range(8))


def test_a_wrong_key_or_value_is_named(tmp_path: Path) -> None:
    for text, sentence in (
        ('[robot]\nurd = "x"', "robot.urd: there is no such key; did you mean urdf?"),
        ("[joints.a]\nmax_velocty = 2", "joints.a.max_velocty: there is no such key; did you mean max_velocity?"),
        ("[cameras.a]\nwith = 2", "cameras.a.with: there is no such key; did you mean width?"),
        ("[cameras.a]\nview = [0, 0, 0, 0, 0, 0]", "cameras.a.view: the camera must look at another point"),
        ("[cameras.'../a']\nview = [0, 0, 1, 0, 0, 0]", "cameras.../a.[key]: string should match pattern"),
        ("[cameras.a]\nview = [0, 0, 1, 0, 0, 0]\n" + MANY_CAMERAS, "cameras: dictionary should have at most 8"),
        ("[hardwear]", "hardwear: there is no such key; did you mean hardware?"),
        ("[gripper]\njoints = ['a']\nopen = 1", "gripper.closed: is missing"),
        ("[held_joints]\na = 'up'", "held_joints.a: input should be a valid number"),
        ("[hardware]\nkind = 'feetec'", "hardware.kind: input should be 'feetech', 'dynamixel' or 'ideal', not"),
        ("[hardware]\nkind = 'feetech'", 'hardware: the kind "feetech" needs its table [[hardware.servos]]'),
        ("[joints.a]\nmax_velocity = 0", "joints.a.max_velocity: input should be greater than 0, not 0"),
        ("[hardware]\n[[hardware.servos]]\njoint='a'\nid=1\nmodel='x'", 'hardware: the kind "ideal" has no servos'),
        ("[robot", "is no TOML"),
        ("x = 'ü'".encode("latin-1").decode("latin-1") + "#" * MAX_BYTES, f"has more than {MAX_BYTES} bytes"),
    ):
        assert any(problem.startswith(sentence) for problem in problems(tmp_path, text)), problems(tmp_path, text)


@pytest.mark.parametrize(("key", "value"), [("id", "7"), ("joint", "'a'")])
def test_two_servos_of_one_id_or_joint_and_a_missing_file_are_named(tmp_path: Path, key: str, value: str) -> None:
    with pytest.raises(RobotFileError, match=r"robot\.toml cannot be read"):
        read(tmp_path / "robot.toml")
    rows = ({"joint": "'a'", "id": "1", key: value}, {"joint": "'b'", "id": "2", key: value})
    servos = "".join(f"[[hardware.servos]]\njoint = {row['joint']}\nid = {row['id']}\nmodel = 'x'\n" for row in rows)
    (problem,) = problems(tmp_path, f"[hardware]\nkind = 'feetech'\n{servos}")
    assert f"servos[1].{key} {value} stands at servos[0] as well" in problem


def installed() -> bool:
    try:
        metadata.distribution(PACKAGE)
    except metadata.PackageNotFoundError:
        return False
    return True


needs_package = pytest.mark.skipif(not installed(), reason=f"{PACKAGE} is not installed (pip install {PACKAGE})")


def read_published(name: str) -> RobotModel:
    example = find_example(name)
    return model.load(example.urdf, example.srdf, package_directories=example.packages)


# Planning group of an arm, the number of its joints, and its tip.
ARMS = {
    "panda": ("arm", 7, "panda_hand_tcp"),
    "xarm7": ("xarm7", 7, "link_eef"),
    "kinova": ("end_effector", 6, "j2s6s200_end_effector"),
    "pr2": ("right_arm_and_torso", 8, "r_wrist_roll_link"),
    # Their SRDF has no group.
    "ur5": ("arm", 6, "wrist_3_link"),
    "ur3_gripper": ("arm", 6, "wrist_3_link"),
    "talos": ("l_arm", 7, "wrist_left_ft_tool_link"),
}


@needs_package
@pytest.mark.parametrize("name", sorted(_urdfs(_robots() or Path())))
def test_every_published_robot_is_read_as_it_is_or_refused_in_a_sentence(name: str) -> None:
    try:
        robot = read_published(name)
    except DescriptionError as refusal:
        sentence = str(refusal)
        assert sentence.startswith(("URDF /", "SRDF /", PACKAGE))
        assert name not in ARMS
        return
    for group in robot.groups.values():
        assert group.joints
        assert {robot.joints[joint].movable for joint in group.joints} == {True}
        assert group.tip_link == "" or group.tip_link in robot.links
    if name in ARMS:
        group_name, joints, tip = ARMS[name]
        assert (len(robot.groups[group_name].joints), robot.groups[group_name].tip_link) == (joints, tip)


@needs_package
def test_a_published_robot_is_loaded_by_its_name_with_ideal_joints_if_it_has_an_srdf() -> None:
    found = robot_folder.resolve("panda")
    assert found.model.gripper == model.GripperModel(("panda_finger_joint1",), 0.04, 0.0)
    assert found.hardware.kind == "ideal"
    with pytest.raises(DescriptionError, match=r"'ur10' has no SRDF.*: armbridge robot import .*/ur10_robot.urdf"):
        find_example("ur10")


def test_no_robot_is_found_that_the_package_does_not_have_nor_any_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_example("no such robot") is None
    monkeypatch.setattr(metadata, "distribution", Mock(side_effect=metadata.PackageNotFoundError("it")))
    assert find_example("panda") is None
