import base64
import copy
import json

from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs.json import decode, encode
from protocol.messages import Stamp, complete
from protocol.strict_messages import publication_reader
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY

ODD_NUMBERS = [0, -1, 1.0, 0.5, 2**31, 2**63, 2**64, 10**400, 1e39, float("nan")]
odd_values = st.sampled_from([None, True, *ODD_NUMBERS, "", "now", "AA==", [], [1], [""], {}])


def general(type_name, value):
    return complete(REGISTRY, type_name, value, Stamp(1700000000, 250))


def frame(message, topic="/t", **more):
    return json.dumps({"op": "publish", "topic": topic, "msg": message, **more})


def read(type_name, text):
    reader = publication_reader(REGISTRY, type_name)
    return None if reader is None else reader.read(text, "/t")


def sample(type_name):
    """A complete message with one element in every array that may have one."""
    message = general(type_name, {})
    for field in REGISTRY.message(type_name).fields:
        if field.array is not None and field.array.min_length == 0 and type(message[field.name]) is list:
            element = {"string": "x", "bool": True}.get(field.base, 1) if field.primitive else general(field.base, {})
            message[field.name] = [element]
    return general(type_name, message)


def places(value):
    """Every container in a message with every key of it."""
    members = value.items() if type(value) is dict else enumerate(value)
    for key, member in members:
        yield value, key
        if type(member) in (dict, list):
            yield from places(member)


def has_no_strict_form(name, in_list=False):
    """Return true for a type with unsigned integers of 64 bits, or octets in messages in a list."""
    return any(
        (field.base == "uint64" or (in_list and field.array is not None and field.base in ("uint8", "char")))
        if field.primitive
        else has_no_strict_form(field.base, in_list or field.array is not None)
        for field in REGISTRY.message(name).fields
    )


GENERAL_NAMES = [name for name in MESSAGE_TYPES if has_no_strict_form(name)]


def test_a_complete_message_is_read_the_strict_way_unless_its_type_has_no_strict_form():
    assert (len(MESSAGE_TYPES), len(GENERAL_NAMES)) == (340, 24)
    for name in MESSAGE_TYPES:
        message = sample(name)
        encoded = read(name, frame(message))
        assert (encoded is None) == (name in GENERAL_NAMES), name
        assert encoded is None or json.loads(encoded) == json.loads(encode(message)), name


@given(st.sampled_from(MESSAGE_TYPES), st.data())
def test_the_strict_way_reads_messages_as_the_general_way(name, data):
    # With an odd value in one place.
    message = copy.deepcopy(sample(name))
    if spots := list(places(message)):
        container, key = data.draw(st.sampled_from(spots))
        container[key] = data.draw(odd_values)
    encoded = read(name, frame(message))
    if encoded is not None:
        wanted = general(name, decode(frame(message))["msg"])
        assert encoded.isascii()
        # Also in order, and with floats as floats.
        assert repr(json.loads(encoded)) == repr(json.loads(encode(wanted)))


def test_octets_as_they_go_out_are_taken_as_they_are_and_any_other_spelling_is_left_to_the_general_way():
    image = general("sensor_msgs/CompressedImage", {"format": "jpeg"})
    for octets in (b"", b"a", b"ab", b"abc", bytes(range(256))):
        message = {**image, "data": base64.b64encode(octets).decode()}
        assert read("sensor_msgs/CompressedImage", frame(message)) == encode(message)
    for data in ([1, 2], "YQ", "YQ=", "YR==", "YWJ=", "YQ==\n", "Y Q==", "YQ==YQ==", "-_==", "é", "="):
        assert read("sensor_msgs/CompressedImage", frame({**image, "data": data})) is None, data


@given(st.text())
def test_any_text_is_read_as_the_general_way_reads_it_or_left_to_it(text):
    encoded = read("std_msgs/String", frame({"data": text}))
    if encoded is not None:
        assert json.loads(encoded) == {"data": text}
        assert encoded.isascii()


def test_fields_may_come_in_any_order_and_go_out_as_declared():
    assert read("geometry_msgs/Point", frame({"z": 3, "y": 2.5, "x": -1})) == b'{"x":-1.0,"y":2.5,"z":3.0}'


EMPTY = {"data": ""}


def test_what_clients_send_along_is_taken_and_an_operation_with_anything_else_is_left_to_the_general_way():
    for more in ({}, {"id": "a"}, {"id": 7}, {"id": None}, {"latch": False, "queue_size": 100}):
        assert read("std_msgs/String", frame(EMPTY, **more)) == b'{"data":""}'
    for field, value in (
        ("latch", True),
        ("latch", 0),
        ("queue_size", -1),
        ("id", "x" * 513),
        ("id", 1.5),
        ("type", ""),
        ("fragment_size", 10),
        ("anything", 1),
    ):
        assert read("std_msgs/String", frame(EMPTY, **{field: value})) is None, field
    raw = '{"op":"publish","topic":"/t","msg":{"data":"\ud800"}}'
    for text in (
        *("", "{}", "[]", frame(EMPTY)[:-1], frame(EMPTY) + frame(EMPTY), frame(EMPTY, topic="/other")),
        *(frame(EMPTY).replace("publish", "subscribe"), frame({"data": "\ud800"}), raw, frame({"data": "\xe9"})),
    ):
        assert read("std_msgs/String", text) is None
