from __future__ import annotations

from server.graph.node import Node


def test_nodes_are_told_apart_even_under_one_name() -> None:
    assert Node("a") != Node("a")


def test_a_node_is_part_of_the_server_unless_it_is_said_to_be_a_client() -> None:
    assert not Node("a").remote
    assert Node("a", remote=True).remote


def test_logs_show_the_name() -> None:
    assert f"{Node('client 1')}" == "client 1"
