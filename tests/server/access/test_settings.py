from __future__ import annotations

import pytest
from pydantic import ValidationError

from server.access.settings import AccessSettings
from server.config_loader import load
from server.errors import ConfigurationError

LONG = "correct-horse-battery"


@pytest.mark.parametrize("token", ["short", "x" * 257])
def test_a_token_of_a_wrong_length_is_refused_with_limit_and_length_and_never_shown(token: str) -> None:
    with pytest.raises(ConfigurationError, match=f"access.token: .*16 to 256 characters, not {len(token)}") as refused:
        load(None, {"access": {"token": token}})
    assert token not in str(refused.value)


def test_a_token_in_a_table_is_refused_by_its_name_and_never_shown() -> None:
    with pytest.raises(ConfigurationError, match=r"access\.view_tokens.*the token of screen must have 16") as refused:
        load(None, {"access": {"view_tokens": {"screen": "abc-def"}}})
    assert "abc-def" not in str(refused.value)


@pytest.mark.parametrize("key", ["token", "admin_tokens", "operate_tokens", "view_tokens"])
def test_a_token_in_a_wrong_place_is_not_shown(key: str) -> None:
    for overrides in ({"access": {key: ["my-secret"]}}, {"access": {key: "my-secret"}}, {"access": "my-secret"}):
        with pytest.raises(ConfigurationError) as refused:
            load(None, overrides)
        assert "my-secret" not in str(refused.value)


def test_tokens_with_spaces_are_refused() -> None:
    with pytest.raises(ValidationError, match="no spaces"):
        AccessSettings(token="correct horse battery")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["", "a b", "a\nb", "(127.0.0.1)", "x" * 65])
def test_names_that_would_look_like_something_else_in_a_log_are_refused(name: str) -> None:
    with pytest.raises(ValidationError, match="1 to 64 letters"):
        AccessSettings(view_tokens={name: LONG})  # type: ignore[dict-item]


def test_settings_do_not_show_tokens() -> None:
    settings = AccessSettings(token=LONG, view_tokens={"screen": LONG + "2"})  # type: ignore[arg-type, dict-item]
    assert LONG not in f"{settings!r} {settings.model_dump(mode='json')}"
