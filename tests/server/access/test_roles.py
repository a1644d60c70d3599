from __future__ import annotations

from server.access.roles import ANYONE, Identity, Role, called


def test_each_role_may_do_what_the_ones_before_it_may() -> None:
    assert Role.VIEW < Role.OPERATE < Role.ADMIN


def test_a_client_with_a_token_is_called_by_its_name() -> None:
    assert called(Identity("alice", Role.VIEW), "10.0.0.1:5") == "alice (10.0.0.1:5)"


def test_a_client_without_one_is_called_by_its_address() -> None:
    assert called(ANYONE, "10.0.0.1:5") == called(None, "10.0.0.1:5") == "client 10.0.0.1:5"


def test_only_who_has_shown_a_token_is_known_by_it() -> None:
    assert Identity("alice", Role.ADMIN).by_token
    assert not ANYONE.by_token
