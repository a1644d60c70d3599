import json

import bson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.codecs import png
from protocol.limits import Limits
from protocol.messages import Stamp
from protocol.operations import OPERATIONS, Operation, Publish, Subscribe
from protocol.publication import PublishedMessage
from protocol.registry import Registry
from protocol.session import DROPS_TOLD_EVERY_S, SEND_BUDGET_BYTES, Packed, Refusal, Session

REGISTRY = Registry.load()


def read(session, frame, now=1.0):
    items = session.receive_frame(frame, now)
    return [session.unpack(item) if isinstance(item, Packed) else item for item in items]


def receive(session, **fields):
    (operation,) = read(session, json.dumps(fields))
    return operation


def sent(session, now=1.0):
    """Everything the client gets now."""
    frames = []
    while due := session.data_to_send(now):
        frames += [frame for encoded in due for frame in encoded.frames]
    return [frame.data for frame in frames]


def subscribed(topic="/a", limits=None, **fields):
    session = Session(limits)
    session.subscriptions.add(receive(session, op="subscribe", topic=topic, **fields))
    return session


def message(data, topic="/a"):
    return PublishedMessage(topic, "std_msgs/msg/String", {"data": data}, REGISTRY, Stamp(1, 2))


def received_data(frames):
    return [json.loads(frame)["msg"]["data"] for frame in frames]


# What comes from the client


@pytest.mark.parametrize("frame", ['{"op":"publish","topic":"/a"}', b' {"op" : "publish",\n"topic":"/a"} '])
def test_text_and_binary_frames_carry_the_same_operations(frame):
    assert read(Session(), frame) == [Publish(topic="/a")]


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
def test_an_unreadable_frame_is_refused_in_one_line(frame, text):
    (refusal,) = read(Session(), frame)
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
    read(session, "rubbish")
    assert receive(session, op="subscribe", topic="/a") == Subscribe(topic="/a")


def test_a_message_is_taken_up_to_the_limit_in_bytes_and_not_beyond():
    frame = '{"op":"publish","topic":"/ä"}'
    size_bytes = len(frame.encode())
    assert isinstance(read(Session(Limits(max_message_bytes=size_bytes)), frame)[0], Publish)
    for too_long in (frame, frame.encode()):
        (refusal,) = read(Session(Limits(max_message_bytes=size_bytes - 1)), too_long)
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
    for item in read(Session(Limits(max_message_bytes=500)), frame):
        assert isinstance(item, (Operation, Refusal))


# What goes to the client


def test_a_client_gets_the_topics_it_has_subscribed_to_and_no_others():
    session = subscribed("/a")
    session.deliver(message("x"), 1.0)
    session.deliver(message("y", topic="/b"), 1.0)
    assert sent(session, 1.0) == [b'{"op":"publish","topic":"/a","msg":{"data":"x"}}']


def test_a_client_gets_the_topic_as_it_spelled_it():
    session = subscribed("a")
    session.deliver(message("x"), 1.0)
    assert json.loads(sent(session, 1.0)[0])["topic"] == "a"


def test_two_ids_on_one_topic_get_one_message():
    session = subscribed(id="x")
    session.subscriptions.add(receive(session, op="subscribe", topic="/a", id="y"))
    session.deliver(message("x"), 1.0)
    assert len(sent(session, 1.0)) == 1


def test_subscribers_share_the_bytes_of_a_frame():
    first, second, published = subscribed(), subscribed(), message("x")
    for session in (first, second):
        session.deliver(published, 1.0)
    assert first.data_to_send(1.0)[0].on_wire is second.data_to_send(1.0)[0].on_wire


def test_after_unsubscribing_nothing_comes_not_even_what_waited():
    session = subscribed(throttle_rate=100, queue_length=10)
    for data in "xyz":
        session.deliver(message(data), 1.0)
    assert received_data(sent(session, 1.0)) == ["x"]
    assert session.subscriptions.remove("/a", None) is True
    session.deliver(message("late"), 2.0)
    assert sent(session, 2.0) == []
    assert session.next_due(2.0) is None


def test_a_throttle_without_a_queue_drops_what_comes_too_early_and_does_not_count_it():
    session = subscribed(throttle_rate=100)
    for step in range(10):
        session.deliver(message(step), step * 0.03)
    assert received_data(sent(session, 1.0)) == [0, 4, 8]
    assert session.dropped == 0


def test_a_throttle_with_a_queue_sends_the_newest_one_per_interval():
    session = subscribed(throttle_rate=100, queue_length=2)
    frames = []
    for step in range(10):
        session.deliver(message(step), step * 0.01)
        frames += sent(session, step * 0.01)
    assert session.next_due(0.09) == pytest.approx(0.1)
    frames += sent(session, 0.11) + sent(session, 0.22) + sent(session, 0.33)
    assert received_data(frames) == [0, 8, 9]
    assert session.dropped == 0


def test_replies_and_topic_data_keep_their_order():
    session = subscribed()
    session.reply({"op": "before"})
    session.deliver(message("x"), 1.0)
    session.reply({"op": "after"})
    assert [json.loads(frame)["op"] for frame in sent(session)] == ["before", "publish", "after"]


def test_a_client_that_stops_reading_keeps_the_newest_topic_data_within_the_bound():
    session = subscribed(limits=Limits(max_queued_bytes=10_000))
    for step in range(1000):
        session.deliver(message(step), 0.0)
    data = received_data(sent(session, 1.0))
    assert data == list(range(1000))[-len(data) :]
    assert session.dropped == 1000 - len(data)
    assert not session.overflowed


def test_replies_that_pile_up_overflow_the_session():
    session = Session(Limits(max_queued_reply_bytes=10_000))
    for _ in range(1000):
        session.reply({"op": "x" * 100})
    assert session.overflowed


def test_each_client_has_limits_on_what_it_registers():
    session = Session(Limits(max_subscriptions=1, max_publications=0))
    session.subscriptions.add(receive(session, op="subscribe", topic="/a"))
    with pytest.raises(Exception, match="the limit is 1"):
        session.subscriptions.add(receive(session, op="subscribe", topic="/b"))
    with pytest.raises(Exception, match="the limit is 0"):
        session.publications.add(receive(session, op="advertise", topic="/a", type="std_msgs/String"))


# What is packed


PUBLISH = '{"op":"publish","topic":"/a"}'


def fragments(text, mark="f", pieces=3):
    size = -(-len(text) // pieces)
    return [
        {"op": "fragment", "id": mark, "data": text[start : start + size], "num": number, "total": pieces}
        for number, start in enumerate(range(0, len(text), size))
    ]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1), (1, 1, 0, 2)])
def test_fragments_in_any_order_are_read_as_soon_as_all_are_there(order):
    session = Session()
    pieces = fragments(PUBLISH)
    items = [read(session, json.dumps(pieces[number])) for number in order]
    assert items[:-1] == [[]] * (len(order) - 1)
    assert items[-1] == [Publish(topic="/a")]


def test_fragments_that_never_complete_are_forgotten_in_time():
    session = Session(Limits(fragment_timeout_s=600.0))
    first, *others = fragments(PUBLISH)
    read(session, json.dumps(first), now=0.0)
    assert [read(session, json.dumps(piece), now=601.0) for piece in others] == [[], []]


def test_a_picture_is_read_as_the_frame_in_it():
    assert read(Session(), json.dumps({"op": "png", "data": png.encode(PUBLISH.encode())})) == [Publish(topic="/a")]


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"op": "fragment", "id": "f", "data": "rubbish", "num": 0, "total": 1}, "fragment: field data: not JSON"),
        ({"op": "fragment", "id": "f", "data": '{"op":"fly"}', "num": 0, "total": 1}, "field op: wanted one of"),
        ({"op": "fragment", "id": "f", "data": json.dumps(fragments(PUBLISH)[0]), "num": 0, "total": 1}, "another"),
        ({"op": "fragment", "id": "f", "data": "x", "num": 3, "total": 2}, "fragment: field num"),
        ({"op": "png", "data": "rubbish"}, "png: field data: not"),
    ],
)
def test_a_wrongly_packed_operation_is_refused(fields, text):
    assert text in receive(Session(), **fields).text


def test_several_operations_in_one_frame_are_read_in_order_and_what_is_wrong_between_them_is_refused():
    first, second, third = read(Session(), PUBLISH + '{"op":"fly"}' + PUBLISH.replace("/a", "/b"))
    assert (first, third) == (Publish(topic="/a"), Publish(topic="/b"))
    assert isinstance(second, Refusal)


# Control fields


def big_publication():
    return message("x" * 1000)


@pytest.mark.parametrize("op", [{"op": "unsubscribe", "topic": "/b"}, {"op": "set_level", "level": "none"}])
def test_a_fragment_size_on_any_operation_is_the_clients_from_then_on(op):
    session = subscribed()
    receive(session, **op, fragment_size=100)
    session.deliver(big_publication(), 1.0)
    pieces = [json.loads(frame) for frame in sent(session)]
    assert {piece["op"] for piece in pieces} == {"fragment"}
    assert all(len(piece["data"]) <= 100 and type(piece["total"]) is int for piece in pieces)
    assert json.loads("".join(piece["data"] for piece in pieces)) == {
        "op": "publish",
        "topic": "/a",
        "msg": {"data": "x" * 1000},
    }


def test_replies_are_fragmented_too_each_under_an_id_of_its_own():
    session = Session()
    receive(session, op="set_level", level="none", fragment_size=100)
    for _ in range(2):
        session.reply({"op": "service_response", "values": {"text": "x" * 150}})
    ids = [json.loads(frame)["id"] for frame in sent(session)]
    assert len(ids) == 4
    assert len(set(ids)) == 2


def test_of_several_subscriptions_the_least_fragment_size_counts_for_their_topic():
    session = subscribed(id="x", fragment_size=300)
    session.subscriptions.add(receive(session, op="subscribe", topic="/a", id="y", fragment_size=200))
    session.subscriptions.add(receive(session, op="subscribe", topic="/a", id="z", fragment_size=2147483647))
    session.deliver(big_publication(), 1.0)
    assert max(len(json.loads(frame)["data"]) for frame in sent(session)) == 200


@pytest.mark.parametrize("size", [0, -1, 1.5, "100", [100], True])
def test_a_senseless_fragment_size_is_refused_and_changes_nothing(size):
    session = subscribed()
    assert "fragment_size" in receive(session, op="unsubscribe", topic="/b", fragment_size=size).text
    session.deliver(big_publication(), 1.0)
    assert len(sent(session)) == 1


def test_a_fragment_size_of_null_changes_nothing():
    session = subscribed(fragment_size=100)
    receive(session, op="unsubscribe", topic="/b", fragment_size=None)
    session.reply({"op": "x", "values": "y" * 200})
    assert len(sent(session)) > 1


# Kinds of frames


def test_a_client_that_sends_bson_is_answered_in_bson_and_one_that_sends_json_again_in_json():
    session = Session()
    (operation,) = read(session, bson.encode({"op": "subscribe", "topic": "/a"}))
    session.subscriptions.add(operation)
    session.deliver(message("x"), 1.0)
    session.reply({"op": "service_response", "values": {"n": 1}})
    told, answered = (encoded.frames[0] for encoded in session.data_to_send(1.0))
    assert not told.text
    assert not answered.text
    assert bson.decode(told.data) == {"op": "publish", "topic": "/a", "msg": {"data": "x"}}
    assert bson.decode(answered.data) == {"op": "service_response", "values": {"n": 1}}
    read(session, PUBLISH)
    session.deliver(message("x"), 1.0)
    assert session.data_to_send(1.0)[0].frames[0].text


@pytest.mark.parametrize(("compression", "text"), [("none", True), ("png", True), ("cbor", False), ("cbor-raw", False)])
def test_each_compression_has_its_kind_of_frame(compression, text):
    session = subscribed(compression=compression)
    session.deliver(message("x"), 1.0)
    assert session.data_to_send(1.0)[0].frames[0].text is text


def test_binary_frames_are_not_fragmented():
    session = subscribed(compression="cbor", fragment_size=10)
    session.deliver(big_publication(), 1.0)
    assert len(sent(session)) == 1


# Status messages


@pytest.mark.parametrize(
    ("chosen", "told"),
    [
        (None, []),
        ("none", []),
        ("error", ["error"]),
        ("warning", ["error", "warning"]),
        ("info", ["error", "warning", "info"]),
    ],
)
def test_a_client_gets_the_status_messages_it_has_asked_for(chosen, told):
    session = Session()
    if chosen is not None:
        session.status_level = chosen
    for level in ("error", "warning", "info"):
        session.status(level, "x", None)
    assert [json.loads(frame)["level"] for frame in sent(session)] == told


def test_a_status_message_has_an_id_only_where_the_operation_had_one():
    session = Session()
    session.status_level = "error"
    session.status("error", "publish: x", None)
    session.status("error", "publish: y", 7)
    assert sent(session) == [
        b'{"op":"status","level":"error","msg":"publish: x"}',
        b'{"op":"status","level":"error","msg":"publish: y","id":7}',
    ]


# Bounds


def test_a_client_that_stops_reading_holds_no_more_than_it_may():
    limits = Limits(max_queued_bytes=1_000_000, max_queued_reply_bytes=300_000)
    session = subscribed(limits=limits)
    for step in range(3000):
        session.deliver(message("x" * 1000 + str(step)), 1.0)
        session.reply({"op": "service_response", "values": "y" * 1000})
        assert session.queued_bytes <= limits.max_queued_bytes
    assert session.overflowed


def test_a_clients_next_operations_wait_while_a_few_large_replies_do():
    session = Session()
    congested = []
    for _ in range(3):
        session.reply({"op": "service_response", "values": "y" * 100_000})
        congested.append(session.congested)
    assert congested == [False, False, True]


def test_feedback_is_dropped_where_a_reply_would_overflow():
    session = Session(Limits(max_queued_bytes=10_000, max_queued_reply_bytes=10_000))
    for step in range(1000):
        session.feedback({"op": "action_feedback", "step": step}, 1.0)
    assert not session.overflowed
    assert json.loads(sent(session)[-1])["step"] == 999
    assert session.dropped > 0


def test_the_data_fetched_at_a_time_is_bounded():
    session = subscribed()
    for step in range(500):
        session.deliver(message("x" * 1000 + str(step)), 1.0)
    fetched = session.data_to_send(1.0)
    assert sum(encoded.size_bytes for encoded in fetched) <= SEND_BUDGET_BYTES + 2000
    assert session.next_due(1.0) == 1.0


def test_a_client_that_lags_is_warned_once_it_reads_and_not_too_often():
    session = subscribed(limits=Limits(max_queued_bytes=2000))
    session.status_level = "warning"
    warned = []
    for now in (1.0, 1.5, 1.0 + DROPS_TOLD_EVERY_S):
        for _ in range(20):
            session.deliver(message("x" * 100), now)
        warned.append([told["msg"] for told in map(json.loads, sent(session, now)) if told["op"] == "status"])
    assert [len(told) for told in warned] == [1, 0, 1]
    (first,), _, (last,) = warned
    # The warnings have taken the place of a message or two each.
    assert 0 <= session.dropped - sum(int(text.split()[0]) for text in (first, last)) <= 4
    assert "messages dropped" in first


def test_a_client_is_not_warned_of_what_its_own_throttle_drops():
    session = subscribed(throttle_rate=1000, queue_length=1)
    session.status_level = "warning"
    for _ in range(5):
        session.deliver(message("x"), 1.0)
    assert {json.loads(frame)["op"] for frame in sent(session, 1.0)} == {"publish"}


def test_there_is_room_for_so_many_requests_and_no_more():
    session = Session(Limits(max_queued_request_bytes=2500))
    assert [session.ask({"op": "call_service", "args": "x" * 500}) for _ in range(4)] == [True, True, False, False]
    assert not session.overflowed


# What was packed


def test_a_refusal_of_what_was_packed_carries_its_op_and_id():
    inner = json.dumps({"op": "subscribe", "id": "inner"})
    refusal = receive(Session(), op="fragment", id="outer", data=inner, num=0, total=1)
    assert (refusal.op, refusal.id) == ("subscribe", "inner")


def test_a_fragment_size_on_what_was_packed_counts():
    session = subscribed()
    inner = json.dumps({"op": "unsubscribe", "topic": "/b", "fragment_size": 100})
    receive(session, op="fragment", id="f", data=inner, num=0, total=1)
    session.deliver(big_publication(), 1.0)
    assert len(sent(session)) > 1
