import json

import bson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.limits import Limits
from protocol.messages import Stamp
from protocol.operations import MAX_ID_CHARACTERS, MAX_NAME_CHARACTERS, OPERATIONS, Operation, Publish
from protocol.publication import PublishedMessage
from protocol.send_queue import BEHIND_S, BULKY_BYTES
from protocol.session import SEND_BUDGET_BYTES, Packed, Refusal, Session
from tests.helpers.messages import REGISTRY


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
        frames += [json.loads(frame.data) for encoded in due for frame in encoded.frames]
    return frames


def subscribed(limits=None, **fields):
    session = Session(limits)
    session.subscriptions.add(receive(session, op="subscribe", topic="/a", **fields))
    return session


def message(data):
    return PublishedMessage("/a", "std_msgs/msg/String", {"data": data}, REGISTRY, Stamp(1, 2))


def data_of(operations):
    return [operation["msg"]["data"] for operation in operations]


def test_a_refusal_carries_the_id_and_name_of_what_was_called_if_they_can_be_sent_back():
    for mark in ("", "x" * MAX_ID_CHARACTERS, 7, 0.5):
        assert receive(Session(), op="subscribe", topic=5, id=mark).id == mark
    for mark in ({}, [1], True, "x" * (MAX_ID_CHARACTERS + 1)):
        assert receive(Session(), op="subscribe", topic=5, id=mark).id is None
    for field in ("service", "action"):
        for characters, named in ((3, True), (MAX_NAME_CHARACTERS, True), (MAX_NAME_CHARACTERS + 1, False)):
            name = "x" * characters
            refusal = receive(Session(), op="call_service", id={}, **{field: name})
            assert refusal.called == (name if named else ""), characters


def test_a_message_is_taken_up_to_the_limit_in_bytes_and_not_beyond():
    frame = '{"op":"publish","topic":"/ä"}'
    size_bytes = len(frame.encode())
    assert isinstance(read(Session(Limits.model_construct(max_message_bytes=size_bytes)), frame)[0], Publish)
    for too_long in (frame, frame.encode()):
        (refusal,) = read(Session(Limits.model_construct(max_message_bytes=size_bytes - 1)), too_long)
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
    for item in read(Session(Limits.model_construct(max_message_bytes=500)), frame):
        assert isinstance(item, (Operation, Refusal))


def test_a_frame_is_read_ahead_or_by_itself_only_where_nothing_before_it_matters():
    for frame in ("{", '{"op":"fly"}', b"\xff", bson.encode({"op": "fly"})):
        assert Session().peek(frame) is None
    frame = '{"op":"unsubscribe","topic":"/a"}'
    limits = Limits.model_construct(max_message_bytes=len(frame))
    assert Session().peek(frame) == Session().peek(frame.encode()) is not None
    assert Session(limits).reads_by_itself(frame)
    assert Session().reads_by_itself(frame)
    assert not Session(limits).reads_by_itself(frame + " ")
    assert not Session(limits, "ros1").reads_by_itself(frame)
    amid = Session(limits)
    assert read(amid, '{"op":') == []
    assert not amid.reads_by_itself(frame)


def test_a_client_is_answered_in_the_encoding_of_its_last_frame_also_of_one_that_was_read_ahead():
    fields = {"op": "unsubscribe", "topic": "/b"}
    for receive_frame in (read, Session.peek):
        session = subscribed()
        for frame, decode in ((bson.encode(fields), bson.decode), (json.dumps(fields), json.loads)):
            receive_frame(session, frame)
            session.reply({"op": "x"})
            session.deliver(message("y"), 1.0)
            frames = [frame for encoded in session.data_to_send(1.0) for frame in encoded.frames]
            assert [decode(frame.data)["op"] for frame in frames] == ["x", "publish"]
            assert {frame.text for frame in frames} == {decode is json.loads}
    # A compression that was asked for stays.
    for compression in ("cbor", "png"):
        of_json, of_bson = subscribed(compression=compression), subscribed(compression=compression)
        read(of_bson, bson.encode(fields))
        for session in (of_json, of_bson):
            session.deliver(message("y"), 1.0)
        assert of_bson.data_to_send(1.0)[0].frames == of_json.data_to_send(1.0)[0].frames


def test_a_status_goes_with_its_id_to_a_client_that_asked_for_its_level_and_unasked_to_any():
    session = Session()
    for asked, heard in (("none", []), ("error", ["error"]), ("info", ["error", "warning", "info"])):
        session.status_level = asked
        for level in ("error", "warning", "info"):
            session.status(level, "x", "mark")
        assert sent(session) == [{"op": "status", "level": level, "msg": "x", "id": "mark"} for level in heard]
    session.status_level = "none"
    session.status("info", "x", None, unasked=True)
    assert sent(session) == [{"op": "status", "level": "info", "msg": "x"}]


def test_a_wrongly_packed_operation_is_refused():
    inside = {"op": "fragment", "id": "f", "data": "{", "num": 0, "total": 2}
    for fields, text in (
        ({"op": "fragment", "id": "f", "data": "rubbish", "num": 0, "total": 1}, "fragment: field data: not JSON"),
        ({"op": "fragment", "id": "f", "data": '{"op":"fly"}', "num": 0, "total": 1}, "field op: wanted one of"),
        ({"op": "fragment", "id": "f", "data": json.dumps(inside), "num": 0, "total": 1}, "another"),
        ({"op": "fragment", "id": "f", "data": "x", "num": 3, "total": 2}, "fragment: field num"),
        ({"op": "png", "data": "rubbish"}, "png: field data: not"),
    ):
        assert text in receive(Session(), **fields).text


@pytest.mark.parametrize("kind", ["reply", "ask", "deliver"])
def test_an_operation_leaves_at_once_unless_another_waits_or_the_socket_is_full(kind):
    session, left = subscribed(), []

    def send(text, send_at_once):
        session._send_at_once = send_at_once
        if kind == "deliver":
            return session.deliver(message(text), 1.0)
        return getattr(session, kind)({"op": "x", "msg": {"data": text}})

    # A call is accepted either way; the others tell what is queued.
    for text in ("first", "second"):
        assert send(text, lambda encoded: left.append(json.loads(encoded.frames[0].data)) or True) == (kind == "ask")
    assert data_of(left) == ["first", "second"]
    assert sent(session) == []
    assert send("third", lambda _: False)
    assert send("fourth", lambda _: pytest.fail("it would overtake the third"))
    assert data_of(sent(session)) == ["third", "fourth"]


def test_a_message_that_its_throttle_lets_through_leaves_at_once_and_the_next_waits():
    session, left = subscribed(throttle_rate=1000, queue_length=1), []
    session._send_at_once = lambda one: left.append(one) or True
    queued = [session.deliver(message(str(now)), now) for now in (1.0, 1.5, 1.9)]
    assert queued == [False, True, True]
    assert [json.loads(encoded.frames[0].data)["msg"]["data"] for encoded in left] == ["1.0"]
    assert sent(session, 1.9) == []
    assert data_of(sent(session, 2.0)) == ["1.9"]


def test_a_fragment_size_on_any_operation_is_the_clients_from_then_on():
    for op in ({"op": "unsubscribe", "topic": "/b"}, {"op": "set_level", "level": "none"}):
        session = subscribed()
        receive(session, **op, fragment_size=100)
        session.deliver(message("x" * 1000), 1.0)
        pieces = sent(session)
        assert {piece["op"] for piece in pieces} == {"fragment"}
        assert all(len(piece["data"]) <= 100 and type(piece["total"]) is int for piece in pieces)
        whole = json.loads("".join(piece["data"] for piece in pieces))
        assert whole == {"op": "publish", "topic": "/a", "msg": {"data": "x" * 1000}}


def test_replies_are_fragmented_too_each_under_an_id_of_its_own():
    session = Session()
    receive(session, op="set_level", level="none", fragment_size=100)
    for _ in range(2):
        session.reply({"op": "service_response", "values": {"text": "x" * 150}})
    ids = [piece["id"] for piece in sent(session)]
    assert (len(ids), len(set(ids))) == (4, 2)


def test_a_senseless_fragment_size_is_refused_and_changes_nothing_and_so_does_null():
    for size in (0, -1, 1.5, "100", [100], True):
        session = subscribed()
        assert "fragment_size" in receive(session, op="unsubscribe", topic="/b", fragment_size=size).text
        session.deliver(message("x" * 1000), 1.0)
        assert len(sent(session)) == 1
    session = subscribed(fragment_size=100)
    receive(session, op="unsubscribe", topic="/b", fragment_size=None)
    session.reply({"op": "x", "values": "y" * 200})
    assert len(sent(session)) > 1


def test_a_clients_next_operations_wait_while_a_few_large_replies_do():
    session = Session()
    congested = []
    for _ in range(3):
        session.reply({"op": "service_response", "values": "y" * 100_000})
        congested.append(session.congested)
    assert congested == [False, False, True]
    session = Session(Limits.model_construct(max_queued_reply_bytes=100_000))
    session.reply({"op": "service_response", "values": "y" * 90_000})
    assert session.congested


def test_a_result_does_not_overtake_feedback_however_large():
    session = Session()
    session.feedback({"op": "action_feedback", "values": "x" * BULKY_BYTES}, 0.0)
    session.reply({"op": "action_result"})
    for encoded in session.send_queue.take_unready():
        encoded.encode()
    assert [operation["op"] for operation in sent(session, BEHIND_S + 1.0)] == ["action_feedback", "action_result"]


def test_the_data_fetched_at_a_time_is_bounded():
    session = subscribed()
    for step in range(500):
        session.deliver(message("x" * 1000 + str(step)), 1.0)
    fetched = session.data_to_send(1.0)
    assert sum(encoded.size_bytes for encoded in fetched) <= SEND_BUDGET_BYTES + 2000
    assert session.send_queue.next_due(1.0) == 1.0


def test_a_client_that_lags_is_warned_once_it_reads_and_not_too_often_nor_of_what_its_own_throttle_drops():
    session = subscribed(Limits.model_construct(max_queued_bytes=2000))
    session.status_level = "warning"
    while not session.dropped:
        session.deliver(message("x" * 100), 0.0)
    warned = [[told["msg"] for told in sent(session, 0.0) if told["op"] == "status"]]
    for now in (0.9, 1.0):
        for _ in range(20):
            session.deliver(message("x" * 100), now)
        warned.append([told["msg"] for told in sent(session, now) if told["op"] == "status"])
    assert warned[:2] == [["1 messages dropped: they are read too slowly"], []]
    (last,) = warned[2]
    # The warnings have taken the place of a message or two each.
    assert 0 <= session.dropped - 1 - int(last.split()[0]) <= 4
    session = subscribed(throttle_rate=1000, queue_length=1)
    session.status_level = "warning"
    for _ in range(5):
        session.deliver(message("x"), 1.0)
    assert {operation["op"] for operation in sent(session, 1.0)} == {"publish"}
    assert not Session().deliver(message("x"), 1.0)
