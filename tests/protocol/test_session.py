import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.limits import Limits
from protocol.operations import OPERATIONS, Operation, Publish, Subscribe
from protocol.publication import Publication
from protocol.session import Refusal, Session


def receive(session, **fields):
    (operation,) = session.receive_frame(json.dumps(fields))
    return operation


def subscribed(topic="/a", limits=None, **fields):
    session = Session(limits)
    session.subscriptions.add(receive(session, op="subscribe", topic=topic, **fields))
    return session


def message(data, topic="/a"):
    return Publication(topic, "std_msgs/msg/String", {"data": data})


def received_data(frames):
    return [json.loads(frame)["msg"]["data"] for frame in frames]


# What comes from the client


@pytest.mark.parametrize("frame", ['{"op":"publish","topic":"/a"}', b' {"op" : "publish",\n"topic":"/a"} '])
def test_text_and_binary_frames_carry_the_same_operations(frame):
    assert Session().receive_frame(frame) == [Publish(topic="/a")]


@pytest.mark.parametrize(
    ("frame", "text"),
    [
        ("", "not JSON"),
        ("hello", "not JSON"),
        (b"\xff\xfe", "invalid UTF-8 at position 0"),
        ("[" * 100_000, "not JSON"),
        ("[" * 500 + "]" * 500, "nested deeper than the limit of 64"),
        ("\ud800", "surrogate"),
        ("42", "wanted an object"),
        ("[1]", "wanted an object"),
        ("null", "wanted an object"),
        ("{}", "field op"),
        ('{"op":["publish"]}', "field op"),
        ('{"op":"fly"}', "got 'fly'"),
        ('{"op":"publish"}', "publish: field topic"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(frame, text):
    (refusal,) = Session().receive_frame(frame)
    assert isinstance(refusal, Refusal)
    assert text in refusal.text
    assert "\n" not in refusal.text


@pytest.mark.parametrize("mark", ["x", 7, None])
def test_a_refusal_carries_op_and_id(mark):
    refusal = receive(Session(), op="subscribe", topic=3, id=mark)
    assert (refusal.op, refusal.id) == ("subscribe", mark)


@pytest.mark.parametrize("mark", [{}, [1], True, 1.5, "x" * 10_000])
def test_a_refusal_carries_no_id_that_could_not_be_sent_back(mark):
    assert receive(Session(), op="subscribe", topic="/a", id=mark).id is None


def test_the_session_lives_on_after_a_refusal():
    session = Session()
    session.receive_frame("rubbish")
    assert receive(session, op="subscribe", topic="/a") == Subscribe(topic="/a")


def test_a_message_is_taken_up_to_the_limit_in_bytes_and_not_beyond():
    frame = '{"op":"publish","topic":"/ä"}'
    size_bytes = len(frame.encode())
    assert isinstance(Session(Limits(max_message_bytes=size_bytes)).receive_frame(frame)[0], Publish)
    for too_long in (frame, frame.encode()):
        (refusal,) = Session(Limits(max_message_bytes=size_bytes - 1)).receive_frame(too_long)
        assert refusal.text == f"message of {size_bytes} bytes, the limit is {size_bytes - 1}"


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
field_names = sorted({name for model in OPERATIONS.values() for name in model.model_fields})
nearly_operations = st.dictionaries(st.sampled_from(field_names), json_values | st.sampled_from(list(OPERATIONS)))
json_fragments = st.lists(
    st.sampled_from(['{"op":', '"publish"', "{", "}", "[", "]", ",", ":", '"', "NaN", "Infinity", "1e999", "\\ud800"])
)


@given(
    st.binary()
    | st.text(st.characters(exclude_categories=()))
    | json_values.map(json.dumps)
    | nearly_operations.map(json.dumps)
    | json_fragments.map("".join)
)
def test_nothing_that_comes_raises(frame):
    for item in Session(Limits(max_message_bytes=500)).receive_frame(frame):
        assert isinstance(item, (Operation, Refusal))


# What goes to the client


def test_a_client_gets_the_topics_it_has_subscribed_to_and_no_others():
    session = subscribed("/a")
    session.deliver(message("x"), 1.0)
    session.deliver(message("y", topic="/b"), 1.0)
    assert session.data_to_send(1.0) == [b'{"op":"publish","topic":"/a","msg":{"data":"x"}}']


def test_a_client_gets_the_topic_as_it_spelled_it():
    session = subscribed("a")
    session.deliver(message("x"), 1.0)
    assert json.loads(session.data_to_send(1.0)[0])["topic"] == "a"


def test_two_ids_on_one_topic_get_one_message():
    session = subscribed(id="x")
    session.subscriptions.add(receive(session, op="subscribe", topic="/a", id="y"))
    session.deliver(message("x"), 1.0)
    assert len(session.data_to_send(1.0)) == 1


def test_subscribers_share_the_bytes_of_a_frame():
    first, second, publication = subscribed(), subscribed(), message("x")
    for session in (first, second):
        session.deliver(publication, 1.0)
    assert first.data_to_send(1.0)[0] is second.data_to_send(1.0)[0]


def test_after_unsubscribing_nothing_comes_not_even_what_waited():
    session = subscribed(throttle_rate=100, queue_length=10)
    for data in "xyz":
        session.deliver(message(data), 1.0)
    assert received_data(session.data_to_send(1.0)) == ["x"]
    assert session.subscriptions.remove("/a", None) is True
    session.deliver(message("late"), 2.0)
    assert session.data_to_send(2.0) == []
    assert session.next_due(2.0) is None


def test_a_throttle_without_a_queue_drops_what_comes_too_early_and_does_not_count_it():
    session = subscribed(throttle_rate=100)
    for step in range(10):
        session.deliver(message(step), step * 0.03)
    assert received_data(session.data_to_send(1.0)) == [0, 4, 8]
    assert session.dropped == 0


def test_a_throttle_with_a_queue_sends_the_newest_one_per_interval():
    session = subscribed(throttle_rate=100, queue_length=2)
    sent = []
    for step in range(10):
        session.deliver(message(step), step * 0.01)
        sent += session.data_to_send(step * 0.01)
    assert session.next_due(0.09) == pytest.approx(0.1)
    sent += session.data_to_send(0.11) + session.data_to_send(0.22) + session.data_to_send(0.33)
    assert received_data(sent) == [0, 8, 9]
    assert session.dropped == 7


def test_replies_and_topic_data_keep_their_order():
    session = subscribed()
    session.send(b"before")
    session.deliver(message("x"), 1.0)
    session.send(b"after")
    frames = session.data_to_send(1.0)
    assert (frames[0], frames[2]) == (b"before", b"after")


def test_a_client_that_stops_reading_keeps_the_newest_topic_data_within_the_bound():
    session = subscribed(limits=Limits(max_queued_topic_bytes=10_000))
    for step in range(1000):
        session.deliver(message(step), 0.0)
    data = received_data(session.data_to_send(1.0))
    assert data == list(range(1000))[-len(data) :]
    assert session.dropped == 1000 - len(data)
    assert not session.overflowed


def test_replies_that_pile_up_overflow_the_session():
    session = Session(Limits(max_queued_reply_bytes=10_000))
    for _ in range(1000):
        session.send(b"x" * 100)
    assert session.overflowed


def test_each_client_has_limits_on_what_it_registers():
    session = Session(Limits(max_subscriptions=1, max_publications=0))
    session.subscriptions.add(receive(session, op="subscribe", topic="/a"))
    with pytest.raises(Exception, match="the limit is 1"):
        session.subscriptions.add(receive(session, op="subscribe", topic="/b"))
    with pytest.raises(Exception, match="the limit is 0"):
        session.publications.add(receive(session, op="advertise", topic="/a", type="std_msgs/String"))
