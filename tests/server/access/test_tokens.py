from __future__ import annotations

from pathlib import Path

import pytest

from server.access.roles import ANYONE, Identity, Role
from server.access.settings import AccessSettings
from server.access.tokens import Tokens
from server.errors import ConfigurationError

ONE, TWO, THREE, FOUR = (f"{name}-0123456789abcdef" for name in ("one", "two", "three", "four"))


def tokens(**settings: object) -> Tokens:
    return Tokens.of(AccessSettings.model_validate(settings))


def test_each_token_says_name_and_role() -> None:
    known = tokens(token=ONE, admin_tokens={"ada": TWO}, operate_tokens={"otto": THREE}, view_tokens={"screen": FOUR})
    assert known.any
    assert known.identify(ONE) == Identity("admin", Role.ADMIN)
    assert known.identify(TWO) == Identity("ada", Role.ADMIN)
    assert known.identify(THREE) == Identity("otto", Role.OPERATE)
    assert known.identify(FOUR) == Identity("screen", Role.VIEW)


@pytest.mark.parametrize("wrong", ["", ONE[:-1], ONE + "x", ONE.upper(), f" {ONE}", "\ud800", "x" * 10_000])
def test_what_is_no_token_is_nobody(wrong: str) -> None:
    assert tokens(token=ONE).identify(wrong) is None


def test_every_token_is_compared_in_constant_time_with_all(monkeypatch: pytest.MonkeyPatch) -> None:
    known = tokens(view_tokens={"a": ONE, "b": TWO, "c": THREE})
    compared: list[bytes] = []

    def compare(one: bytes, other: bytes) -> bool:
        compared.append(one)
        return one == other

    monkeypatch.setattr("server.access.tokens.hmac.compare_digest", compare)
    known.identify(ONE)
    assert len(compared) == 3


def test_without_tokens_everybody_may_do_everything() -> None:
    assert tokens().anonymous == ANYONE
    assert not tokens().any


def test_with_tokens_nobody_comes_without() -> None:
    assert tokens(token=ONE).anonymous is None


def test_the_settings_may_let_those_without_a_token_look() -> None:
    anonymous = tokens(token=ONE, without_token="view").anonymous
    assert anonymous == Identity("", Role.VIEW)


def test_a_server_that_lets_nobody_in_is_refused() -> None:
    with pytest.raises(ConfigurationError, match=r"without_token: none lets nobody in.*set access\.token"):
        tokens(without_token="none")


def test_a_token_of_two_owners_is_refused_without_being_shown() -> None:
    with pytest.raises(ConfigurationError, match="otto and screen have the same token") as refused:
        tokens(operate_tokens={"otto": ONE}, view_tokens={"screen": ONE})
    assert ONE not in str(refused.value)


def test_more_tokens_than_a_handshake_may_cost_are_refused() -> None:
    many = {f"n{number}": f"{ONE}{number}" for number in range(60)}
    more = {f"m{number}": f"{TWO}{number}" for number in range(60)}
    with pytest.raises(ConfigurationError, match="120 tokens, the limit is 100"):
        tokens(view_tokens=many, operate_tokens=more)


class TestFile:
    @pytest.fixture
    def file(self, tmp_path: Path) -> Path:
        file = tmp_path / "tokens.toml"
        file.touch(0o600)
        return file

    def test_tokens_of_a_file_stand_beside_those_of_the_settings(self, file: Path) -> None:
        file.write_text(f'[view_tokens]\nscreen = "{TWO}"\n')
        known = tokens(token=ONE, token_file=file)
        assert known.identify(TWO) == Identity("screen", Role.VIEW)
        assert known.identify(ONE) is not None

    def test_a_file_that_others_may_read_is_told(self, file: Path, caplog: pytest.LogCaptureFixture) -> None:
        file.write_text(f'token = "{ONE}"\n')
        file.chmod(0o644)
        tokens(token_file=file)
        assert "can be read by other users of this machine; chmod 600" in caplog.text

    def test_a_file_for_its_owner_alone_is_not(self, file: Path, caplog: pytest.LogCaptureFixture) -> None:
        file.write_text(f'token = "{ONE}"\n')
        tokens(token_file=file)
        assert not caplog.text

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
            ('insecure = "my-secret"', "has insecure; it may have admin_tokens, operate_tokens, token, view_tokens"),
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
