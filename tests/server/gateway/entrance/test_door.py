from __future__ import annotations

from http import HTTPStatus

import pytest
from websockets.datastructures import Headers

from server.access.roles import ANYONE, Identity, Role
from server.access.settings import AccessSettings
from server.access.tokens import Tokens
from server.gateway.entrance.door import Caller, Door
from server.gateway.entrance.wrong_tokens import MAX_WRONG, WINDOW_S
from server.gateway.http_answers import Answer
from tests.helpers.clock import FakeClock

SECRET, OTHER = "correct-horse-battery", "another-token-of-mine"
ALICE = Identity("alice", Role.OPERATE)
LOCKED = Tokens({SECRET: ALICE}, anonymous=None)
VIEWED = Tokens({SECRET: ALICE}, anonymous=Identity("", Role.VIEW))


def caller(
    path: str = "/", *headers: tuple[str, str], host: str = "localhost:9090", upgrade: bool = True, address: str = "::1"
) -> Caller:
    return Caller(address, path, Headers([("Host", host), *headers]), upgrade=upgrade)


def refused(admitted: object) -> tuple[int, str]:
    assert isinstance(admitted, Answer), admitted
    return admitted.status, admitted.body.decode()


def test_without_tokens_everybody_comes_in() -> None:
    assert Door().admit(caller()) is ANYONE


# Host.


@pytest.mark.parametrize("upgrade", [True, False])
def test_a_name_that_was_turned_to_this_machine_is_refused_with_what_to_set(
    upgrade: bool, caplog: pytest.LogCaptureFixture
) -> None:
    door = Door()
    for _ in range(2):
        status, text = refused(door.admit(caller(host="Evil.com:9090", upgrade=upgrade)))
    assert status == HTTPStatus.MISDIRECTED_REQUEST
    assert 'set access.allowed_hosts = ["evil.com"]' in text
    assert caplog.text.count("'Evil.com:9090' is no name of this server") == 1


@pytest.mark.parametrize(
    "host", ["localhost.evil.com", "127.0.0.1.evil.com", "user@localhost", "localhost:9090@evil.com", "", "localhost/"]
)
def test_a_name_that_only_looks_like_this_machine_is_refused(host: str) -> None:
    assert refused(Door().admit(caller(host=host)))[0] == HTTPStatus.MISDIRECTED_REQUEST


@pytest.mark.parametrize("hosts", [[], ["localhost", "localhost"], ["localhost", "evil.com"]])
def test_a_request_names_one_host(hosts: list[str]) -> None:
    headers = Headers([("Host", host) for host in hosts])
    status, text = refused(Door().admit(Caller("::1", "/", headers, upgrade=True)))
    assert (status, text) == (400, f"a request needs one Host header, not {len(hosts)}\n")


def test_the_robots_files_are_no_exception_from_the_name() -> None:
    assert refused(Door().admit(caller("/robot/x", host="evil.com", upgrade=False)))[0] == 421


# Origin.


def test_a_foreign_page_is_refused_with_what_to_set(caplog: pytest.LogCaptureFixture) -> None:
    door = Door()
    for _ in range(2):
        status, text = refused(door.admit(caller("/", ("Origin", "http://evil.com"))))
    assert status == HTTPStatus.FORBIDDEN
    assert 'set access.allowed_origins = ["http://evil.com"]' in text
    assert caplog.text.count("http://evil.com' may not connect") == 1


def test_a_second_origin_is_looked_at_as_well() -> None:
    asked = caller("/", ("Origin", "http://localhost"), ("Origin", "http://evil.com"))
    assert refused(Door().admit(asked))[0] == 403


def test_a_page_from_a_file_is_refused_until_it_is_allowed() -> None:
    asked = caller("/", ("Origin", "null"))
    assert refused(Door().admit(asked))[0] == 403
    allowing = Door.of(AccessSettings(allowed_origins=("null",)), Tokens({}, ANYONE))
    assert allowing.admit(asked) is ANYONE


def test_the_token_does_not_open_the_door_to_a_foreign_page() -> None:
    asked = caller(f"/?token={SECRET}", ("Origin", "http://evil.com"))
    assert refused(Door(LOCKED).admit(asked))[0] == 403


def test_every_page_may_read_the_robots_files_and_nothing_else() -> None:
    origin = "Origin", "http://evil.com"
    assert Door().admit(caller("/robot/description.urdf", origin, upgrade=False)) is ANYONE
    assert refused(Door().admit(caller("/robot/description.urdf", origin, upgrade=True)))[0] == 403
    for path in ("/", "/metrics", "/healthz", "/robots", "//robot/x"):
        assert refused(Door().admit(caller(path, origin, upgrade=False)))[0] == 403


# Tokens.


@pytest.mark.parametrize(
    "asked",
    [
        caller("/", ("Authorization", f"Bearer {SECRET}")),
        caller("/", ("Authorization", f"bearer  {SECRET} ")),
        caller(f"/any/path?x=1&token={SECRET}"),
        caller(f"/?token={SECRET}", ("Authorization", f"Bearer {SECRET}")),
    ],
)
def test_who_shows_a_token_is_its_owner(asked: Caller) -> None:
    assert Door(LOCKED).admit(asked) == ALICE


def test_who_shows_none_has_to_say_it_later() -> None:
    assert Door(LOCKED).admit(caller()) is None
    assert Door(LOCKED).admit(caller("/", ("Authorization", "Basic YTpi"))) is None


def test_who_shows_none_where_anybody_may_look_looks() -> None:
    assert Door(VIEWED).admit(caller()) == VIEWED.anonymous


@pytest.mark.parametrize("path", [f"/?token={OTHER}", "/?token=", f"/?token={SECRET[:-1]}", f"/?token={SECRET}%00"])
@pytest.mark.parametrize("tokens", [LOCKED, VIEWED])
def test_a_wrong_token_is_refused_and_not_logged(path: str, tokens: Tokens, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG")
    admitted = Door(tokens).admit(caller(path))
    assert refused(admitted) == (401, "this token is nobody's\n")
    assert isinstance(admitted, Answer)
    assert admitted.headers["WWW-Authenticate"] == "Bearer"
    assert "::1 has shown a token that is nobody's" in caplog.text
    assert path[8:24] not in caplog.text or path == "/?token="


def test_a_request_shows_one_token_not_many_guesses() -> None:
    status, text = refused(Door(LOCKED).admit(caller(f"/?token={SECRET}&token={OTHER}")))
    assert (status, text) == (401, "one token is wanted, not 2\n")


def test_without_tokens_one_that_is_shown_is_passed_over() -> None:
    assert Door().admit(caller(f"/?token={OTHER}")) is ANYONE


def test_who_guesses_is_refused_for_a_while_even_with_the_right_one() -> None:
    clock = FakeClock()
    door = Door(LOCKED, clock=clock)
    for number in range(MAX_WRONG):
        assert refused(door.admit(caller(f"/?token={OTHER}{number}", address="192.0.2.1")))[0] == 401
    right = caller(f"/?token={SECRET}", address="192.0.2.1")
    admitted = door.admit(right)
    assert refused(admitted)[0] == 429
    assert isinstance(admitted, Answer)
    assert admitted.headers["Retry-After"] == "60"
    assert door.admit(caller(f"/?token={SECRET}", address="192.0.2.2")) == ALICE
    clock.advance(WINDOW_S)
    assert door.admit(right) == ALICE


@pytest.mark.parametrize("path", ["/metrics", "/robot/description.urdf", "/%6detrics", "/robot", "/metrics?x=1"])
def test_what_tells_of_the_robot_needs_a_token(path: str) -> None:
    status, text = refused(Door(LOCKED).admit(caller(path, upgrade=False)))
    assert status == 401
    assert "needs a token" in text
    asked = path + ("&" if "?" in path else "?") + f"token={SECRET}"
    assert Door(LOCKED).admit(caller(asked, upgrade=False)) == ALICE
    assert Door(VIEWED).admit(caller(path, upgrade=False)) == VIEWED.anonymous


@pytest.mark.parametrize("path", ["/", "/index.html", "/assets/vendor.js", "/healthz", "/livez"])
def test_the_page_and_the_servers_health_need_none(path: str) -> None:
    assert Door(LOCKED).admit(caller(path, upgrade=False)) is None


@pytest.mark.parametrize("path", ["//[", "/%ff%00?token", "?", "", "/?%", "http://[x/?token=a"])
def test_a_path_without_sense_does_no_harm(path: str) -> None:
    for upgrade in (True, False):
        Door(LOCKED).admit(caller(path, upgrade=upgrade))
