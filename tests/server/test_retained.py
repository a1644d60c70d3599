from __future__ import annotations

import pytest

from protocol.messages import Stamp
from protocol.publication import Publication
from protocol.registry import Registry
from server import retained
from server.retained import MAX_RECENT_PER_TOPIC, Retained

REGISTRY = Registry.load()


def publication(data: str, topic: str = "/t") -> Publication:
    return Publication(topic, "std_msgs/msg/String", {"data": data}, REGISTRY, Stamp(1, 2))


def data_of(kept: Retained, now: float, topic: str = "/t") -> list[str]:
    return [one.msg["data"] for one in kept.of(topic, now)]


@pytest.fixture
def kept() -> Retained:
    return Retained()


def test_the_last_latched_message_is_kept_for_ever(kept: Retained) -> None:
    assert kept.latch(publication("old"))
    assert kept.latch(publication("new"))
    assert data_of(kept, 1e9) == ["new"]


def test_a_latched_message_can_be_given_an_end(kept: Retained) -> None:
    kept.latch(publication("x"))
    kept.unlatch_at("/t", 10.0)
    assert data_of(kept, 9.9) == ["x"]
    assert data_of(kept, 10.1) == []


def test_latching_anew_takes_the_end_away(kept: Retained) -> None:
    kept.latch(publication("x"))
    kept.unlatch_at("/t", 10.0)
    kept.latch(publication("y"))
    assert data_of(kept, 100.0) == ["y"]


def test_messages_are_kept_for_their_lifespan_in_order(kept: Retained) -> None:
    for now, data in enumerate("abc"):
        kept.keep(publication(data), float(now), lifespan_s=1.5)
    assert data_of(kept, 2.2) == ["b", "c"]
    assert data_of(kept, 4.0) == []


def test_topics_do_not_mix(kept: Retained) -> None:
    kept.keep(publication("a"), 0.0, 1.0)
    kept.latch(publication("b", "/other"))
    assert data_of(kept, 0.5) == ["a"]
    assert data_of(kept, 0.5, "/other") == ["b"]
    kept.forget("/t")
    assert data_of(kept, 0.5) == []
    assert data_of(kept, 0.5, "/other") == ["b"]


def test_of_one_topic_only_so_many_are_kept(kept: Retained) -> None:
    for number in range(3 * MAX_RECENT_PER_TOPIC):
        kept.keep(publication(str(number)), 0.0, 1.0)
    assert data_of(kept, 0.5) == [str(number) for number in range(2 * MAX_RECENT_PER_TOPIC, 3 * MAX_RECENT_PER_TOPIC)]


def test_recent_messages_are_bounded_in_bytes_and_the_oldest_goes(
    kept: Retained, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(retained, "MAX_RECENT_BYTES", 1000)
    for number in range(20):
        kept.keep(publication(f"{number:0200}", f"/t{number}"), 0.0, 1.0)
    assert [number for number in range(20) if kept.of(f"/t{number}", 0.5)] == [16, 17, 18, 19]


def test_a_message_larger_than_the_bound_is_not_kept(kept: Retained, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retained, "MAX_RECENT_BYTES", 1000)
    kept.keep(publication("x" * 2000), 0.0, 1.0)
    assert data_of(kept, 0.5) == []
    kept.keep(publication("x"), 0.0, 1.0)
    assert data_of(kept, 0.5) == ["x"]


def test_latched_messages_are_bounded_in_bytes_together(kept: Retained, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retained, "MAX_LATCHED_BYTES", 1000)
    assert kept.latch(publication("x" * 600, "/a"))
    assert not kept.latch(publication("x" * 600, "/b"))
    kept.unlatch("/a")
    assert kept.latch(publication("x" * 600, "/b"))
    assert data_of(kept, 0.0, "/a") == []
