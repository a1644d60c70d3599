import json
from pathlib import Path
from typing import Any

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


@given(st.text(max_size=60), st.sampled_from(["msg", "srv", "action"]), st.sampled_from(["ros1", "ros2"]))
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
        told = problem(f"int32 first\n\n  {line}\nint32 last")
        assert told.startswith(f"/ws/my_msgs/msg/Thing.msg:3: {line!r}: ")
        assert sentence in told


def test_all_problems_of_a_file_are_told_and_names_that_do_not_fit() -> None:
    assert problem("int32 a\nint8 a").endswith(":2: 'int8 a': the name a is declared twice")
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
        told = problem(text, kind="srv")
        assert "1 of the lines --- between request, response" in told
        assert told.endswith(got)
    told = problem("---", kind="action")
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
