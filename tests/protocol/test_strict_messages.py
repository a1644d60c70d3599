import base64
import copy
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol import messages
from protocol.codecs.json import decode, encode
from protocol.messages import BUDGET, MAX_VALUES, Stamp
from protocol.strict_messages import PublicationReader, strict_type
from tests.helpers.messages import MESSAGE_TYPES, REGISTRY

RECEIVED = Stamp(1700000000, 250)

STAMP = {"sec": 1, "nanosec": 2}
HEADER = {"stamp": STAMP, "frame_id": "base_link"}
POINT = {"positions": [1.0], "velocities": [], "accelerations": [], "effort": [], "time_from_start": STAMP}
TRAJECTORY = {"header": HEADER, "joint_names": ["a"], "points": [POINT, POINT]}

ODD_NUMBERS = [0, -1, 1.0, 0.5, 2**31, 2**63, 2**64, 10**400, 1e39, float("nan")]
odd_values = st.sampled_from([None, True, *ODD_NUMBERS, "", "now", "AA==", [], [1], [""], {}])


def strict(type_name, value):
    kind = strict_type(REGISTRY, type_name)
    return None if kind is None else kind.complete(value)


def general(type_name, value):
    BUDGET.renew(type_name, MAX_VALUES, MAX_VALUES)
    return messages._message_shape(REGISTRY, type_name).complete(value, RECEIVED)


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


def test_a_complete_message_goes_the_strict_way_unless_its_type_has_no_strict_form():
    assert (len(MESSAGE_TYPES), len(GENERAL_NAMES)) == (340, 24)
    samples = {name: sample(name) for name in MESSAGE_TYPES}
    taken = {name: strict(name, message) for name, message in samples.items()}
    assert [name for name, message in taken.items() if message is None] == GENERAL_NAMES
    for name in taken.keys() - GENERAL_NAMES:
        assert repr(taken[name]) == repr(samples[name]), name
        assert taken[name] is not samples[name], name


def changed(name, data):
    """A complete message of a type with an odd value in one place."""
    message = copy.deepcopy(sample(name))
    spots = list(places(message))
    if spots:
        container, key = data.draw(st.sampled_from(spots))
        container[key] = data.draw(odd_values)
    return message


@given(st.sampled_from(MESSAGE_TYPES), st.data())
def test_the_strict_way_and_the_general_way_complete_messages_equally(name, data):
    message = changed(name, data)
    taken = strict(name, message)
    if taken is not None:
        assert repr(taken) == repr(general(name, message))


def test_nothing_of_what_came_is_shared():
    taken = strict("trajectory_msgs/JointTrajectory", TRAJECTORY)
    mine = {id(container[key]) for container, key in places(TRAJECTORY) if type(container[key]) in (dict, list)}
    theirs = {id(container[key]) for container, key in places(taken) if type(container[key]) in (dict, list)}
    assert not mine & theirs


def image(data):
    return general("sensor_msgs/CompressedImage", {"format": "jpeg"}) | {"data": data}


@pytest.mark.parametrize("octets", [b"", b"a", b"ab", b"abc", bytes(range(256))])
def test_octets_as_they_go_out_are_taken_as_they_are(octets):
    message = image(base64.b64encode(octets).decode())
    assert strict("sensor_msgs/CompressedImage", message) == message


@pytest.mark.parametrize("data", [[1, 2], "YQ", "YQ=", "YR==", "YWJ=", "YQ==\n", "Y Q==", "YQ==YQ==", "-_==", "é", "="])
def test_octets_of_any_other_spelling_are_left_to_the_general_way(data):
    assert strict("sensor_msgs/CompressedImage", image(data)) is None


# Reading JSON.


def frame(message, topic="/t", **more):
    return json.dumps({"op": "publish", "topic": topic, "msg": message, **more})


def read(type_name, text, topic="/t"):
    kind = strict_type(REGISTRY, type_name)
    return None if kind is None else PublicationReader(kind).read(text, topic)


def test_a_complete_message_is_read_the_strict_way_unless_its_type_has_no_strict_form():
    encoded = {name: read(name, frame(sample(name))) for name in MESSAGE_TYPES}
    assert [name for name, octets in encoded.items() if octets is None] == GENERAL_NAMES
    for name in encoded.keys() - GENERAL_NAMES:
        assert json.loads(encoded[name]) == json.loads(encode(sample(name))), name


@given(st.sampled_from(MESSAGE_TYPES), st.data())
def test_what_is_read_from_json_is_what_the_general_way_makes_of_it(name, data):
    text = frame(changed(name, data))
    encoded = read(name, text)
    if encoded is not None:
        wanted = general(name, decode(text)["msg"])
        assert encoded.isascii()
        # Also in order, and with floats as floats.
        assert repr(json.loads(encoded)) == repr(json.loads(encode(wanted)))


@given(st.text())
def test_any_text_is_read_as_the_general_way_reads_it_or_left_to_it(text):
    encoded = read("std_msgs/String", json.dumps({"op": "publish", "topic": "/t", "msg": {"data": text}}))
    if encoded is not None:
        assert json.loads(encoded) == {"data": text}
        assert encoded.isascii()


def test_fields_may_come_in_any_order_and_go_out_as_declared():
    assert read("geometry_msgs/Point", frame({"z": 3, "y": 2.5, "x": -1})) == b'{"x":-1.0,"y":2.5,"z":3.0}'


EMPTY = {"data": ""}


@pytest.mark.parametrize("more", [{}, {"id": "a"}, {"id": 7}, {"id": None}, {"latch": False, "queue_size": 100}])
def test_what_clients_send_along_is_taken(more):
    assert read("std_msgs/String", frame(EMPTY, **more)) == b'{"data":""}'


@pytest.mark.parametrize(
    "more",
    [
        {"latch": True},
        {"latch": 0},
        {"queue_size": -1},
        {"id": "x" * 513},
        {"id": 1.5},
        {"type": ""},
        {"fragment_size": 10},
        {"anything": 1},
    ],
)
def test_an_operation_with_anything_else_is_left_to_the_general_way(more):
    assert read("std_msgs/String", frame(EMPTY, **more)) is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        frame(EMPTY)[:-1],
        frame(EMPTY) + frame(EMPTY),
        frame(EMPTY, topic="/other"),
        frame(EMPTY).replace("publish", "subscribe"),
        frame({"data": "\ud800"}),
        '{"op":"publish","topic":"/t","msg":{"data":"\ud800"}}',
        frame({"data": "\xe9"}),
    ],
)
def test_a_frame_that_is_no_such_operation_is_left_to_the_general_way(text):
    assert read("std_msgs/String", text) is None
