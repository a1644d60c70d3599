import hmac
import logging
from typing import Any

import pytest

from server.access.authentication import Tokens
from server.access.one_time_tokens import SERVICE, VALID_FOR_S, OneTimeTokens, offer_one_time_tokens
from server.access.settings import AccessSettings
from server.errors import ServiceError
from server.graph.permissions import ANYONE, Identity, Role
from tests.helpers.clock import FakeClock
from tests.helpers.gateway import InProcess

ADA, OTTO = "ada-0123456789abcdef", "otto-0123456789abcdef"
ADMIN = Identity("ada", Role.ADMIN)


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def issued(clock: FakeClock) -> OneTimeTokens:
    return OneTimeTokens(clock)


def test_it_expires(issued: OneTimeTokens, clock: FakeClock) -> None:
    early, late = issued.issue(ADMIN, ""), issued.issue(ADMIN, "")
    # 128 bits.
    assert len(early) == 22
    clock.advance(119.9)
    assert issued.use(early) is not None
    clock.advance(0.1)
    assert issued.use(late) is None


def test_nobody_gives_more_than_they_have(issued: OneTimeTokens) -> None:
    screen, otto = Identity("screen", Role.VIEW), Identity("otto", Role.OPERATE)
    for asker, role, own in ((screen, "admin", "view"), (otto, "admin", "operate"), (None, "view", "none")):
        with pytest.raises(ServiceError, match=f"{role} is above the role of this client, {own}"):
            issued.issue(asker, role)


def test_the_oldest_of_too_many_is_revoked(issued: OneTimeTokens) -> None:
    tokens = [issued.issue(ADMIN, "") for _ in range(9)]
    assert issued.use(tokens[0]) is None
    assert all(issued.use(token) for token in tokens[1:])


def test_every_token_is_compared_in_constant_time(issued: OneTimeTokens, monkeypatch: pytest.MonkeyPatch) -> None:
    tokens = [issued.issue(ADMIN, "") for _ in range(3)]
    known = Tokens(dict.fromkeys("abc", ADMIN), None)
    compared: list[bytes] = []

    def compare(one: bytes, other: bytes) -> bool:
        compared.append(one)
        return one == other

    monkeypatch.setattr(hmac, "compare_digest", compare)
    for identify, token in ((issued.use, tokens[0]), (known.identify, "a")):
        identify(token)
        assert len(compared) == 3
        compared.clear()


class World(InProcess):
    """A server that issues one-time tokens."""

    def __init__(self, urls: list[str], **settings: Any) -> None:
        super().__init__(access=AccessSettings.model_validate(settings))
        offer_one_time_tokens(self.graph, self.access.one_time_tokens, self.access.tokens, lambda: urls)

    def ask(self, client: str, role: str = "") -> dict[str, Any]:
        self.say(client, op="call_service", service=SERVICE, args={"role": role}, id="asked")
        (answered,) = (heard for heard in self.heard(client) if heard.get("id") == "asked")
        return answered["values"] if answered["result"] else {"refused": answered["values"]}


@pytest.fixture
def world() -> World:
    return World(["https://10.0.0.2:9090/"], admin_tokens={"ada": ADA}, operate_tokens={"otto": OTTO})


async def test_an_administrator_lets_one_connection_in(world: World, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    world.enter("page", ADMIN)
    answered = world.ask("page")
    told = {"success": True, "urls": ["https://10.0.0.2:9090/"], "encrypted": True, "expires_in_s": VALID_FOR_S}
    assert {name: answered[name] for name in told} == told
    reader = world.access.one_time_tokens.reader
    assert reader(answered["token"]) is None
    for name in ("phone", "other"):
        world.enter(name, None)
        world.say(name, op="auth", token=answered["token"])
        assert reader(answered["token"]) == Identity("one-time-1", Role.VIEW)
    assert world.client("phone").node.identity == Identity("one-time-1", Role.OPERATE)
    assert world.client("other").node.identity is None
    assert "lets one connection in" in world.closed["other"]
    assert "one-time token for the role operate" in caplog.text
    assert answered["token"] not in caplog.text
    await world.close("phone")
    assert reader(answered["token"]) is None


def test_an_unknown_role_is_answered_in_a_sentence(world: World) -> None:
    world.enter("page", ADMIN)
    answered = world.ask("page", "k" * 41)
    assert (answered["success"], answered["token"]) == (False, "")
    assert answered["message"] == f"field role: must be view, propose, operate, admin, not {'k' * 40!r}"


def test_a_server_without_tokens_needs_none() -> None:
    world = World([])
    world.enter("page", ANYONE)
    answered = world.ask("page")
    assert (answered["success"], answered["token"], answered["encrypted"]) == (True, "", False)
    assert "this server has no tokens" in answered["message"]
