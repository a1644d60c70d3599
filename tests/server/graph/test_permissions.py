from __future__ import annotations

from server.graph.permissions import ANYONE, Identity, NameFilter, Role, display_name


def test_a_client_with_a_token_is_called_by_its_name() -> None:
    assert display_name(Identity("alice", Role.VIEW), "10.0.0.1:5") == "alice (10.0.0.1:5)"


def test_a_client_without_one_is_called_by_its_address() -> None:
    assert display_name(ANYONE, "10.0.0.1:5") == display_name(None, "10.0.0.1:5") == "client 10.0.0.1:5"


def test_patterns_are_those_of_a_shell() -> None:
    names = NameFilter("access.topics_glob", ["/arm[12]/*", "/joint?"])
    for name, fits in {"/arm1/a/b": True, "/arm3/a": False, "/joint1": True, "/joint12": False}.items():
        assert (names.refusal("topic", name) is None) is fits
