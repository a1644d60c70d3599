from __future__ import annotations

import pytest

from server.graph.node import Node
from server.graph.topics import Graph, Subscriber
from server.zenoh import network
from server.zenoh.keys import Endpoint, Tokens
from server.zenoh.names import Namespace
from server.zenoh.network import Network, Told, undeclare
from server.zenoh.session_thread import SessionThread
from tests.helpers.zenoh_network import REGISTRY

STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


@pytest.fixture
def alone() -> Network:
    """A network without a session."""

    def never() -> object:
        raise AssertionError

    thread = SessionThread(never, print)  # type: ignore[arg-type]
    node = Node("zenoh", remote=True)
    return Network(thread, Graph(REGISTRY), node, "us", 0, Namespace(""), Tokens(0, "us", ""), 10_000_000)


def test_what_is_wrong_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    told = Told()
    for _ in range(3):
        told.warn("a")
    assert [record.message for record in caplog.records] == ["zenoh: a"]


def test_whoever_invents_mistakes_fills_no_log(caplog: pytest.LogCaptureFixture) -> None:
    told = Told()
    for number in range(network.MAX_TOLD + 10):
        told.warn(str(number))
    assert len(caplog.records) == network.MAX_TOLD


def test_messages_and_services_have_endpoints_with_the_hash_of_their_types(alone: Network) -> None:
    assert alone.endpoint("/a", "std_msgs/msg/String", "msg") == Endpoint("/a", "std_msgs/msg/String", STRING_HASH)
    service = alone.endpoint("/a", "std_srvs/srv/Trigger", "srv")
    assert service is not None
    assert service.type_hash.startswith("RIHS01_eeff2cd6")


def test_a_type_that_is_unknown_has_no_endpoint(alone: Network, caplog: pytest.LogCaptureFixture) -> None:
    assert alone.endpoint("/a", "nobodys_msgs/msg/Thing", "msg") is None
    assert "the type nobodys_msgs/msg/Thing is unknown" in caplog.text


def test_types_agree_by_their_hash(alone: Network) -> None:
    assert alone.agrees(Endpoint("/a", "std_msgs/msg/String", STRING_HASH), "msg")
    assert not alone.agrees(Endpoint("/a", "std_msgs/msg/String", "RIHS01_0"), "msg")
    assert not alone.agrees(Endpoint("/a", "nobodys_msgs/msg/Thing", "RIHS01_0"), "msg")


def test_parts_of_the_server_are_told_from_clients(alone: Network) -> None:
    part, client = Node("part"), Node("client", remote=True)
    for node, name in ((part, "/own"), (client, "/theirs")):
        alone.graph.advertise(node, name, "std_msgs/String")
        alone.graph.subscribe(node, name, None, Subscriber(print))
    assert alone.is_own_publication("/own")
    assert alone.is_own_subscription("/own")
    assert not alone.is_own_publication("/theirs")
    assert not alone.is_own_subscription("/theirs")


def test_only_what_was_declared_is_taken_back() -> None:
    taken_back = []

    class Declared:
        def undeclare(self) -> None:
            taken_back.append(self)

    declared = Declared()
    undeclare(None, declared)
    assert taken_back == [declared]
