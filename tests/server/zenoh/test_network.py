import contextlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from protocol.codecs import cdr
from protocol.errors import MessageError
from server.errors import GraphError
from server.graph.message_types import BYTES_AT_ONCE
from server.graph.permissions import Node
from server.graph.topics import Graph
from server.interfaces import load_registry
from server.zenoh import network
from server.zenoh.network import Declaration, Network, SharedEndpoints, SharedNames
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
    return Network(thread, Graph(REGISTRY), node, LivelinessTokens(0, "us", ""), 10_000_000, ThreadPoolExecutor())


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

    def __init__(self, session: object) -> None:
        self.session = session

    def submit(self, job: Callable[[Any], object]) -> bool:
        with contextlib.suppress(RuntimeError):
            job(self.session)
        return True


def test_only_what_was_declared_is_taken_back_the_last_first() -> None:
    taken_back = []

    class Declared:
        def undeclare(self) -> None:
            taken_back.append(self)

    entity, token = Declared(), Declared()

    def announced() -> SimpleNamespace:
        return SimpleNamespace(declare_token=lambda _token: token)

    def without_network() -> SimpleNamespace:
        raise RuntimeError("the network")

    for liveliness, declared in ((announced, [token, entity]), (without_network, [entity])):
        jobs = cast(SessionThread, Jobs(SimpleNamespace(liveliness=liveliness)))
        Declaration(jobs, "a token", lambda _session: entity).undeclare()
        assert taken_back == declared
        taken_back.clear()


async def test_wanted_things_are_made_up_to_a_limit_and_again_where_they_change(
    alone: Network, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(network, "MAX_SHARED", 2)
    made = []

    class Thing:
        def __init__(self, name: str, wanted: int) -> None:
            if not wanted:
                raise GraphError("topic", name, "has another type")
            self.of, self.closed = (name, wanted), False
            made.append(self)

        def close(self) -> None:
            self.closed = True

    things = SharedEndpoints(alone, Thing)
    things.follow({"/wrong": 0, "/a": 1, "/b": 1, "/one_too_many": 1})
    assert [each.of for each in made] == [("/a", 1), ("/b", 1)]
    assert "/wrong is not shared: topic /wrong: has another type" in caplog.text
    things.follow({"/a": 2, "/b": 1})
    assert [(each.of, each.closed) for each in made] == [(("/a", 1), True), (("/b", 1), False), (("/a", 2), False)]
    assert [things.is_shared("/a", each) for each in made] == [False, False, True]


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


async def test_a_message_of_any_size_is_decoded_and_one_that_cannot_be_is_refused(alone: Network) -> None:
    type_name = "std_msgs/msg/String"
    for text in ("a", "x" * BYTES_AT_ONCE):
        message = await alone.decode(type_name, cdr.serialize(REGISTRY, type_name, {"data": text}))
        assert message.completed(type_name) == {"data": text}
    for octets in (b"\0\0", b"x" * (BYTES_AT_ONCE + 1)):
        with pytest.raises(MessageError):
            await alone.decode(type_name, octets)
