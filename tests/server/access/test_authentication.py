from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from server.access import authentication
from server.access.authentication import MAX_WRONG, WINDOW_S, AuthThrottle, Tokens
from server.access.rate_limits import client_key
from server.access.settings import AccessSettings
from server.config_loader import load
from server.errors import ConfigurationError
from server.graph.permissions import ANYONE, Identity, Role
from tests.helpers.clock import FakeClock

ONE, TWO, THREE, FOUR = (f"{name}-0123456789abcdef" for name in ("one", "two", "three", "four"))


def tokens(**settings: object) -> Tokens:
    return Tokens.from_settings(AccessSettings.model_validate(settings))


def test_each_token_says_name_and_role_and_an_invalid_one_identifies_nobody() -> None:
    known = tokens(token=ONE, admin_tokens={"ada": TWO}, operate_tokens={"otto": THREE}, view_tokens={"screen": FOUR})
    assert known.any
    assert known.identify(ONE) == Identity("admin", Role.ADMIN)
    assert known.identify(TWO) == Identity("ada", Role.ADMIN)
    assert known.identify(THREE) == Identity("otto", Role.OPERATE)
    assert known.identify(FOUR) == Identity("screen", Role.VIEW)
    wrong = ("", ONE[:-1], ONE + "x", ONE.upper(), f" {ONE}", "\ud800", "x" * 10_000)
    assert {known.identify(each) for each in wrong} == {None}


def test_without_a_token_everybody_drives_where_there_are_none_and_may_look_where_the_settings_say_so() -> None:
    assert (tokens().anonymous, tokens().any) == (ANYONE, False)
    assert tokens(token=ONE).anonymous is None
    for role in Role:
        assert tokens(token=ONE, without_token=role.name.lower()).anonymous == Identity("", role)


def test_tokens_of_nobody_or_of_two_owners_or_more_than_a_handshake_may_cost_are_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"without_token: none lets nobody in.*set access\.token"):
        tokens(without_token="none")
    with pytest.raises(ConfigurationError, match="otto and screen have the same token") as refused:
        tokens(operate_tokens={"otto": ONE}, view_tokens={"screen": ONE})
    assert ONE not in str(refused.value)
    many = {f"n{number}": f"{ONE}{number}" for number in range(99)}
    assert tokens(view_tokens=many, token=TWO).any
    with pytest.raises(ConfigurationError, match="101 tokens, the limit is 100"):
        tokens(view_tokens=many, token=TWO, operate_tokens={"otto": THREE})


class TestFile:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        file = tmp_path / "tokens.toml"
        file.touch(0o600)
        return file

    def test_tokens_of_a_file_stand_beside_those_of_the_settings_and_others_should_not_read_it(
        self, file: Path, caplog: pytest.LogCaptureFixture
    ) -> None:
        file.write_text(f'[view_tokens]\nscreen = "{TWO}"\n')
        known = tokens(token=ONE, token_file=file)
        assert known.identify(TWO) == Identity("screen", Role.VIEW)
        assert known.identify(ONE) is not None
        assert not caplog.text
        file.chmod(0o644)
        tokens(token_file=file)
        assert "can be read by other users of this machine; chmod 600" in caplog.text

    def test_a_file_that_is_not_there_is_named(self, file: Path) -> None:
        file.unlink()
        with pytest.raises(ConfigurationError, match=r"access\.token_file: .*tokens\.toml cannot be read"):
            tokens(token_file=file)

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ('token = "my-secret"', "token: must have 16 to 256 characters, not 9"),
            ('[view_tokens]\nscreen = "my-secret"', "view_tokens: .*the token of screen must have 16"),
            ("view_tokens = 3", "view_tokens: "),
            (
                'insecure = "my-secret"',
                "has insecure; it may have admin_tokens, operate_tokens, propose_tokens, token, view_tokens",
            ),
            ('token = "my-secret', "is not TOML"),
        ],
    )
    def test_a_wrong_file_is_named_and_no_token_shown(self, file: Path, text: str, words: str) -> None:
        file.write_text(text)
        with pytest.raises(ConfigurationError, match=words) as refused:
            tokens(token_file=file)
        assert "my-secret" not in str(refused.value)
        # The cause of an error is printed with it.
        assert refused.value.__cause__ is None or "my-secret" not in str(refused.value.__cause__)


GUESSER = "192.0.2.1"


def after_wrong_ones(count: int, clock: FakeClock) -> AuthThrottle:
    made = AuthThrottle(clock)
    for number in range(count):
        made.record_failure(GUESSER, number)
    return made


@pytest.mark.parametrize("count", [9, 10, 11])
def test_an_address_that_guesses_ten_tokens_is_blocked_for_a_minute_and_told_for_how_long(count: int) -> None:
    clock = FakeClock()
    made = after_wrong_ones(count, clock)
    clock.now_s += 50.0
    sentence = "10 wrong tokens came from this address, the limit is 10; try again in 10 s"
    assert (made.refusal(GUESSER), made.wait_s(GUESSER)) == ((None, 0.0) if count == 9 else (sentence, 10.0))
    clock.now_s += 9.5
    assert (made.refusal(GUESSER) is None) is (count == 9)
    clock.now_s += 0.5
    assert (made.refusal(GUESSER), made.wait_s(GUESSER)) == (None, 0.0)


@pytest.mark.parametrize(("later_s", "wait_s"), [(WINDOW_S - 1.0, WINDOW_S), (WINDOW_S, 0.0), (WINDOW_S + 1.0, 0.0)])
def test_the_wait_begins_with_the_last_wrong_one_and_old_ones_are_forgotten(later_s: float, wait_s: float) -> None:
    clock = FakeClock()
    made = after_wrong_ones(MAX_WRONG - 1, clock)
    # An old token that is tried for ever is no further guess.
    for _ in range(10 * MAX_WRONG):
        made.record_failure(GUESSER, 0)
    clock.now_s += later_s
    made.record_failure(GUESSER, "last")
    assert made.wait_s(GUESSER) == wait_s


@pytest.mark.parametrize(
    ("address", "key"),
    [
        ("2001:db8::1", "2001:db8::/64"),
        ("2001:db8::ffff:2", "2001:db8::/64"),
        ("2001:db8:0:1::1", "2001:db8:0:1::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("::ffff:192.0.2.1", "192.0.2.1"),
        (GUESSER, "192.0.2.1"),
        ("0:0::1", "::1"),
        ("a socket", "a socket"),
    ],
)
def test_wrong_tokens_count_by_the_network_of_an_ipv6_address_and_by_any_other_address(address: str, key: str) -> None:
    assert client_key(address) == key
    heard = after_wrong_ones(MAX_WRONG, FakeClock()).refusal(address) is None
    assert heard is (key != GUESSER)


def test_only_so_many_addresses_are_remembered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(authentication, "MAX_ADDRESSES", 3)
    made = after_wrong_ones(MAX_WRONG, FakeClock())
    for number in range(2, 5):
        made.record_failure(f"192.0.2.{number}", number)
    assert len(made._wrong) == 3
    assert made.refusal(GUESSER) is None


@pytest.mark.parametrize(
    ("access", "words"),
    [
        ({"token": "x" * 15}, "access.token: .*16 to 256 characters, not 15"),
        ({"token": "x" * 257}, "access.token: .*16 to 256 characters, not 257"),
        ({"token": "correct horse battery"}, "access.token: .*no spaces"),
        ({"view_tokens": {"screen": "abc-def"}}, r"access\.view_tokens.*the token of screen must have 16"),
    ],
)
def test_an_unusable_token_is_refused_by_its_name_and_never_shown(access: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigurationError, match=words) as refused:
        load(None, {"access": access})
    assert access.get("token", "abc-def") not in str(refused.value)


def test_a_token_in_a_wrong_place_is_not_shown() -> None:
    for key in ("token", "admin_tokens", "operate_tokens", "view_tokens"):
        for access in ({key: ["my-secret"]}, {key: "my-secret"}, "my-secret"):
            with pytest.raises(ConfigurationError) as refused:
                load(None, {"access": access})
            assert "my-secret" not in str(refused.value), key


def test_names_that_would_look_like_something_else_in_a_log_are_refused() -> None:
    for name in ("", "a b", "a\nb", "(127.0.0.1)", "x" * 65):
        with pytest.raises(ValidationError, match="1 to 64 letters"):
            tokens(view_tokens={name: ONE})
    for longest_name, token in (("x" * 64, "x" * 16), ("4@home", "!~" * 128)):
        assert tokens(view_tokens={longest_name: token}).identify(token) == Identity(longest_name, Role.VIEW)


def test_numbers_of_the_settings_have_limits() -> None:
    for name, least, most in (("control_idle_s", 1.0, 3600.0), ("goals_per_s", 0.1, 1000.0), ("goal_burst", 1, 10_000)):
        for value, taken in ((least, True), (most, True), (least - 0.01, False), (most + 1, False)):
            with nullcontext() if taken else pytest.raises(ValidationError, match=name):
                AccessSettings.model_validate({name: value})


def test_settings_do_not_show_tokens() -> None:
    settings = AccessSettings.model_validate({"token": ONE, "view_tokens": {"screen": ONE + "2"}})
    assert ONE not in f"{settings!r} {settings.model_dump(mode='json')}"
