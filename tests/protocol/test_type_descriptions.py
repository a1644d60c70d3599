import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from protocol.errors import InterfaceError
from protocol.registry import Registry, read_ros2
from protocol.type_descriptions import full_text, message_hash, service_hash, typedefs
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY

SEPARATOR = "=" * 80


def dependencies(registry, name):
    inner = {field.base for field in registry.message(name).fields if not field.primitive}
    return inner.union(*(dependencies(registry, each) for each in inner))


def test_a_text_is_the_definition_and_those_of_what_it_refers_to():
    header = f"builtin_interfaces/Time stamp\nstring frame_id\n\n{SEPARATOR}\nMSG: builtin_interfaces/Time\n"
    assert full_text(REGISTRY, "std_msgs/Header") == f"{header}int32 sec\nuint32 nanosec\n"
    # ROS 1 has no sections for its times.
    assert full_text(REGISTRY, "std_msgs/Header", "ros1") == "uint32 seq\ntime stamp\nstring frame_id\n"
    assert full_text(REGISTRY, "rcl_interfaces/Log", "ros1").count("time stamp\n") == 1


def test_constants_defaults_and_bounds_are_written_as_definitions_write_them():
    for name, line, in_ros1 in (
        ("shape_msgs/SolidPrimitive", "uint8 BOX=1", "uint8 BOX=1"),
        ("shape_msgs/SolidPrimitive", "float64[<=3] dimensions", "float64[] dimensions"),
        ("geometry_msgs/Quaternion", "float64 w 1.0", "float64 w"),
        ("rcl_interfaces/ParameterDescriptor", "bool read_only false", "bool read_only"),
        ("rcl_interfaces/ParameterDescriptor", "Range[<=1] floating_point_range", "Range[] floating_point_range"),
        ("control_msgs/VDA5050SafetyState", 'string NONE="none"', "string NONE=none"),
    ):
        assert f"{line}\n" in full_text(REGISTRY, name), line
        assert f"{in_ros1}\n" in full_text(REGISTRY, name, "ros1"), line


def test_a_parser_finds_every_type_and_every_field_in_the_text():
    assert len(MESSAGE_TYPES) == 340
    for name in sorted(MESSAGE_TYPES)[::3]:
        found = get_types_from_msg(full_text(REGISTRY, name), name)
        assert set(found) == {name, *dependencies(REGISTRY, name)}, name
        for each, (_, fields) in found.items():
            assert [field for field, _ in fields] == [field.name for field in REGISTRY.message(each).fields], name


def test_typedefs_begin_with_the_type_and_go_depth_first():
    names = [each["type"] for each in typedefs(REGISTRY, "geometry_msgs/PoseStamped")]
    inner = ["std_msgs/Header", "builtin_interfaces/Time", "geometry_msgs/Pose", "geometry_msgs/Point"]
    assert names == ["geometry_msgs/PoseStamped", *inner, "geometry_msgs/Quaternion"]
    assert typedefs(REGISTRY, "std_msgs/Header", "ros1")[1]["fieldnames"] == ["secs", "nsecs"]


def test_a_typedef_tells_the_fields_by_name_type_length_and_example_and_constants_as_text():
    definition = typedefs(REGISTRY, "sensor_msgs/CameraInfo")[0]
    columns = (definition[name] for name in ("fieldnames", "fieldtypes", "fieldarraylen", "examples"))
    assert list(zip(*columns, strict=True))[:6] == [
        ("header", "std_msgs/Header", -1, "{}"),
        ("height", "uint32", -1, "0"),
        ("width", "uint32", -1, "0"),
        ("distortion_model", "string", -1, ""),
        ("d", "double", 0, "[]"),
        ("k", "double", 9, "[]"),
    ]
    definition = typedefs(REGISTRY, "shape_msgs/SolidPrimitive")[0]
    # A bounded array is told as one of any length.
    assert definition["fieldarraylen"][1] == 0
    assert (definition["constnames"][0], definition["constvalues"][0]) == ("BOX", "1")


def test_every_field_type_with_a_slash_has_one_typedef_and_is_spelled_in_the_clients_dialect():
    for dialect, name in ((dialect, name) for dialect in ("ros2", "ros1") for name in MESSAGE_TYPES):
        definitions = typedefs(REGISTRY, name, dialect)
        known = {each["type"] for each in definitions}
        kinds = {kind for each in definitions for kind in each["fieldtypes"]}
        assert len(known) == len(definitions), name
        assert {kind for kind in kinds if "/" in kind} <= known, name
        assert dialect == "ros2" or not any(kind.startswith("builtin_interfaces/") for kind in kinds), name


# As ROS 2 Jazzy has them (share/<package>/<msg or srv>/<name>.json), and its documentation prints some.
PUBLISHED = {
    "std_msgs/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    # Without fields, and with a char.
    "std_msgs/Empty": "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "std_msgs/Char": "3ad2d04dd29ba19d04b16659afa3ccaedd691914b02a64e82e252f2fa6a586a9",
    "sensor_msgs/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
}
PUBLISHED_SERVICES = {
    "std_srvs/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "std_srvs/SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "std_srvs/Empty": "5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19",
    "action_msgs/CancelGoal": "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
    "example_interfaces/AddTwoInts": "e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
}
# test_msgs/Fibonacci of ROS 2 Kilted as rosidl hashed it (share/test_msgs/action/Fibonacci.json), and its definition.
FIBONACCI = {
    "SendGoal": "d807633803e38e164276573cd97e9fbd71e109c290bbf4cc312a0a1c9da7bbd9",
    "GetResult": "5d30fdeb21d20e117aa5f36c7b4f0b6874f1a8cf7a9c038d58f1156c5737b209",
    "FeedbackMessage": "37487bae8cea358366b97003c1ef1ca7ce7c08df36f9e8cca496624226aee64e",
}
SEQUENCE = {"fields": [["sequence", "int32[]"]], "consts": []}
ORDER = {"fields": [["order", "int32"]], "consts": []}


def test_messages_services_and_what_goes_with_an_action_have_the_hashes_that_ros_publishes() -> None:
    action = {"kind": "action", "goal": ORDER, "result": SEQUENCE, "feedback": SEQUENCE}
    registry = Registry({**read_ros2(), "test_msgs/action/Fibonacci": action})
    parts = {f"test_msgs/action/Fibonacci_{part}": digest for part, digest in FIBONACCI.items()}
    for name, digest in (PUBLISHED | PUBLISHED_SERVICES | parts).items():
        hash_of = message_hash if name in PUBLISHED or name.endswith("FeedbackMessage") else service_hash
        assert hash_of(registry, name) == f"RIHS01_{digest}", name


def test_every_message_that_rosbags_knows_too_has_the_same_hash_there() -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    # rosbags takes a char for a type of its own, which no definition in ROS 2 makes one.
    with_char = {"std_msgs/msg/Char", "service_msgs/msg/ServiceEventInfo"}
    shared = {name for name in REGISTRY.type_names() if name in store.fielddefs} - with_char
    assert len(shared) > 100
    assert [name for name in shared if message_hash(REGISTRY, name) != store.hash_rihs01(name)] == []


def test_an_unknown_type_has_no_text_typedefs_and_hash() -> None:
    for tell in (full_text, typedefs, message_hash, service_hash):
        with pytest.raises(InterfaceError):
            tell(REGISTRY, "std_msgs/Nothing")
    with pytest.raises(InterfaceError):
        service_hash(REGISTRY, "std_msgs/String")
