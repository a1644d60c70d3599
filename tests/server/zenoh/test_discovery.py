from __future__ import annotations

import pytest

from server.zenoh import discovery
from server.zenoh.discovery import Discovery
from server.zenoh.keys import Endpoint, Entity, Kind, Tokens

CHATTER = Endpoint("/chatter", "std_msgs/msg/String", "RIHS01_0")


def all_concern(_entity: Entity) -> bool:
    return True


def test_who_comes_is_known_until_it_goes() -> None:
    others = Discovery(0, "us", all_concern)
    token = Tokens(0, "them", "").entity(Kind.PUBLISHER, CHATTER)
    others.take(token, alive=True)
    assert others.entities() == (Entity(Kind.PUBLISHER, "them", CHATTER, latched=False),)
    others.take(token, alive=False)
    assert others.entities() == ()


def test_the_server_does_not_discover_itself() -> None:
    others = Discovery(0, "us", all_concern)
    others.take(Tokens(0, "us", "").entity(Kind.PUBLISHER, CHATTER), alive=True)
    assert others.entities() == ()


def test_who_does_not_matter_is_not_kept() -> None:
    others = Discovery(0, "us", lambda entity: entity.kind is Kind.SERVICE)
    others.take(Tokens(0, "them", "").entity(Kind.PUBLISHER, CHATTER), alive=True)
    assert others.entities() == ()


def test_several_that_do_the_same_are_one() -> None:
    others, tokens = Discovery(0, "us", all_concern), Tokens(0, "them", "")
    both = [tokens.entity(Kind.PUBLISHER, CHATTER) for _ in range(2)]
    for token in both:
        others.take(token, alive=True)
    assert len(others.entities()) == 1
    others.take(both[0], alive=False)
    assert len(others.entities()) == 1
    others.take(both[1], alive=False)
    assert others.entities() == ()


def test_nothing_new_is_told_by_the_same_object() -> None:
    others, tokens = Discovery(0, "us", all_concern), Tokens(0, "them", "")
    before = others.entities()
    assert others.entities() is before
    others.take(tokens.entity(Kind.PUBLISHER, CHATTER), alive=True)
    after = others.entities()
    assert after is not before
    others.take(Tokens(0, "us", "").entity(Kind.PUBLISHER, CHATTER), alive=True)
    assert others.entities() is after


def test_whoever_invents_tokens_fills_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(discovery, "MAX_ENTITIES", 3)
    others, tokens = Discovery(0, "us", all_concern), Tokens(0, "them", "")
    for number in range(10):
        others.take(tokens.entity(Kind.PUBLISHER, Endpoint(f"/t{number}", CHATTER.type_name, "RIHS01_0")), alive=True)
    assert len(others.entities()) == 3


def test_what_is_no_token_changes_nothing() -> None:
    others = Discovery(0, "us", all_concern)
    others.take("@ros2_lv/0/nonsense", alive=True)
    others.take("@ros2_lv/0/nonsense", alive=False)
    assert others.entities() == ()
