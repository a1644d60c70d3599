from __future__ import annotations

import pytest

from protocol.registry import Registry
from server.errors import GraphError
from server.graph.message_types import MessageTypes
from server.graph.node import Node
from server.graph.providers import PendingRequest, Provider, Providers


def test_the_first_end_is_told_once_to_all_in_order_of_asking() -> None:
    heard: list[str] = []
    pending: PendingRequest[str] = PendingRequest()
    pending.when_ended(lambda end: heard.append(f"a {end}"))
    pending.when_ended(lambda end: heard.append(f"b {end}"))
    pending._end("first")
    pending._end("second")
    assert heard == ["a first", "b first"]
    assert pending.ended


INTERFACES = MessageTypes(Registry.load())
SERVER, CLIENT, OTHER = Node("server"), Node("client", remote=True), Node("other", remote=True)


class Table(Providers[Provider]):
    """A table of at most two offers, and those that have ended."""

    def __init__(self) -> None:
        self.ended: list[Provider] = []
        super().__init__("service", 2, INTERFACES, self.ended.append)

    def offer(self, node: Node, name: str = "/s", type_name: str = "std_srvs/SetBool") -> Provider:
        offer = Provider(node, name, self.claim(node, name, type_name))
        self.add(offer)
        return offer


@pytest.fixture
def table() -> Table:
    return Table()


def test_an_offer_is_found_by_its_name_with_its_canonical_type(table: Table) -> None:
    offer = table.offer(CLIENT)
    assert table.get("/s") is offer
    assert table.get("/nothing") is None
    assert table.names.types() == {"/s": "std_srvs/srv/SetBool"}
    assert table.by_node.of(CLIENT) == [offer]


def test_a_client_takes_the_place_of_a_client_whose_offer_ends(table: Table) -> None:
    first = table.offer(CLIENT)
    second = table.offer(OTHER)
    assert table.ended == [first]
    assert table.get("/s") is second


def test_nobody_takes_the_place_of_a_part_of_the_server_but_itself(table: Table) -> None:
    first = table.offer(SERVER)
    with pytest.raises(GraphError, match="service /s: is offered by the server itself"):
        table.offer(CLIENT)
    assert table.get("/s") is first
    table.offer(SERVER)
    assert table.ended == [first]


def test_an_offer_is_withdrawn_by_its_own_node_only(table: Table) -> None:
    offer = table.offer(CLIENT)
    table.withdraw(OTHER, "/s")
    table.withdraw(CLIENT, "/nothing")
    assert table.ended == []
    table.withdraw(CLIENT, "/s")
    assert table.ended == [offer]
    assert table.names.types() == {}
    assert table.by_node.of(CLIENT) == []


def test_all_offers_of_a_node_end_and_nobody_elses(table: Table) -> None:
    offer, others = table.offer(CLIENT, "/a"), table.offer(OTHER, "/b")
    table.withdraw_all(CLIENT)
    assert table.ended == [offer]
    assert table.get("/b") is others


def test_an_offer_is_removed_before_it_is_told_of_its_end() -> None:
    seen: list[Provider | None] = []
    table: Providers[Provider] = Providers("service", 2, INTERFACES, lambda offer: seen.append(table.get(offer.name)))
    table.add(Provider(CLIENT, "/s", table.claim(CLIENT, "/s", "std_srvs/SetBool")))
    table.withdraw(CLIENT, "/s")
    assert seen == [None]


@pytest.mark.parametrize("type_name", ["std_srvs/Nothing", "std_msgs/String", "control_msgs/action/PointHead"])
def test_a_type_that_is_none_of_the_kind_is_refused_and_ends_nothing(table: Table, type_name: str) -> None:
    table.offer(CLIENT)
    with pytest.raises(GraphError, match=f"service /s: .*{type_name}"):
        table.offer(CLIENT, type_name=type_name)
    assert table.ended == []


def test_one_offer_too_many_is_refused_and_one_anew_is_not(table: Table) -> None:
    table.offer(CLIENT, "/a")
    table.offer(CLIENT, "/b")
    with pytest.raises(GraphError, match="service /c: cannot be added: there are 2 services already"):
        table.offer(CLIENT, "/c")
    table.offer(CLIENT, "/b")
