import math

import cbor2
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import cbor


@given(st.text())
def test_a_frame_is_one_map_of_op_topic_and_message_in_this_order(topic):
    message = {"data": [1, 2.5, "ü", True, None, b"\x00"]}
    frame = cbor2.loads(cbor.publish(topic, cbor.encode(message)))
    assert list(frame.items()) == [("op", "publish"), ("topic", topic), ("msg", message)]


def test_nan_and_infinity_stay_numbers():
    not_a_number, infinity = cbor2.loads(cbor.encode({"data": [math.nan, math.inf]}))["data"]
    assert math.isnan(not_a_number)
    assert infinity == math.inf


def test_a_whole_float_stays_a_float():
    assert type(cbor2.loads(cbor.encode({"data": 2.0}))["data"]) is float
