import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import NothingToDoError, OperationError
from protocol.names import qualify
from protocol.operations import Advertise
from protocol.registrations import Publications, Registrations


@pytest.fixture
def table():
    return Registrations("advertise", "unadvertise", limit=3)


def test_the_first_entry_on_a_topic_is_told_from_later_ones(table):
    assert table.put("/a", 1, "x") is True
    assert table.put("/a", 2, "y") is False
    assert list(table.entries("/a")) == ["x", "y"]


def test_a_topic_has_one_key_however_it_is_spelled(table):
    table.put("a", None, "x")
    assert list(table) == ["/a"]
    assert "a" in table
    assert "/a" in table
    assert table.remove("/a", None) is True


def test_the_same_id_replaces_its_entry(table):
    table.put("/a", 1, "x")
    table.put("/a", 1, "y")
    assert list(table.entries("/a")) == ["y"]


def test_an_id_that_is_known_withdraws_that_entry_alone(table):
    table.put("/a", 1, "x")
    table.put("/a", 2, "y")
    assert table.remove("/a", 1) is False
    assert list(table.entries("/a")) == ["y"]
    assert table.remove("/a", 2) is True
    assert "/a" not in table


def test_an_unknown_id_withdraws_nothing_and_says_so(table):
    table.put("/a", 1, "x")
    with pytest.raises(NothingToDoError, match="unadvertise: topic /a under id 9: this client has no advertise"):
        table.remove("/a", 9)
    assert list(table.entries("/a")) == ["x"]


def test_no_id_withdraws_all(table):
    table.put("/a", 1, "x")
    table.put("/a", None, "y")
    assert table.remove("/a", None) is True
    assert list(table) == []


@pytest.mark.parametrize("mark", [None, 1])
def test_an_unknown_topic_is_left_alone(table, mark):
    with pytest.raises(NothingToDoError, match="unadvertise: topic /a"):
        table.remove("/a", mark)


def test_one_entry_too_many_is_refused_and_changes_nothing(table):
    for mark in (1, 2, 3):
        table.put("/a", mark, "x")
    with pytest.raises(OperationError, match="advertise: this client has 3, the limit is 3"):
        table.put("/b", 1, "x")
    assert list(table) == ["/a"]


def test_at_the_limit_an_entry_can_still_be_replaced_and_one_withdrawn_makes_room(table):
    for mark in (1, 2, 3):
        table.put("/a", mark, "x")
    table.put("/a", 3, "y")
    table.remove("/a", 1)
    assert table.put("/b", 1, "z") is True


def test_topics_can_be_withdrawn_while_going_over_them(table):
    table.put("/a", 1, "x")
    table.put("/b", 1, "x")
    for topic in table:
        table.remove(topic, None)
    assert list(table) == []


actions = st.tuples(st.booleans(), st.sampled_from(["a", "/a", "/b"]), st.sampled_from([None, 1, "1"]))


@given(st.lists(actions, max_size=30))
def test_the_limit_counts_what_is_there(steps):
    table, limit = Registrations("subscribe", "unsubscribe", limit=3), 3
    model = set()
    for put, topic, mark in steps:
        key = (qualify(topic), mark)
        if put and (key in model or len(model) < limit):
            table.put(topic, mark, "x")
            model.add(key)
        elif put:
            with pytest.raises(OperationError):
                table.put(topic, mark, "x")
        elif any(topic_there == key[0] and mark in (None, there) for topic_there, there in model):
            table.remove(topic, mark)
            model = {k for k in model if k[0] != key[0] or (mark is not None and k[1] != mark)}
        else:
            with pytest.raises(NothingToDoError):
                table.remove(topic, mark)
        assert set(table) == {topic for topic, _ in model}


def test_publications_register_what_is_advertised():
    publications = Publications(limit=1)
    assert publications.add(Advertise(topic="a", type="std_msgs/String")) is True
    assert publications.add(Advertise(topic="/a", type="std_msgs/String")) is False
    with pytest.raises(OperationError, match=r"^advertise: "):
        publications.add(Advertise(topic="/b", type="std_msgs/String"))
    assert publications.remove("/a", None) is True
