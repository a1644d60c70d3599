import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from protocol.codecs import cdr
from protocol.codecs.cbor import with_octets
from protocol.messages import Stamp, complete
from protocol.registry import Registry
from tests.helpers.messages import deserialize, made_up
from tests.helpers.resources import examples

REGISTRY = Registry.load()
MESSAGE_TYPES = [name for name in REGISTRY.type_names() if REGISTRY.knows(name)]
# An independent implementation of CDR; it has the types of one ROS 2 distribution.
ROSBAGS = get_typestore(Stores.ROS2_JAZZY)
FEW = examples(5)
SEEDS = st.integers(0, 2**32)


def same_fields(name):
    theirs = [field for field, _ in ROSBAGS.fielddefs[name][1]]
    return theirs == [field.name for field in REGISTRY.message(name).fields]


def alike(name):
    """Return true if rosbags declares a type, and all types in it, as the tables do."""
    if name not in ROSBAGS.fielddefs or not REGISTRY.message(name).fields or not same_fields(name):
        return False
    return all(field.primitive or alike(field.base) for field in REGISTRY.message(name).fields)


SHARED_TYPES = [name for name in MESSAGE_TYPES if alike(name)]
NUMPY = {"bool": np.bool_, "byte": np.uint8, **{f"float{n}": f"float{n}" for n in (32, 64)}}


def foreign(name, msg):
    """The message as an object of rosbags."""
    values = {}
    for field in REGISTRY.message(name).fields:
        value = msg[field.name]
        if not field.primitive:
            value = foreign(field.base, value) if field.array is None else [foreign(field.base, one) for one in value]
        elif field.array is not None and isinstance(value, bytes):
            value = np.frombuffer(value, np.uint8)
        elif field.array is not None and field.base != "string":
            value = np.array(value, NUMPY.get(field.base, field.base))
        elif field.base == "byte":
            # There it is a signed number.
            value = value - 256 if value > 127 else value
        values[field.name] = value
    return ROSBAGS.types[name](**values)


@pytest.mark.parametrize("name", MESSAGE_TYPES)
@FEW
@given(seed=SEEDS)
def test_a_serialized_message_is_read_back_the_same(name, seed):
    message = made_up(REGISTRY, name, seed)
    assert deserialize(REGISTRY, name, cdr.serialize(REGISTRY, name, message)) == message


def test_many_types_can_be_compared_with_another_implementation():
    assert len(SHARED_TYPES) > 100


@pytest.mark.parametrize("name", SHARED_TYPES)
@FEW
@given(seed=SEEDS)
def test_the_bytes_are_those_of_another_implementation(name, seed):
    message = made_up(REGISTRY, name, seed)
    theirs = ROSBAGS.serialize_cdr(foreign(name, with_octets(REGISTRY, name, message)), name)
    ours = cdr.serialize(REGISTRY, name, message)
    # rosbags pads the whole to four bytes.
    assert bytes(theirs)[: len(ours)] == ours
    assert not any(bytes(theirs)[len(ours) :])


def test_a_primitive_is_aligned_from_behind_the_header():
    message = complete(REGISTRY, "sensor_msgs/Temperature", {"temperature": 2.0}, Stamp(1, 2))
    # Stamp 8, length 4, terminator 1, then 3 of padding.
    temperature = cdr.serialize(REGISTRY, "sensor_msgs/Temperature", message)[4 + 16 : 4 + 24]
    assert temperature == struct.pack("<d", 2.0)


def test_an_empty_message_is_one_octet():
    assert cdr.serialize(REGISTRY, "std_msgs/Empty", {}) == bytes.fromhex("00010000 00")


def test_members_of_services_can_be_serialized():
    octets = cdr.serialize(REGISTRY, "std_srvs/srv/SetBool_Response", {"success": True, "message": "a"})
    assert octets == bytes.fromhex("00010000 01000000 02000000 6100")
