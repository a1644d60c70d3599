import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, cast

import pytest

from protocol.codecs import cdr
from protocol.errors import MessageError
from server.gateway.turns import Threads
from server.graph.message_types import BYTES_AT_ONCE, MessageTypes, ReceivedMessage
from server.graph.node import Node
from server.graph.topics import Graph
from server.interfaces import load_registry
from server.zenoh import network
from server.zenoh.network import Declaration, Network, SharedNames
from server.zenoh.rmw import LivelinessTokens
from server.zenoh.session import SessionThread
from tests.conformance.cases import INTERFACES
from tests.helpers.zenoh_network import REGISTRY


@pytest.fixture
async def alone() -> Network:
    """A network without a session."""

    def never() -> object:
        raise AssertionError

    thread = SessionThread(never)  # type: ignore[arg-type]
    node = Node("zenoh", remote=True)
    return Network(thread, Graph(REGISTRY), node, LivelinessTokens(0, "us", ""), 10_000_000, Threads())


async def test_the_number_of_different_warnings_is_limited(alone: Network, caplog: pytest.LogCaptureFixture) -> None:
    for number in range(network.MAX_WARNINGS + 10):
        alone.warn(str(number))
    assert len(caplog.records) == network.MAX_WARNINGS + 1
    assert "further ones are not" in caplog.text


async def test_types_that_are_known_have_an_endpoint(alone: Network, caplog: pytest.LogCaptureFixture) -> None:
    assert alone.endpoint("/a", "nobodys_msgs/msg/Thing", "msg") is None
    assert "the type nobodys_msgs/msg/Thing is unknown" in caplog.text
    user = replace(alone, graph=Graph(load_registry([INTERFACES])))
    assert user.endpoint("/a", "lab_msgs/msg/Sample", "msg") is not None
    assert user.endpoint("/a", "lab_msgs/srv/Measure", "srv") is not None


class Jobs:
    """Thread of a session whose jobs are done at once; one that fails ends no other."""

    def submit(self, job: Callable[[Any], object]) -> bool:
        with contextlib.suppress(RuntimeError):
            job(None)
        return True


def test_only_what_was_declared_is_taken_back_the_last_first() -> None:
    taken_back = []

    class Declared:
        def undeclare(self) -> None:
            taken_back.append(self)

    first, second = Declared(), Declared()

    def declare(_session: object) -> Iterator[Declared]:
        yield first
        yield second
        raise RuntimeError("the network")

    Declaration(cast(SessionThread, Jobs()), declare).undeclare()
    assert taken_back == [second, first]


def test_a_pattern_fits_whole_names_and_no_patterns() -> None:
    patterns = SharedNames(["/joint_states", "/arm/*"])
    names = ("/joint_states", "/joint_states2", "/arm/a/b", "/arm", "/armada")
    assert [name for name in names if patterns.matches(name)] == ["/joint_states", "/arm/a/b"]
    assert not SharedNames(["*"]).matches("/**")


async def test_names_lose_this_server_s_namespace_alone(alone: Network) -> None:
    for namespace, there, here in (
        ("/arm1", "/arm1/joint_states", "/joint_states"),
        ("/arm1", "/arm2/joint_states", "/arm2/joint_states"),
        ("/arm1", "/arm12/joint_states", "/arm12/joint_states"),
        ("", "/joint_states", "/joint_states"),
    ):
        found = replace(alone, tokens=LivelinessTokens(0, "us", namespace))
        assert found.to_local(there) == here
        assert found.is_local(there) == there.startswith(f"{namespace}/")
        if found.is_local(there):
            assert found.to_network(here) == there


STRING = "std_msgs/msg/String"


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
    """A network whose messages such threads decode, and the decoded messages."""

    def __init__(self, network: Network) -> None:
        self.background = Waiting()
        self.decoded: list[ReceivedMessage | MessageError] = []
        self._network = replace(network, background=self.background)

    def take(self, octets: bytes, type_name: str = STRING) -> None:
        self._network.decode(type_name, octets, self.decoded.append)

    def work(self) -> None:
        """Have the threads do what they were given, which is one job."""
        (job,) = self.background.jobs
        job()


@pytest.fixture
async def decoding(alone: Network) -> Decoding:
    return Decoding(alone)


def octets_of(text: str) -> bytes:
    return cdr.serialize(REGISTRY, STRING, {"data": text})


async def test_a_small_message_is_decoded_at_once(decoding: Decoding) -> None:
    decoding.take(octets_of("a"))
    assert decoding.background.jobs == []
    assert isinstance(decoding.decoded[0], ReceivedMessage)
    assert MessageTypes(REGISTRY).complete(STRING, decoding.decoded[0]) == {"data": "a"}


async def test_a_large_message_is_decoded_and_completed_by_a_thread(decoding: Decoding) -> None:
    text = "x" * BYTES_AT_ONCE
    decoding.take(octets_of(text))
    assert decoding.decoded == []
    decoding.work()
    assert isinstance(decoding.decoded[0], ReceivedMessage)
    assert decoding.decoded[0].completed(STRING) == {"data": text}


async def test_of_octets_that_are_no_message_the_reason_is_told(decoding: Decoding) -> None:
    decoding.take(b"\0\0", "std_msgs/msg/Header")
    decoding.take(b"\xff" * (BYTES_AT_ONCE + 1))
    decoding.work()
    assert [type(each) for each in decoding.decoded] == [MessageError, MessageError]


async def test_a_thread_that_fails_leaves_a_reason(decoding: Decoding, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError

    monkeypatch.setattr(cdr, "deserialize", fail)
    decoding.take(b"x" * (BYTES_AT_ONCE + 1))
    decoding.work()
    assert isinstance(decoding.decoded[0], MessageError)
