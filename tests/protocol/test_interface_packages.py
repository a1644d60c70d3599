import itertools
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from protocol.codecs import cdr
from protocol.errors import InterfaceFilesError, MessageError
from protocol.interface_packages import Generation, InterfaceFile, is_spelled_as_ros1, read_file, read_packages
from protocol.messages import Stamp, complete
from protocol.registry import Kind, Registry
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


def read(text: str, kind: Kind = "msg", generation: Generation = "ros2", name: str = "Thing") -> InterfaceFile:
    return read_file(Path(f"/ws/my_msgs/{kind}/{name}.{kind}"), text, "my_msgs", kind, generation)


def rows(text: str, generation: Generation = "ros2") -> tuple[list[Any], list[Any]]:
    file = read(text, generation=generation)
    assert file.problems == []
    return file.definition["fields"], file.definition["consts"]


def refusal_of(text: str, generation: Generation = "ros2", kind: Kind = "msg") -> str:
    (only,) = read(text, kind, generation).problems
    return str(only)


def declared(text: str, generation: Generation = "ros2") -> Any:
    """The one message, as the registry reads its rows."""
    return Registry({"my_msgs/msg/Thing": read(text, generation=generation).definition}).message("my_msgs/Thing")


def test_types_are_read_with_arrays_and_bounds_and_without_a_package_are_of_the_same_one() -> None:
    for spelled in ("float64", "float64[]", "float64[9]", "float64[<=9]", "string<=20", "wstring<=2[]"):
        assert rows(f"{spelled} data") == ([["data", spelled]], [])
    file = read("Point[<=3] corners\ngeometry_msgs/Pose pose")
    assert file.definition["fields"] == [["corners", "my_msgs/Point[<=3]"], ["pose", "geometry_msgs/Pose"]]
    references = [(each.type_name, each.line) for each in file.references]
    assert references == [("my_msgs/Point", 1), ("geometry_msgs/Pose", 2)]


def test_comments_blank_lines_and_their_encoding_do_not_count() -> None:
    text = "\N{BYTE ORDER MARK}# all about it\r\n\r\n   # more\rint32\t a# of it\n  int32   b   # and --- this\n"
    assert rows(text) == ([["a", "int32"], ["b", "int32"]], [])
    text = b"int32 a # f\xfcr\nint32 b".decode("utf-8", "replace")
    assert rows(text)[0] == [["a", "int32"], ["b", "int32"]]


def test_constants_and_defaults_have_the_values_of_their_types() -> None:
    for line, value in {
        "uint8 X=5": 5,
        "uint8 X = 0x1F # hex": 31,
        "int64 X=-9223372036854775808": -(2**63),
        "bool X=True": True,
        "bool X=0": False,
        "float32 X=-1.5e3": -1500.0,
        "float64 X=2": 2.0,
        'string X="a # b" # c': "a # b",
        "string X='it\\'s'": "it's",
        'string X="a\\"b"': 'a"b',
        "string X=": "",
        "string X=without quotes # c": "without quotes",
        'string X="a = b"': "a = b",
        'wstring X="ü"': "ü",
        "string X=C:\\\\dir": "C:\\\\dir",
    }.items():
        (constant,) = declared(line).constants
        assert (constant.base, constant.name, repr(constant.value)) == (line.split()[0], "X", repr(value))
    for line, value in {
        "int32 a 5": 5,
        "float64 a -1": -1.0,
        "bool a true  # c": True,
        'string a "x"': "x",
        'string a ""': "",
        "string a hello world # c": "hello world",
        'string<=3 a "abc"': "abc",
        "string<=2[<=2] a ['ab']": ("ab",),
        "int32[] a [1, 2,3 ] # c": (1, 2, 3),
        "int32[] a []": (),
        "string[] a []": (),
        "float64[2] a [1, 0.5]": (1.0, 0.5),
        "bool[<=3] a [true, False, 1]": (True, False, True),
        "string[] a [\"a, # b\", 'c]', d]": ("a, # b", "c]", "d"),
    }.items():
        (field,) = declared(line).fields
        assert repr(field.default) == repr(value), line


@given(
    st.lists(st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=9), min_size=1, max_size=4),
    st.lists(st.floats(width=32, allow_nan=False), max_size=4),
    st.sampled_from("'\""),
)
def test_any_quoted_texts_and_lists_of_floats_come_back_as_they_were(
    texts: list[str], numbers: list[float], quote: str
) -> None:
    quoted = [quote + text.replace("\\", "\\\\").replace(quote, f"\\{quote}") + quote for text in texts]
    floats = json.dumps(numbers).replace("Infinity", "inf")
    text = f"string a {quoted[0]}  # {texts[0]}\nstring[] b [{', '.join(quoted)}] # c\nfloat32[] d {floats}"
    assert [field.default for field in declared(text).fields] == [texts[0], tuple(texts), tuple(numbers)]


PIECE = r"""int32|string<=5|my_msgs/Thing|float64|data|a|1e39|---|<=4|-1\]|[\[\]= "'\\,#\n\r\t\0é]"""


@given(
    st.text(max_size=60) | st.from_regex(f"({PIECE}){{0,30}}", fullmatch=True),
    st.sampled_from(["msg", "srv", "action"]),
    st.sampled_from(["ros1", "ros2"]),
)
def test_any_text_is_read_or_refused_in_sentences(text: str, kind: Kind, generation: Generation) -> None:
    for each in map(str, read(text, kind, generation).problems):
        assert "\n" not in each
        assert each.startswith(f"/ws/my_msgs/{kind}/Thing.{kind}")


def test_a_line_that_cannot_be_read_is_told_with_file_line_text_and_remedy() -> None:
    for line, sentence in (
        ("int32", "wanted a type, blanks and a name"),
        ("int32 # a", "wanted a type, blanks and a name"),
        ("int32 = 5", "wanted a type, blanks and a name"),
        ("float46 a", "type float46 is unknown; did you mean float64?"),
        ("int32[3 a", "wanted a type such as float64, float64[],"),
        ("a/b/C a", "wanted a type such as float64, float64[],"),
        ("int32[0] a", "a bound is at least 1, got int32[0]"),
        ("string<=0 a", "a bound is at least 1, got string<=0"),
        ("int32<=3 a", "only string and wstring have a greatest length, int32 has none"),
        ("int32 a-b", "wanted a name of letters, digits and underscores, got a-b"),
        ("int32 a 1.5", "wanted int32 (-2147483648 to 2147483647), got 1.5"),
        ("uint8 A=256", "wanted uint8 (0 to 255), got 256"),
        ("uint8 A=", "wanted uint8 (0 to 255), got nothing"),
        ("bool a yes", "wanted bool, got yes"),
        ("float32 a 1e39", "wanted float32, got 1e39"),
        ('string<=3 a "abcd"', 'wanted string of at most 3 characters, got "abcd"'),
        ('string a "b', "wanted text in quotes"),
        ("int32[] a 5", "the default of an array is a list such as [1, 2], not 5"),
        ("int32[] a [1, 2", "the default of an array is a list such as [1, 2], not [1, 2"),
        ("int32[2] a [1]", "wanted exactly 2 elements, got 1"),
        ("int32[<=1] a [1, 2]", "wanted at most 1 elements, got 2"),
        ("uint8[] a [1, 300]", "wanted uint8 (0 to 255), got 300"),
        ("Point a 5", "only fields of primitive types have defaults, and my_msgs/Point is none"),
        ("Point A=5", "a constant is of a primitive type without bounds, not of my_msgs/Point"),
        ("int32[] A=[1]", "a constant is of a primitive type without bounds, not of int32[]"),
        ("string<=3 A=abc", "a constant is of a primitive type without bounds, not of string<=3"),
        ("---", "a message is not divided; only services and actions have parts"),
    ):
        told = refusal_of(f"int32 first\n\n  {line}\nint32 last")
        assert told.startswith(f"/ws/my_msgs/msg/Thing.msg:3: {line!r}: ")
        assert sentence in told


def test_all_problems_of_a_file_are_told_and_names_that_do_not_fit() -> None:
    assert refusal_of("int32 a\nint8 a").endswith(":2: 'int8 a': the name a is declared twice")
    assert [each.line for each in read("int33 a\nint32 b\nint32 B b\nint32[0] c").problems] == [1, 3, 4]
    (only,) = read("int32 a", name="my-thing").problems
    assert "the file's name is the type's: wanted a name of letters, digits and underscores" in str(only)


def test_services_and_actions_have_parts_with_names_of_their_own_perhaps_without_fields() -> None:
    assert read("int32 a\n  ---  # here\nint32 a\nint32 B=1", "srv").definition == {
        "kind": "srv",
        "request": {"fields": [["a", "int32"]], "consts": []},
        "response": {"fields": [["a", "int32"]], "consts": [["int32", "B", "1"]]},
    }
    definition = read("---\n---\n", "action").definition
    assert list(definition) == ["kind", "goal", "result", "feedback"]
    assert definition["feedback"] == {"fields": [], "consts": []}


def test_a_service_or_action_with_another_number_of_parts_is_refused() -> None:
    for text, got in (("int32 a", "got 0"), ("---\n---", "got 2")):
        told = refusal_of(text, kind="srv")
        assert "1 of the lines --- between request, response" in told
        assert told.endswith(got)
    told = refusal_of("---", kind="action")
    assert "2 of the lines --- between goal" in told
    assert told.endswith("got 1")


def test_ros1_has_times_headers_and_names_of_its_own_and_a_text_constant_is_all_behind_the_sign() -> None:
    fields, constants = rows("Header header\nroslib/Header other\ntime[] T\nduration d\nint32 low=1", "ros1")
    assert fields == [["header", "std_msgs/Header"], ["other", "std_msgs/Header"], ["T", "time[]"], ["d", "duration"]]
    assert constants == [["int32", "low", "1"]]
    (constant,) = declared('string A=  "it\'s" # all of it  ', "ros1").constants
    assert constant.value == '"it\'s" # all of it'


def test_a_file_that_only_ros1_reads_is_known_by_its_types() -> None:
    for text in ("int32 a\n  time t", "duration[2] t # c", "Header header"):
        assert is_spelled_as_ros1(text, has_header=False), text
    for text in ("std_msgs/Header header", "# time t\nint32 time", "builtin_interfaces/Time t"):
        assert not is_spelled_as_ros1(text, has_header=False), text
    # A package with a header of its own may be of either generation.
    assert not is_spelled_as_ros1("Header header", has_header=True)
