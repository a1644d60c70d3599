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


def octets_of(text: str) -> bytes:
    return cdr.serialize(REGISTRY, STRING, {"data": text})


def test_a_small_message_is_decoded_at_once() -> None:
    background, decoded = Waiting(), list[ReceivedMessage | MessageError]()
    Decoder(TYPES, background).decode(STRING, octets_of("a"), decoded.append)
    assert background.jobs == []
    assert isinstance(decoded[0], ReceivedMessage)
    assert TYPES.complete(STRING, decoded[0]) == {"data": "a"}


def test_a_large_message_is_decoded_and_completed_by_a_thread() -> None:
    background, decoded = Waiting(), list[ReceivedMessage | MessageError]()
    text = "x" * BYTES_AT_ONCE
    Decoder(TYPES, background).decode(STRING, octets_of(text), decoded.append)
    assert decoded == []
    background.jobs.pop()()
    assert isinstance(decoded[0], ReceivedMessage)
    assert decoded[0].completed(STRING) == {"data": text}


@pytest.mark.parametrize("length", [1, BYTES_AT_ONCE])
def test_of_octets_that_are_no_message_the_reason_is_told(length: int) -> None:
    background, decoded = Waiting(), list[ReceivedMessage | MessageError]()
    Decoder(TYPES, background).decode("std_msgs/msg/Header", b"\0" * (length + 1), decoded.append)
    for job in background.jobs:
        job()
    assert len(decoded) == 1
    if length == 1:
        assert isinstance(decoded[0], MessageError)


def test_a_thread_that_fails_leaves_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr(cdr, "deserialize", fail)
    background, decoded = Waiting(), list[ReceivedMessage | MessageError]()
    Decoder(TYPES, background).decode(STRING, b"x" * (BYTES_AT_ONCE + 1), decoded.append)
    background.jobs.pop()()
    assert isinstance(decoded[0], MessageError)
