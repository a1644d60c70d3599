from __future__ import annotations

from hashlib import sha512
from typing import Any

from protocol.operations import Auth
from server.access.access import Access, unlimited
from server.access.roles import Identity, Role
from server.access.settings import AccessSettings
from server.graph.node import Node

TOKEN = "one-0123456789abcdef"


def access(**settings: Any) -> Access:
    values = {"operate_tokens": {"otto": TOKEN}, **settings}
    return Access(AccessSettings.model_validate(values), lambda: 0.0, lambda: 1000.0)


def test_a_client_is_known_by_its_token() -> None:
    assert access().identify(Auth(token=TOKEN)) == Identity("otto", Role.OPERATE)


def test_a_wrong_token_is_nobodys_and_not_repeated() -> None:
    refusal = access().identify(Auth(token="guess"))
    assert refusal == "field token: it is none of the tokens here"


def test_a_client_is_known_by_a_proof_as_clients_of_rosauth_make_it() -> None:
    mac = sha512(f"{TOKEN}clientdestrand1000user2000".encode()).hexdigest()
    shown = Auth(mac=mac, client="client", dest="dest", rand="rand", t=1000, level="user", end=2000)
    assert access().identify(shown) == Identity("otto", Role.OPERATE)


def test_who_shows_nothing_is_told_what_to_show() -> None:
    assert "wanted the field token" in str(access().identify(Auth()))


def test_all_clients_share_one_lease_and_have_a_rate_of_their_own() -> None:
    limited = access(goal_burst=1)
    first, second = (limited.guard(Node(name, remote=True)) for name in ("first", "second"))
    assert first.publishing("/moveit_goal_named", {}) is None
    assert "first has controlled" in str(second.publishing("/moveit_goal_named", {}))
    assert "goal_burst" in str(first.publishing("/moveit_goal_named", {}))


def test_without_limits_all_drive_at_once() -> None:
    everything = unlimited()
    for name in ("first", "second"):
        assert everything.guard(Node(name, remote=True)).publishing("/moveit_goal_named", {}) is None
