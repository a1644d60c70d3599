import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.interface_files import Generation, InterfaceFile, is_spelled_as_ros1, read_file
from protocol.registry import Kind, Registry


def read(text: str, kind: Kind = "msg", generation: Generation = "ros2", name: str = "Thing") -> InterfaceFile:
    return read_file(Path(f"/ws/my_msgs/{kind}/{name}.{kind}"), text, "my_msgs", kind, generation)


def rows(text: str, generation: Generation = "ros2") -> tuple[list[Any], list[Any]]:
    file = read(text, generation=generation)
    assert file.problems == []
    return file.definition["fields"], file.definition["consts"]


def problem(text: str, generation: Generation = "ros2", kind: Kind = "msg") -> str:
    (only,) = read(text, kind, generation).problems
    return str(only)


def declared(text: str) -> Any:
    """The one message, as the registry reads its rows."""
    return Registry({"my_msgs/msg/Thing": read(text).definition}).message("my_msgs/Thing")


@pytest.mark.parametrize(
    "spelled", ["float64", "float64[]", "float64[9]", "float64[<=9]", "string<=20", "wstring<=2[]"]
)
def test_types_of_primitives_are_read_with_arrays_and_bounds(spelled: str) -> None:
    assert rows(f"{spelled} data") == ([["data", spelled]], [])


def test_a_type_without_a_package_is_one_of_the_same_package() -> None:
    file = read("Point[<=3] corners\ngeometry_msgs/Pose pose")
    assert file.definition["fields"] == [["corners", "my_msgs/Point[<=3]"], ["pose", "geometry_msgs/Pose"]]
    assert [(each.type_name, each.line) for each in file.references] == [
        ("my_msgs/Point", 1),
        ("geometry_msgs/Pose", 2),
    ]


def test_comments_blank_lines_and_their_encoding_do_not_count() -> None:
    text = "\N{BYTE ORDER MARK}# all about it\r\n\r\n   # more\rint32\t a# of it\n  int32   b   # and --- this\n"
    assert rows(text) == ([["a", "int32"], ["b", "int32"]], [])
    text = b"int32 a # f\xfcr\nint32 b".decode("utf-8", "surrogateescape")
    assert rows(text)[0] == [["a", "int32"], ["b", "int32"]]
    text = b'int32 a\nstring b "f\xfcr"'.decode("utf-8", "surrogateescape")
    assert problem(text).endswith("wanted text in UTF-8")


@pytest.mark.parametrize(
    ("line", "base", "value"),
    [
        ("uint8 X=5", "uint8", 5),
        ("uint8 X = 0x1F # hex", "uint8", 31),
        ("int64 X=-9223372036854775808", "int64", -(2**63)),
        ("bool X=True", "bool", True),
        ("bool X=0", "bool", False),
        ("float32 X=-1.5e3", "float32", -1500.0),
        ("float64 X=2", "float64", 2.0),
        ('string X="a # b" # c', "string", "a # b"),
        ("string X='it\\'s'", "string", "it's"),
        ('string X="a\\"b"', "string", 'a"b'),
        ("string X=without quotes # c", "string", "without quotes"),
        ("string X=", "string", ""),
        ('string X="a = b"', "string", "a = b"),
        ('wstring X="ü"', "wstring", "ü"),
        ("string X=C:\\\\dir", "string", "C:\\\\dir"),
    ],
)
def test_constants_have_the_values_of_their_types(line: str, base: str, value: Any) -> None:
    (constant,) = declared(line).constants
    assert (constant.base, constant.name, constant.value) == (base, "X", value)
    assert type(constant.value) is type(value)


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ("int32 a 5", 5),
        ("float64 a -1", -1.0),
        ("bool a true  # c", True),
        ('string a "x"', "x"),
        ("string a hello world # c", "hello world"),
        ('string<=3 a "abc"', "abc"),
        ('string a ""', ""),
        ("int32[] a [1, 2,3 ] # c", (1, 2, 3)),
        ("int32[] a []", ()),
        ("float64[2] a [1, 0.5]", (1.0, 0.5)),
        ("bool[<=3] a [true, False, 1]", (True, False, True)),
        ("string[] a [\"a, # b\", 'c]', d]", ("a, # b", "c]", "d")),
        ("string<=2[<=2] a ['ab']", ("ab",)),
    ],
)
def test_defaults_have_the_values_of_their_types(line: str, value: Any) -> None:
    (field,) = declared(line).fields
    assert field.default == value
    assert type(field.default) is type(value)


@given(st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=12))
def test_any_quoted_text_comes_back_as_it_was(text: str) -> None:
    quoted = '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
    (field,) = declared(f"string a {quoted}  # {text}").fields
    assert field.default == text


@given(st.lists(st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=5), max_size=4))
def test_any_list_of_quoted_texts_comes_back_as_it_was(texts: list[str]) -> None:
    quoted = ["'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'" for text in texts]
    (field,) = declared(f"string[] a [{', '.join(quoted)}] # c").fields
    assert field.default == tuple(texts)


@given(st.lists(st.floats(width=32, allow_nan=False), max_size=4))
def test_any_list_of_floats_comes_back_as_it_was(numbers: list[float]) -> None:
    (field,) = declared(f"float32[] a {json.dumps(numbers).replace('Infinity', 'inf')}").fields
    assert field.default == tuple(numbers)


@given(st.text(max_size=60), st.sampled_from(["msg", "srv", "action"]), st.sampled_from(["ros1", "ros2"]))
def test_any_text_is_read_or_refused_in_sentences(text: str, kind: Kind, generation: Generation) -> None:
    for each in read(text, kind, generation).problems:
        assert "\n" not in str(each)
        assert str(each).startswith(f"/ws/my_msgs/{kind}/Thing.{kind}")


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("int32", "wanted a type, blanks and a name"),
        ("int32 # a", "wanted a type, blanks and a name"),
        ("int32 = 5", "wanted a type, blanks and a name"),
        ("float46 a", "type float46 is unknown; did you mean float64?"),
        ("int32[3 a", "wanted a type such as float64, float64[],"),
        ("a/b/C a", "wanted a type such as float64, float64[],"),
        ("int32[0] a", "a bound is at least 1, got int32[0]"),
        ("string<=0 a", "a bound is at least 1, got string<=0"),
        ("int32<=3 a", "only string and wstring have a greatest length, int32 has none"),
        ("int32 myName", "wanted a field's name such as joint_names"),
        ("int32 a__b", "wanted a field's name such as joint_names"),
        ("int32 a_", "wanted a field's name such as joint_names"),
        ("int32 limit = 5", "got limit; a default stands behind a field's name without ="),
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
        ("time a", "time is a type of ROS 1, and this is a package of ROS 2; wanted builtin_interfaces/Time"),
        ("duration[] a", "wanted builtin_interfaces/Duration"),
        ("---", "a message is not divided; only services and actions have parts"),
    ],
)
def test_a_line_that_cannot_be_read_is_told_with_file_line_text_and_remedy(line: str, sentence: str) -> None:
    told = problem(f"int32 first\n\n  {line}\nint32 last")
    assert told.startswith(f"/ws/my_msgs/msg/Thing.msg:3: {line!r}: ")
    assert sentence in told


def test_all_problems_of_a_file_are_told_and_names_that_do_not_fit() -> None:
    assert problem("int32 a\nint8 a").endswith(":2: 'int8 a': the name a is declared twice")
    assert [each.line for each in read("int33 a\nint32 b\nint32 B b\nint32[0] c").problems] == [1, 3, 4]
    (only,) = read("int32 a", name="my_thing").problems
    assert "the file's name is the type's: wanted a name such as JointNames" in str(only)


def test_a_service_has_two_parts_with_names_of_their_own() -> None:
    definition = read("int32 a\n  ---  # here\nint32 a\nint32 B=1", "srv").definition
    assert definition == {
        "kind": "srv",
        "request": {"fields": [["a", "int32"]], "consts": []},
        "response": {"fields": [["a", "int32"]], "consts": [["int32", "B", "1"]]},
    }


def test_an_action_may_have_parts_without_fields() -> None:
    definition = read("---\n---\n", "action").definition
    assert list(definition) == ["kind", "goal", "result", "feedback"]
    assert definition["feedback"] == {"fields": [], "consts": []}


@pytest.mark.parametrize(
    ("kind", "text", "count"), [("srv", "int32 a", 0), ("srv", "---\n---", 2), ("action", "---", 1)]
)
def test_a_service_or_action_with_another_number_of_parts_is_refused(kind: Kind, text: str, count: int) -> None:
    wanted = {"srv": "1 of the lines --- between request, response", "action": "2 of the lines --- between goal"}
    told = problem(text, kind=kind)
    assert wanted[kind] in told
    assert told.endswith(f"got {count}")


def test_ros1_has_times_headers_and_names_of_its_own() -> None:
    fields, constants = rows("Header header\nroslib/Header other\ntime[] T\nduration d\nint32 low=1", "ros1")
    assert fields == [["header", "std_msgs/Header"], ["other", "std_msgs/Header"], ["T", "time[]"], ["d", "duration"]]
    assert constants == [["int32", "low", "1"]]


def test_a_text_constant_of_ros1_is_all_that_follows_the_sign() -> None:
    file = read('string A=  "it\'s" # all of it  ', generation="ros1")
    (constant,) = Registry({"my_msgs/msg/Thing": file.definition}).message("my_msgs/Thing").constants
    assert constant.value == '"it\'s" # all of it'


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("int32 a 5", "ROS 1 has no defaults, and this is a package of ROS 1; there must not be 5"),
        ("int32[<=3] a", "ROS 1 has no bounds of texts and arrays"),
        ("string<=3 a", "ROS 1 has no bounds of texts and arrays"),
        ("wstring a", "ROS 1 has no wstring, and this is a package of ROS 1; wanted string"),
        ("int32 a-b", "wanted a name of letters, digits and underscores, got a-b"),
    ],
)
def test_what_only_ros2_has_is_refused_in_a_package_of_ros1(line: str, sentence: str) -> None:
    assert sentence in problem(line, "ros1")


@pytest.mark.parametrize(
    ("text", "ros1"),
    [
        ("int32 a\n  time t", True),
        ("duration[2] t # c", True),
        ("Header header", True),
        ("std_msgs/Header header", False),
        ("# time t\nint32 time", False),
        ("builtin_interfaces/Time t", False),
    ],
)
def test_a_file_that_only_ros1_reads_is_known_by_its_types(text: str, *, ros1: bool) -> None:
    assert is_spelled_as_ros1(text, has_header=False) is ros1


def test_a_package_with_a_header_of_its_own_may_be_of_either_generation() -> None:
    assert not is_spelled_as_ros1("Header header", has_header=True)
