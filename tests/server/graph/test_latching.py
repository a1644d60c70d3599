import pytest

from protocol.messages import Stamp
from protocol.publication import PublishedMessage
from server.graph import latching
from server.graph.latching import LatchedMessages
from server.graph.permissions import Node
from tests.helpers.messages import REGISTRY


def published(data: str, topic: str = "/t") -> PublishedMessage:
    return PublishedMessage(topic, "std_msgs/msg/String", {"data": data}, REGISTRY, Stamp(1, 2))


def data_of(kept: LatchedMessages, now: float, topic: str = "/t") -> list[str]:
    return [one.msg["data"] for one in kept.of(topic, now)]


@pytest.fixture
def kept() -> LatchedMessages:
    return LatchedMessages()


def test_latching_anew_takes_the_end_away(kept: LatchedMessages) -> None:
    kept.latch(published("x"))
    kept.unlatch_at("/t", 10.0)
    kept.latch(published("y"))
    assert data_of(kept, 100.0) == ["y"]


def test_recent_messages_are_bounded_the_oldest_goes(kept: LatchedMessages, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latching, "MAX_RECENT_BYTES", 1000)
    for number in range(20):
        kept.keep(published(f"{number:0200}", f"/t{number}"), 0.0, 1.0)
    # One that is larger than the bound is not kept, and takes no other's place.
    kept.keep(published("x" * 2000), 0.0, 1.0)
    assert data_of(kept, 0.5) == []
    assert [number for number in range(20) if kept.of(f"/t{number}", 0.5)] == [16, 17, 18, 19]


FIRST, SECOND = Node("first", remote=True), Node("second", remote=True)


def latch(kept: LatchedMessages, *topics: tuple[str, Node | None]) -> list[str | None]:
    """Latch a message on topics, each of a client or, without one, of the server; return the refusals."""
    return [kept.latch(published("x" * 600, topic), client) for topic, client in topics]


class TestRoom:
    """Limits of a few messages of 600 characters."""

    @pytest.fixture(autouse=True)
    def small(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for name, limit in (("SERVER", 1000), ("CLIENTS", 2000), ("CLIENT", 1300)):
            monkeypatch.setattr(latching, f"MAX_{name}_LATCHED_BYTES", limit)

    def test_the_servers_latched_messages_are_bounded_in_bytes_together(self, kept: LatchedMessages) -> None:
        sentence = "the server has 1222 bytes latched with it, the limit is 1000"
        assert latch(kept, ("/a", None), ("/b", None)) == [None, sentence]
        kept.unlatch("/a")
        assert latch(kept, ("/b", None)) == [None]
        assert data_of(kept, 0.0, "/a") == []

    def test_those_of_a_client_and_those_of_all_together_are_bounded(self, kept: LatchedMessages) -> None:
        sentence = "this client has 1833 bytes latched with it, the limit is 1300"
        assert latch(kept, ("/a", FIRST), ("/b", FIRST), ("/c", FIRST), ("/b", FIRST)) == [None, None, sentence, None]
        sentence = "all clients have 2444 bytes latched with it, the limit is 2000"
        assert latch(kept, ("/c", SECOND), ("/d", SECOND)) == [None, sentence]

    def test_a_message_that_has_an_end_makes_room_the_earliest_first(self, kept: LatchedMessages) -> None:
        for topic in ("/a", "/b", "/c"):
            latch(kept, (topic, FIRST))
            kept.unlatch_at(topic, 10.0)
        assert latch(kept, ("/d", SECOND)) == [None]
        assert [bool(data_of(kept, 5.0, topic)) for topic in ("/a", "/b", "/c", "/d")] == [False, True, True, True]

    def test_it_makes_none_for_the_other_side(self, kept: LatchedMessages) -> None:
        latch(kept, ("/a", None))
        kept.unlatch_at("/a", 10.0)
        latch(kept, ("/b", FIRST), ("/c", FIRST), ("/d", SECOND), ("/e", SECOND))
        assert data_of(kept, 5.0, "/a") != []

    def test_what_is_given_up_is_off_every_account(self, kept: LatchedMessages) -> None:
        latch(kept, ("/a", FIRST), ("/b", FIRST))
        kept.unlatch_at("/a", 10.0)
        kept.unlatch_at("/a", 11.0)
        for topic in ("/a", "/b"):
            kept.forget(topic)
        assert not kept._ending
        assert not kept._sizes
