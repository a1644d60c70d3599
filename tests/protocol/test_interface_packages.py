import itertools
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from protocol.codecs import cdr
from protocol.errors import InterfaceFilesError, MessageError
from protocol.interface_packages import read_packages
from protocol.messages import Stamp, complete
from protocol.strict_messages import publication_reader
from protocol.type_descriptions import full_text, message_hash, service_hash
from tests.conformance.cases import INTERFACES
from tests.helpers.messages import REGISTRY, made_up


def package(folder: Path, *files: tuple[str, str], tool: str | None = "ament_cmake", name: str | None = None) -> Path:
    """Write a package with files, each a path such as ``msg/Thing.msg`` and its text."""
    folder.mkdir(parents=True, exist_ok=True)
    if tool is not None:
        text = f"<package><name>{name or folder.name}</name><buildtool_depend>{tool}</buildtool_depend></package>"
        (folder / "package.xml").write_text(text)
    for path, content in files:
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(content)
    return folder


def problems(*folders: Path) -> list[str]:
    with pytest.raises(InterfaceFilesError) as refusal:
        read_packages(folders)
    told = [str(each) for each in refusal.value.problems]
    assert str(refusal.value).splitlines()[1:] == [f"  {each}" for each in told]
    return told


def problem(*folders: Path) -> str:
    (only,) = problems(*folders)
    return only


def test_a_package_is_read_with_messages_services_and_actions(tmp_path: Path) -> None:
    files = ("msg/A.msg", "int32 a"), ("srv/B.srv", "A a\n---\n"), ("action/C.action", "---\nA a\n---\n")
    interfaces = read_packages([package(tmp_path / "my_msgs", *files)])
    assert list(interfaces.ros2) == ["my_msgs/msg/A", "my_msgs/srv/B", "my_msgs/action/C"]
    assert interfaces.packages == ("my_msgs",)
    registry = interfaces.registry()
    assert registry.service("my_msgs/B").request.fields[0].base == "my_msgs/msg/A"
    assert registry.action("my_msgs/C").result.fields[0].base == "my_msgs/msg/A"
    assert registry.knows("std_msgs/String")


def test_files_are_read_from_folders_by_other_usual_names_and_the_rest_is_named(tmp_path: Path) -> None:
    files = ("messages/A.msg", "int32 a"), ("services/B.srv", "---\n"), ("actions/C.action", "---\n---\n")
    folder = package(tmp_path / "my_msgs", *files, ("more/D.msg", "int32 a"))
    interfaces = read_packages([folder])
    assert list(interfaces.ros2) == ["my_msgs/msg/A", "my_msgs/srv/B", "my_msgs/action/C"]
    assert interfaces.unread == (folder / "more" / "D.msg",)


def test_package_xml_names_the_package_else_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = package(tmp_path / "some_clone", ("msg/A.msg", ""), name="my_msgs")
    monkeypatch.chdir(package(tmp_path / "your_msgs", ("msg/A.msg", ""), tool=None))
    assert list(read_packages([named, Path()]).ros2) == ["my_msgs/msg/A", "your_msgs/msg/A"]


def test_a_workspace_is_looked_through_for_packages_but_not_inside_of_them_nor_in_circles(
    tmp_path: Path,
) -> None:
    package(tmp_path / "elsewhere" / "one_msgs", ("msg/A.msg", "two_msgs/A a"))
    source = tmp_path / "src"
    package(source / "two_msgs", ("msg/A.msg", "int32 a"))
    package(source / "two_msgs" / "test" / "three_msgs", ("msg/A.msg", "not read"))
    package(source / "tools")
    package(source / "old" / "four_msgs", ("msg/A.msg", "not read"))
    (source / "old" / "COLCON_IGNORE").touch()
    (source / "one").symlink_to(tmp_path / "elsewhere")
    for name in ("back", "again", "once_more"):
        (source / name).symlink_to(source)
    assert list(read_packages([source]).ros2) == ["one_msgs/msg/A", "two_msgs/msg/A"]


def test_files_that_an_install_has_beside_them_are_left_alone(tmp_path: Path) -> None:
    generated = ("srv/B_Request.msg", "int32 a"), ("srv/B.idl", "module"), ("msg/A.json", "{")
    folder = package(tmp_path / "my_msgs", ("srv/B.srv", "int32 a\n---"), *generated)
    assert list(read_packages([folder]).ros2) == ["my_msgs/srv/B"]


@pytest.mark.parametrize(
    ("tools", "text", "ros1"),
    [
        (["catkin"], "int32 a", True),
        (["ament_cmake"], "int32 a", False),
        (["ament_cmake_ros"], "int32 a", False),
        ([], "int32 a", False),
        ([], "time a", True),
        ([], "Header a", True),
        (["catkin", "ament_cmake"], "time a", True),
    ],
)
def test_build_tool_or_files_tell_the_generation(tmp_path: Path, tools: list[str], text: str, *, ros1: bool) -> None:
    tool = "</buildtool_depend><buildtool_depend>".join(tools) or None
    interfaces = read_packages([package(tmp_path / "my_msgs", ("msg/A.msg", text), tool=tool)])
    assert ("my_msgs/msg/A" in interfaces.ros1, "my_msgs/msg/A" in interfaces.ros2) == (ros1, not ros1)


def test_an_action_of_ros1_has_its_seven_messages_also_where_a_build_has_written_them(tmp_path: Path) -> None:
    files = ("action/Do.action", "int32 a\n---\n---\n"), ("msg/DoGoal.msg", "# generated\nint32 a")
    interfaces = read_packages([package(tmp_path / "my_msgs", *files, tool="catkin")])
    assert len(interfaces.ros1) == 8
    assert interfaces.registry().message("my_msgs/DoActionGoal").fields[2].base == "my_msgs/msg/DoGoal"


def test_all_problems_of_all_packages_are_told(tmp_path: Path) -> None:
    package(tmp_path / "a_msgs", ("msg/A.msg", "int33 a\nint32 b-c"), ("srv/C.srv", ""))
    package(tmp_path / "b_msgs", ("msg/A.msg", "int32[0] a"))
    told = problems(tmp_path, tmp_path / "nowhere")
    places = [each.split("/")[-1].split(" ")[0] for each in told]
    assert places == ["nowhere:", "A.msg:1:", "A.msg:2:", "C.srv:", "A.msg:1:"]


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("geometry_msgs/Pont a", "geometry_msgs/Point"),
        ("std_msgs/Point a", "geometry_msgs/Point"),
        ("Pose a", "geometry_msgs/Pose"),
        ("Thingy a", "my_msgs/Thing"),
    ],
)
def test_a_type_that_does_not_exist_is_told_with_the_nearest(tmp_path: Path, line: str, meant: str) -> None:
    told = problem(package(tmp_path / "my_msgs", ("msg/A.msg", f"int32 b\n{line}"), ("msg/Thing.msg", "")))
    assert told.endswith(f"my_msgs/msg/A.msg:2: {line!r}: {told.split(': ')[-1]}")
    assert told.endswith(f"is unknown; did you mean {meant}?")


def test_types_of_ros2_alone_are_unknown_to_a_package_of_ros1(tmp_path: Path) -> None:
    folder = package(tmp_path / "my_msgs", ("msg/A.msg", "builtin_interfaces/Time a"), tool="catkin")
    assert "type builtin_interfaces/Time is unknown" in problem(folder)


def test_a_type_that_contains_itself_is_refused(tmp_path: Path) -> None:
    files = ("msg/A.msg", "B b"), ("msg/B.msg", "int32 a\nC[] c"), ("msg/C.msg", "A a"), ("msg/D.msg", "D d")
    told = problems(package(tmp_path / "my_msgs", *files))
    assert [each.partition(": a type may not contain itself: ")[2].replace("my_msgs/", "") for each in told] == [
        "A contains B contains C contains A",
        "B contains C contains A contains B",
        "C contains A contains B contains C",
        "D contains D",
    ]


def test_a_folder_without_interfaces_or_with_a_bad_package_xml_is_refused(tmp_path: Path) -> None:
    assert problem(package(tmp_path / "tools")).endswith("has msg/*.msg, srv/*.srv or action/*.action files")
    assert problem(tmp_path / "nowhere").endswith("nowhere: wanted a folder with ROS packages, and there is none")
    folder = package(tmp_path / "my_msgs", ("msg/A.msg", ""))
    (folder / "package.xml").write_text("<package>\n<name>my_msgs</nam>")
    assert "my_msgs/package.xml:2: is no XML" in problem(folder)
    told = problem(package(tmp_path / "my-msgs", ("msg/A.msg", "")))
    assert told.endswith("my-msgs/package.xml: 'my-msgs': wanted a package's name of letters, digits and underscores")


def test_two_files_that_define_a_type_alike_are_one_and_otherwise_are_refused(tmp_path: Path) -> None:
    one = package(tmp_path / "src" / "my_msgs", ("msg/A.msg", "int32 a # first\nint32 B=0x10"))
    two = package(tmp_path / "install" / "my_msgs", ("msg/A.msg", "int32 a\nint32 B = 16"))
    assert list(read_packages([one, two]).ros2) == ["my_msgs/msg/A"]
    package(two, ("msg/A.msg", "int64 a"))
    assert problem(one, two).endswith(f"defines my_msgs/msg/A otherwise than {one}/msg/A.msg does; remove one of them")


POINT = "float64 x\nfloat64 y\nfloat64 z"


def test_a_packaged_type_stays_as_it_is(tmp_path: Path) -> None:
    folder = package(tmp_path / "geometry_msgs", ("msg/Point.msg", f"{POINT}\nint32 w"), ("msg/New.msg", "Point p"))
    interfaces = read_packages([folder])
    assert (list(interfaces.ros2), interfaces.known) == (["geometry_msgs/msg/New"], ("geometry_msgs/msg/Point",))
    assert len(interfaces.registry().message("geometry_msgs/Point").fields) == 3
    assert interfaces.registry().knows("geometry_msgs/New")


USER = read_packages([INTERFACES]).registry()
LAB = ("msg/Sample", "msg/Tag", "srv/Measure_Request", "srv/Measure_Response", "action/Scan_Goal", "action/Scan_Result")
MESSAGES = [*(f"lab_msgs/{name}" for name in LAB), "old_lab_msgs/msg/Reading", "old_lab_msgs/msg/SweepActionGoal"]


def test_messages_of_the_users_types_go_through_cdr_unchanged() -> None:
    for name, seed in itertools.product(MESSAGES, range(20)):
        message = made_up(USER, name, seed)
        octets = cdr.serialize(USER, name, message)
        assert cdr.deserialize(USER, name, octets) == message, (name, seed)
        assert complete(USER, name, message, Stamp(1, 2)) == message, (name, seed)


@given(st.text(st.characters(exclude_categories=["Cs"]), max_size=13))
def test_the_strict_form_takes_a_text_if_it_has_no_more_characters_than_its_bound(text: str) -> None:
    reader = publication_reader(USER, "lab_msgs/msg/Tag")
    assert reader is not None
    tag = {"text": text, "level": 0, "since": {"sec": 0, "nanosec": 0}}
    frame = json.dumps({"op": "publish", "topic": "/t", "msg": tag}, ensure_ascii=False)
    assert (reader.read(frame, "/t") is not None) == (len(text) <= 10 and text.isascii())


def test_text_in_cdr_that_is_longer_than_its_bound_or_wide_and_no_utf_16_is_refused() -> None:
    tag = complete(USER, "lab_msgs/Tag", {}, Stamp(1, 2))
    octets = cdr.serialize(USER, "lab_msgs/Tag", {**tag, "text": "eleven here"})
    with pytest.raises(MessageError, match="wanted string of at most 10 characters, got 11"):
        cdr.deserialize(USER, "lab_msgs/Tag", octets)
    octets = cdr.serialize(REGISTRY, "example_interfaces/WString", {"data": "a"})
    assert octets == cdr.HEADER + b"\x01\0\0\0a\0"
    with pytest.raises(MessageError, match="wanted text in UTF-16"):
        cdr.deserialize(REGISTRY, "example_interfaces/WString", octets[:-2] + b"\x00\xd8")


# Without wide text, which neither reader has.
LINES = """\
string UNIT="mm # per \\"turn\\""
float64 SMALL=1e-30
string<=8 name "it's # ü"
float64[3] offset [0.0, 0.5, 1e-7]
int32[<=4] counts [1, 2]
string<=4[<=2] tags ["a, b", 'c']
uint8[] raw [1, 2, 255]
bool[] ready [true, False]
string[] plain
std_msgs/Header header
"""


def test_the_text_of_a_users_type_is_read_by_other_programs_with_the_same_hash(tmp_path: Path) -> None:
    registry = read_packages([package(tmp_path / "my_msgs", ("msg/A.msg", LINES))]).registry()
    text = full_text(registry, "my_msgs/A")
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(text, "my_msgs/msg/A"))
    assert store.hash_rihs01("my_msgs/msg/A") == message_hash(registry, "my_msgs/A")
    message = complete(registry, "my_msgs/A", {}, Stamp(1, 2))
    octets = cdr.serialize(registry, "my_msgs/A", message)
    decoded = generate_dynamic("my_msgs/A", text)["my_msgs/A"](octets)
    assert (decoded.name, decoded.offset, decoded.tags) == (message["name"], message["offset"], message["tags"])


def test_a_bound_of_text_changes_the_hash(tmp_path: Path) -> None:
    def hashed(line: str) -> tuple[str, str]:
        folder = package(tmp_path / "my_msgs", ("msg/A.msg", line), ("srv/B.srv", f"{line}\n---\n"))
        registry = read_packages([folder]).registry()
        return message_hash(registry, "my_msgs/A"), service_hash(registry, "my_msgs/B")

    kinds = ["string a", "string<=3 a", "string<=4 a", "wstring a", "wstring<=3 a", "string<=3[] a", "string<=3[2] a"]
    for hashes in zip(*map(hashed, kinds), strict=True):
        assert len(set(hashes)) == len(kinds)
    assert hashed("string<=3 a 'x'") == hashed("string<=3 a")
