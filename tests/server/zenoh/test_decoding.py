from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from protocol.codecs import cdr
from protocol.errors import MessageError
from server.graph.message_types import BYTES_AT_ONCE, MessageTypes, ReceivedMessage
from server.zenoh.decoding import Decoder
from tests.helpers.zenoh_network import REGISTRY

STRING = "std_msgs/msg/String"
TYPES = MessageTypes(REGISTRY)


class Waiting:
    """Threads whose jobs are done when the test says so."""

    def __init__(self) -> None:
        self.jobs: list[Callable[[], None]] = []

    def run(self, job: Callable[[], Any], done: Callable[[Any, float], None], failed: Callable[[], None]) -> None:
        def work() -> None:
            try:
                result = job()
            except RuntimeError:
                failed()
            else:
                done(result, 0.0)

        self.jobs.append(work)

    def encode(self, encoded: Any, ready: Callable[[], None]) -> None:
        raise AssertionError


class Decoding:
    """A decoder on such threads, and what it has made of messages."""

    def __init__(self) -> None:
        self.background = Waiting()
        self.decoded: list[ReceivedMessage | MessageError] = []

    def take(self, octets: bytes, type_name: str = STRING) -> None:
        Decoder(TYPES, self.background).decode(type_name, octets, self.decoded.append)

    def work(self) -> None:
        """Have the threads do what they were given, which is one job."""
        (job,) = self.background.jobs
        job()


@pytest.fixture
def decoding() -> Decoding:
    return Decoding()


def octets_of(text: str) -> bytes:
    return cdr.serialize(REGISTRY, STRING, {"data": text})


def test_a_small_message_is_decoded_at_once(decoding: Decoding) -> None:
    decoding.take(octets_of("a"))
    assert decoding.background.jobs == []
    assert isinstance(decoding.decoded[0], ReceivedMessage)
    assert TYPES.complete(STRING, decoding.decoded[0]) == {"data": "a"}


def test_a_large_message_is_decoded_and_completed_by_a_thread(decoding: Decoding) -> None:
    text = "x" * BYTES_AT_ONCE
    decoding.take(octets_of(text))
    assert decoding.decoded == []
    decoding.work()
    assert isinstance(decoding.decoded[0], ReceivedMessage)
    assert decoding.decoded[0].completed(STRING) == {"data": text}


def test_of_octets_that_are_no_message_the_reason_is_told(decoding: Decoding) -> None:
    decoding.take(b"\0\0", "std_msgs/msg/Header")
    assert isinstance(decoding.decoded[0], MessageError)
    decoding.take(b"\xff" * (BYTES_AT_ONCE + 1))
    decoding.work()
    assert isinstance(decoding.decoded[1], MessageError)


def test_a_thread_that_fails_leaves_a_reason(decoding: Decoding, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr(cdr, "deserialize", fail)
    decoding.take(b"x" * (BYTES_AT_ONCE + 1))
    decoding.work()
    assert isinstance(decoding.decoded[0], MessageError)
